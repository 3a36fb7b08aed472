"""Labels by hand (Li 2018, figure 9): slices of road, and in each rectangles of depth and height.

A plain CSV file, a line a rectangle: ``begin,end`` along the road, ``y0,y1`` to the left of the track, ``z0,z1`` above
the scanner [m], ``kind`` and ``class``. `include` gives the returns inside the class code, `exclude` takes a label away
again, `rest` (its y and z stay empty) gives the code to what the slice has left without one. Lines work in their order.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.paths import open_regular
from fwclass.street.frames import Frame, Placed
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.track import Track
from fwclass.units import number_of

HEAD = ("begin", "end", "y0", "y1", "z0", "z1", "kind", "class")
KINDS = ("include", "exclude", "rest")
LARGEST = 1 << 24
"""Bytes of a file: some 300 000 rectangles."""
MOST_SIDE_BY_SIDE = 1000
"""Rectangles at one place of the road: every frame there is held against all of them."""


@dataclass(frozen=True)
class Box:
    """One line. x in [begin, end), y in [y0, y1), z in [z0, z1)."""

    line: int
    begin: float
    end: float
    y0: float
    y1: float
    z0: float
    z1: float
    kind: str
    code: int

    @property
    def include(self) -> bool:
        """It gives a class."""
        return self.kind != "exclude"

    def holds(self, y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.bool_]:
        """bool (n,): the places `y`, `z` [m], (n,), lie inside."""
        return (y >= self.y0) & (y < self.y1) & (z >= self.z0) & (z < self.z1)

    def meets(self, other: Box) -> bool:
        """Some place lies in both."""
        return (
            max(self.begin, other.begin) < min(self.end, other.end)
            and max(self.y0, other.y0) < min(self.y1, other.y1)
            and max(self.z0, other.z0) < min(self.z1, other.z1)
        )


def read_boxes(path: Path) -> list[Box]:
    """The rectangles in order; `InputError` that lists what is wrong with all lines."""
    if path.stat().st_size > LARGEST:
        raise InputError(
            "the annotation is too large", where=path, expected=f"{LARGEST} bytes", got=path.stat().st_size
        )
    with open_regular(path) as stream:
        try:
            text = stream.read().decode("utf-8-sig")
        except UnicodeDecodeError as fault:
            raise InputError("the annotation is no text", where=path, got=str(fault)[:100]) from fault
    try:
        lines = list(enumerate(csv.reader(text.splitlines()), 1))
    except csv.Error as fault:
        raise InputError("the annotation is no table", where=path, expected=",".join(HEAD), got=fault) from fault
    lines = [(n, row) for n, row in lines if row and not row[0].lstrip().startswith("#")]
    if not lines or tuple(c.strip() for c in lines[0][1]) != HEAD:
        raise InputError(
            "the annotation has another heading",
            where=path,
            expected=",".join(HEAD),
            got=",".join(lines[0][1])[:200] if lines else "an empty file",
        )
    boxes, wrong = [], []
    for number, row in lines[1:]:
        box = _box(number, [c.strip() for c in row])
        if isinstance(box, Box):
            boxes.append(box)
        else:
            wrong.append(f"line {number}: {box}")
    if wrong:
        raise InputError(
            f"{len(wrong)} rectangles cannot be used",
            where=path,
            expected="begin < end, y0 < y1, z0 < z1; kind include, exclude or rest; class 1 to 255",
            got="\n    ".join(["", *wrong[:20]]),
            do="mend these lines; nothing was written",
        )
    _check_crowd(boxes, path)
    return boxes


def _check_crowd(boxes: Sequence[Box], path: Path) -> None:
    begins, ends = (np.sort([getattr(b, name) for b in boxes]) for name in ("begin", "end"))
    there = np.arange(1, len(boxes) + 1) - np.searchsorted(ends, begins, "right")
    if len(boxes) and there.max() > MOST_SIDE_BY_SIDE:
        raise InputError(
            "too many rectangles lie at one place of the road",
            where=path,
            expected=f"at most {MOST_SIDE_BY_SIDE:,}",
            got=f"{there.max():,} at {begins[there.argmax()]:g} m",
            do="annotate shorter slices, or with fewer rectangles",
        )


def _box(line: int, row: list[str]) -> Box | str:
    if len(row) != len(HEAD):
        return f"{len(row)} fields, not {len(HEAD)}"
    kind = row[6]
    if kind not in KINDS:
        return f"kind {kind[:20]!r}"
    try:
        begin, end = number_of(row[0]), number_of(row[1])
        y0, y1, z0, z1 = (-math.inf, math.inf) * 2 if kind == "rest" else (number_of(v) for v in row[2:6])
        code = _code(row[7]) if row[7] or kind != "exclude" else 0
    except ValueError as fault:
        return str(fault)[:80]
    if not (math.isfinite(begin) and math.isfinite(end)) or any(map(math.isnan, (y0, y1, z0, z1))):
        return "a number is missing"
    for low, high, names in ((begin, end, "begin, end"), (y0, y1, "y0, y1"), (z0, z1, "z0, z1")):
        if not low < high:
            return f"{names} are turned round: {low:g}, {high:g}"
    if kind != "exclude" and not 1 <= code <= 255:
        return f"class {code}"
    return Box(line, begin, end, y0, y1, z0, z1, kind, code)


def _code(word: str) -> int:
    number_of(word)  # ValueError for what Python alone takes for a number
    return int(word)


def overlaps(boxes: Sequence[Box]) -> Iterator[tuple[Box, Box]]:
    """Pairs that give one place two classes: the later one wins."""
    includes = sorted((b for b in boxes if b.kind == "include"), key=lambda b: b.begin)
    for k, one in enumerate(includes):
        for at in range(k + 1, len(includes)):
            other = includes[at]
            if other.begin >= one.end:
                break
            if one.code != other.code and one.meets(other):
                yield one, other


class Labeller:
    """Gives the returns of frames their labels, and counts what every rectangle held."""

    def __init__(self, boxes: Sequence[Box], track: Track) -> None:
        self.boxes, self.track = boxes, track
        self.held = np.zeros(len(boxes), np.int64)
        self.labels = np.zeros(256, np.int64)
        self._begins = np.array([b.begin for b in boxes])
        self._ends = np.array([b.end for b in boxes])

    def frames(self, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Placed]]:
        """Frames that can be used with their labels and their place, and where their returns lie."""
        for frame in frames:
            placed = self.track.take(frame)
            if placed is not None:
                labels = self.codes(placed)
                self.labels += np.bincount(labels[~np.isnan(placed.r)], minlength=256)
                yield replace(frame, labels=labels, place=placed.place * UNIT), placed

    def codes(self, frame: Placed) -> NDArray[np.uint8]:
        """uint8 (beams,), 0 without a label or a return."""
        codes = np.zeros(len(frame.r), np.uint8)
        place = frame.place * UNIT
        here = ~np.isnan(frame.r)
        y, z = frame.y.astype(np.float64) * UNIT, frame.z.astype(np.float64) * UNIT
        for k in np.flatnonzero((self._begins <= place) & (place < self._ends)):
            box = self.boxes[int(k)]
            inside = here & (codes == 0) if box.kind == "rest" else here & box.holds(y, z)
            self.held[k] += int(inside.sum())
            codes[inside] = 0 if box.kind == "exclude" else box.code
        return codes


def annotated_end(boxes: Sequence[Box]) -> float | None:
    """Where the annotation ends [m along the road]: at the end of the last slice that has a `rest`; None of none."""
    return max((b.end for b in boxes if b.kind == "rest"), default=None)
