"""Files in feet, by the length of their beam vectors."""

from __future__ import annotations

FEET = (2.8, 3.4)
"""Lengths, in light's way there and back, of vectors in feet, or whose heights alone are, up to 30 degrees off the
plumb line."""


def in_metres(length: float, otherwise: str) -> str:
    """What to do where beam vectors are `length` times as long as light's way, which no sane one is."""
    feet = FEET[0] <= length <= FEET[1]
    return "bring the file into metres first: its heights, or x, y and z, look like feet" if feet else otherwise
