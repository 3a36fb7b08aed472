"""Checks that the headers of all formats share."""

from __future__ import annotations

import math
from pathlib import Path

from fwclass.errors import InputError


def check_length(path: Path, size: int, start: int, record_length: int, count: int, what: str) -> None:
    """`InputError` where `count` records (`what`: points, pulses) do not fit into the file behind byte `start`."""
    held = (size - start) // record_length
    if count > held:
        raise InputError(
            "the file is cut short",
            where=path,
            expected=f"{count} {what} of {record_length} bytes from byte {start}",
            got=f"room for {held} {what}",
            do="copy the file again",
        )


def check_scales(path: Path, scales: tuple[float, ...], offsets: tuple[float, ...]) -> None:
    """`InputError` where stored whole numbers cannot be turned into coordinates."""
    sound = all(math.isfinite(v) for v in (*scales, *offsets)) and all(0 < abs(s) < 1e6 for s in scales)
    if not sound or any(abs(o) > 1e12 for o in offsets):
        raise InputError(
            "the header's scales or offsets cannot be used",
            where=path,
            expected="finite numbers, no scale of 0",
            got=f"scales {scales}, offsets {offsets}",
            do="the header is damaged; export the file again",
        )
