"""Inputs that once did harm, and some that stand for many: all end in a result or an `FwclassError`."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from targets import TARGETS
from watch import Child, answers

EACH = 3
"""Drawn inputs of every reader, besides the corpus."""


def corpus() -> list[str]:
    """Lines ``READER SEED RECIPE``."""
    rows = Path(__file__).with_name("corpus.txt").read_text().splitlines()
    return [row.split("  #")[0].strip() for row in rows if row.strip() and not row.startswith("#")]


def wrong(lines: list[str], *readers: str) -> list[str]:
    """What the inputs did that none may do."""
    ended = zip(lines, answers(lines, *readers), strict=True)
    return [f"{line[:300]}  # {a['told']}" for line, a in ended if a["ended"] == "wrong"]


def test_every_reader_is_in_the_corpus() -> None:
    assert {line.split()[0] for line in corpus()} | {"conf"} == set(TARGETS)


def test_no_input_of_the_corpus_does_harm() -> None:
    drawn = [f"{reader} * {k}" for reader in TARGETS for k in range(EACH)]
    assert wrong([*corpus(), *drawn], *TARGETS) == []


@pytest.mark.slow
@pytest.mark.parametrize("reader", TARGETS)
def test_some_hundreds_of_drawn_inputs_do_no_harm(reader: str) -> None:
    count = round(60 * TARGETS[reader].share) + 20
    assert wrong([f"{reader} * {k}" for k in range(1000, 1000 + count)], reader) == []


@pytest.mark.parametrize(
    ("does", "told"),
    [("crash", "SIGSEGV"), ("hang", "of the processor"), ("hoard", "MemoryError"), ("raise", "ZeroDivisionError")],
)
def test_a_reader_that_does_harm_is_found_out(does: str, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The watch itself: a crash, a hang, a big allocation and a foreign fault are told, and the next one is tried."""
    monkeypatch.setenv("FUZZ_CPU_SECONDS", "1")
    with Child("harm") as child:
        answer = child.ask(f"harm plain a.txt:0-4={does.encode().hex()}")
        assert answer["ended"] == "wrong" and told in answer["told"]
        assert child.ask("harm plain a.txt:0-0=")["ended"] == "read"
