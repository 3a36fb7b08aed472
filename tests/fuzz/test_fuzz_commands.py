"""Damaged and foreign files through the commands themselves: whatever a file holds, a command ends in words, within
bounds of time and memory. See `server.py` for what none may do, `long.py --commands` for many inputs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from commands import COMMANDS, cases_of, foreign
from watch import Child

QUICK = {
    "info": 25,
    "assess": 8,
    "ground": 4,
    "features": 4,
    "classify": 4,
    "normalize": 4,
    "decompose": 3,
    "export": 4,
    "history": 2,
    "status": 2,
    "plan": 2,
    "view-export": 2,
    "suggest": 1,
    "diff": 1,
    "stored-verify": 1,
    "street-stream": 1,
    "street": 1,
}
"""Drawn inputs of the commands that do not run a survey, for the fast suite. The slow one goes on from there,
with all commands and 2 000 inputs."""

LEAST = 8
"""As many times the drawn inputs of the fast suite are tried in both together, also of commands with a small share."""

EMPTY = ("features short", "info-waveforms short")
"""Sound files that hold nothing to work on; `info` knows no text, and what comes with fwclass names files elsewhere."""

UNDELIVERED = tuple(f"{command} {seed}" for command in ("status", "verify") for seed in ("run", "sealed"))
"""Runs without their delivery: all parts are done, and readers do not see them; exit code 3."""


@pytest.fixture(scope="module")
def server() -> Iterator[Child]:
    with Child(*QUICK, script="server.py") as child:
        yield child


@pytest.fixture(scope="module")
def whole() -> Iterator[Child]:
    with Child(*COMMANDS, script="server.py") as child:
        yield child


@pytest.fixture(scope="module")
def harm() -> Iterator[Child]:
    with pytest.MonkeyPatch.context() as patch, Child("harm", script="server.py") as child:
        patch.setenv("FUZZ_CPU_SECONDS", "1")
        yield child


def corpus() -> list[str]:
    """Lines ``COMMAND CASE RECIPE``."""
    rows = Path(__file__).with_name("commands.txt").read_text().splitlines()
    return [row.split("  #")[0].rstrip() for row in rows if row.strip() and not row.startswith("#")]


def wrong(server: Child, lines: list[str]) -> list[str]:
    """What the inputs did that none may do."""
    asked = ((line, server.ask(line)) for line in lines)
    return [f"{line.split()[0]} {a['seed']} {a['recipe'][:300]}  # {a['told']}" for line, a in asked if a["told"]]


def refused(server: Child, lines: list[str]) -> list[str]:
    """Inputs that a command did not do, without those that it cannot do. Exit code 4: done, and a measure warns."""
    found = [line.strip() for line in lines if server.ask(line)["code"] not in (0, 4)]
    return [r for r in found if ".xyz" not in r and not r.startswith("plan surveys/") and r not in EMPTY + UNDELIVERED]


@pytest.mark.slow
def test_every_command_does_what_it_is_asked_with_every_sound_file(whole: Child) -> None:
    """Otherwise the damage to them would only be tried on the way to a refusal."""
    assert refused(whole, [f"{c} {name} " for c in COMMANDS for name in cases_of(c)]) == []


@pytest.mark.slow
def test_no_input_of_the_corpus_does_harm(server: Child) -> None:
    assert wrong(server, corpus()) == []


@pytest.mark.slow
def test_content_of_another_kind_under_any_name_does_no_harm(server: Child) -> None:
    """One case of every ending with every kind of content."""
    first = {name.partition(".")[2]: name for name in cases_of("info") if not name.endswith("-json")}
    lines = [f"info {name}~{kind} " for name in first.values() for kind in foreign()]
    lines += [
        f"{c} {next(iter(cases_of(c)))}~{kind} " for c in ("ground", "assess") for kind in ("text", "gpkg", "pls")
    ]
    assert wrong(server, lines) == []


@pytest.mark.slow
@pytest.mark.parametrize("command", QUICK)
def test_drawn_inputs_do_no_harm(command: str, server: Child) -> None:
    assert wrong(server, [f"{command} * {k}" for k in range(QUICK[command])]) == []


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_two_thousand_drawn_inputs_do_no_harm(command: str, whole: Child) -> None:
    share = COMMANDS[command].share / sum(c.share for c in COMMANDS.values())
    first = QUICK.get(command, 0)
    assert wrong(whole, [f"{command} * {k}" for k in range(first, max(LEAST * first, round(2000 * share)))]) == []


@pytest.mark.parametrize(
    ("does", "told"),
    [
        ("crash", "SIGSEGV"),
        ("hang", "of the processor"),
        ("hoard", "MiB, where"),
        ("raise", "ZeroDivisionError"),
        ("warn", "warning"),
        ("colour", "control"),
        ("mute", "without a word"),
        ("odd", "exit code 7"),
    ],
)
def test_a_command_that_does_harm_is_found_out(does: str, told: str, harm: Child) -> None:
    assert told in harm.ask(f"harm plain a.txt:0-4={does.encode().hex()}")["told"]
    assert harm.ask("harm plain ")["told"] == ""
