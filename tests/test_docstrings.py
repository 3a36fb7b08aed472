"""Public functions of numeric rooms say what they do; those of arrays or quantities, in what shape or unit.

Run as a program it counts them.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "fwclass"

ROOMS = (
    *("assess", "classify", "contours", "decompose", "features", "grid", "ground", "label", "model", "neighbours"),
    *("quality", "radiometry", "select", "simulate", "thin", "tile", "train", "vectors", "voxels", "water"),
    "waveforms",
)
QUANTITY = re.compile(r"NDArray|ArrayLike|\bfloat\b")
STATES = re.compile(
    r"\[[^\]]+\]|\((?:\w+,|\w+ \+ 1,|n|…)|``\(|\bshape\b|\b(?:bool|int\d+|uint\d+|float\d+) ?\(|\bm²?\b|metres"
    r"|\brad(?:ians)?\b|degrees|\bns\b|Parameters\n|Returns\n|\bAs `|\buint64\b|\bNaN\b|0 to 1"
)
"""A shape, a type with its shape, or a unit; a section of parameters or returns has them, and so has what another
function's docstring says."""


def public(path: Path) -> Iterator[tuple[str, ast.FunctionDef, str]]:
    """(name, function, docstring) of every public function and method; what overrides another has the other's."""
    tree = ast.parse(path.read_text())
    known: dict[str, str] = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node.name, node, ast.get_docstring(node) or ""
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for method in (m for m in node.body if isinstance(m, ast.FunctionDef) and not m.name.startswith("_")):
                text = ast.get_docstring(method) or (known.get(method.name, "") if node.bases else "")
                known.setdefault(method.name, text)
                yield f"{node.name}.{method.name}", method, text


def is_numeric(function: ast.FunctionDef) -> bool:
    """It takes or gives arrays or quantities, as its types tell; a kernel has none and always does."""
    types = [a.annotation for a in (*function.args.args, *function.args.kwonlyargs)]
    texts = [ast.unparse(t) for t in (*types, function.returns) if t is not None]
    kernel = any("kernel" in ast.unparse(d) or "inlined" in ast.unparse(d) for d in function.decorator_list)
    return kernel or any(map(QUANTITY.search, texts))


def counted(room: str) -> tuple[int, list[str], list[str]]:
    """Functions of a room; those without a docstring; numeric ones that state neither shape nor unit."""
    files = sorted((PACKAGE / room).rglob("*.py")) or [PACKAGE / f"{room}.py"]
    total, bare, silent = 0, [], []
    for path in files:
        for name, function, text in public(path):
            total += 1
            where = f"{path.relative_to(PACKAGE.parent)}:{function.lineno} {name}: {text.splitlines()[:1]}"
            if not text:
                bare.append(where)
            elif is_numeric(function) and not STATES.search(text):
                silent.append(where)
    return total, bare, silent


@pytest.mark.parametrize("room", ROOMS)
def test_public_functions_state_what_they_take_and_give(room):
    _, bare, silent = counted(room)
    assert not bare and not silent, "\n".join([*bare, *silent])


def test_words_alone_state_nothing() -> None:
    """A count of something, somebody's index, every row: what passed once."""
    for text in (
        "Number of the strip of every piece.",
        "How many rows, by index.",
        "Whether it counts; True where so.",
    ):
        assert not STATES.search(text), text


def bindings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """(line, name) of all variables, arguments, attributes and functions that get their name there."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.FunctionDef):
            yield node.lineno, node.name


def test_names_say_what_they_hold():
    """What was `found`, `made` or `told` has a name of its own."""
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
    empty = [
        f"{path.relative_to(PACKAGE.parent)}:{line}: {name}"
        for path, tree in trees.items()
        for line, name in bindings(tree)
        if name.strip("_") in ("found", "made", "told")
    ]
    assert not empty, "\n".join(empty)


SHARED = ("columns", "conf", "formats", "graph", "model", "operate", "report", "run", "store", "survey", "walk")
"""Packages whose classes are met in any other; what stands outside of all packages is too."""


def test_no_two_classes_that_are_met_everywhere_share_a_name():
    places: dict[str, list[str]] = {}
    for path in [*PACKAGE.glob("*.py"), *(p for room in SHARED for p in sorted((PACKAGE / room).rglob("*.py")))]:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    assert len(places) > 200
    assert not {name: paths for name, paths in places.items() if len(paths) > 1}


if __name__ == "__main__":
    rows = {room: counted(room) for room in ROOMS}
    for room, (total, bare, silent) in rows.items():
        print(
            f"{room:12} {total:4} functions, {len(bare):3} without a docstring, {len(silent):3} without shape or unit"
        )
        if "-v" in sys.argv:
            print("\n".join([*bare, *silent]))
    every = sum(total for total, _, _ in rows.values())
    lacking = sum(len(bare) + len(silent) for _, bare, silent in rows.values())
    print(f"all          {every:4} functions, {1.0 - lacking / every:.0%} state them")
