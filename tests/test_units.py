"""Physical constants and conversions stand once, in `fwclass.units`."""

from __future__ import annotations

import ast
from pathlib import Path

import fwclass
from fwclass import units

ONCE = {units.GPS_WEEK, units.ADJUSTED, units.SPEED_OF_LIGHT, units.SIGMA_PER_MAD, units.ERROR_OF_MEDIAN}
"""Values that mean nothing else where they stand for a constant of a file."""

NAMES = {name for name in vars(units) if name.isupper()}
OTHERS = {"FAR", "EVERYTHING", "STALE"}
"""Bounds that happen to have such a value."""


def constants(path):
    """(name, value) of what a file gives names to; None for what is computed."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.Assign):
            continue
        for target in node.targets:
            many = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            pairs = zip(target.elts, node.value.elts, strict=True) if many else [(target, node.value)]
            for name, value in pairs:
                if isinstance(name, ast.Name):
                    yield name.id, value.value if isinstance(value, ast.Constant) else None


def test_no_file_has_a_constant_of_units_of_its_own():
    root = Path(fwclass.__file__).parent
    again = [
        f"{path.relative_to(root)}: {name}"
        for path in sorted(root.rglob("*.py"))
        if path.name != "units.py"
        for name, value in constants(path)
        if name not in OTHERS and (name in NAMES or (isinstance(value, int | float) and value in ONCE))
    ]
    assert again == []


def test_adjusted_time_is_told_as_utc():
    assert units.utc_of(0.0).isoformat() == "2011-09-14T01:46:22+00:00"
