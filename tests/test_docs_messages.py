"""Messages on the pages of troubleshooting and of exit codes are those of the program, and all that end with 4 stand
there."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from fwclass.assess.params import AssessParams
from fwclass.classify.params import ClassifyParams
from fwclass.decompose.params import PlausibilityParams
from fwclass.quality.params import QualityParams

ROOT = Path(__file__).parents[1]
PAGES = {name: (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8") for name in ("troubleshooting", "exit-codes")}
MESSAGES = [m for page in PAGES.values() for m in re.findall(r"^\|(?: `fwclass \w+` \|)? `([^`]+)`", page, re.M)]


SAYING = {"QualityError": 0, "refuse_unsound": 2}
"""Functions that end a command with 4, and which of their arguments says what is wrong."""


@cache
def words() -> str:
    """Every text in the program's sources."""
    texts = []
    for path in (ROOT / "fwclass").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    texts += [p.read_text(encoding="utf-8") for p in (ROOT / "fwclass").rglob("*") if p.suffix in (".js", ".html")]
    return "\n".join(texts)


@pytest.mark.parametrize("message", MESSAGES)
def test_a_message_on_the_page_is_one_of_the_program(message: str) -> None:
    assert message in words()


def test_the_pages_are_read() -> None:
    assert len(MESSAGES) > 60


def ending_with_4() -> set[str]:
    """What is wrong, in the words of every command that ends with 4; of words with figures the texts between these."""
    said: list[ast.expr] = []
    for path in (ROOT / "fwclass").rglob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        calls = [n for n in nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]
        said += [c.args[at] for c in calls for name, at in SAYING.items() if c.func.id == name]  # type: ignore[attr-defined]
        if any(c.func.id == "refuse_named" for c in calls):  # type: ignore[attr-defined]
            ways = [n.value for n in nodes if isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == "ways"]
            said += [way.elts[1] for listed in ways for way in listed.elts]  # type: ignore[attr-defined]
    texts = [n.value for words in said for n in ast.walk(words) if isinstance(n, ast.Constant)]
    return {t.strip() for t in texts if isinstance(t, str) and t not in ("what", "value")} - {"", "_"}


def test_all_that_ends_with_4_stands_on_the_page_of_exit_codes() -> None:
    said = ending_with_4()
    assert len(said) > 25
    assert [text for text in sorted(said) if text not in PAGES["exit-codes"]] == []


def test_every_bound_stands_on_the_page_of_exit_codes() -> None:
    asked = {"quality": QualityParams, "classify": ClassifyParams, "assess": AssessParams}
    bounds = [f"plausibility.{name}" for name in PlausibilityParams.model_fields]
    bounds += [f"{s}.{name}" for s, kind in asked.items() for name in kind.model_fields if name[:4] in ("min_", "max_")]
    assert [name for name in bounds if f"`{name}" not in PAGES["exit-codes"]] == []
