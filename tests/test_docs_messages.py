"""Messages on the page of troubleshooting are those of the program."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MESSAGES = re.findall(r"^\| `([^`]+)`", (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8"), re.M)


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


def test_the_page_is_read() -> None:
    assert len(MESSAGES) > 20
