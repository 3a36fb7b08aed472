"""`fwclass assess RUN RUN`: two runs over the same reference, figure by figure, with intervals of the difference."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.blocks import BlockCounts
from fwclass.assess.intervals import difference
from fwclass.errors import InputError
from fwclass.graph.assess import COUNTS
from fwclass.store.arrays import read_arrays
from fwclass.store.run_store import Store

_LABELS = (("overall accuracy", "overall_accuracy"), ("kappa", "kappa"), ("mean IoU", "mean_iou"))


def assess_runs(first: Path, second: Path) -> dict[str, Any]:
    """The figures of run `second` minus those of `first`, as `intervals.difference` tells them.

    `InputError`: a directory is no assessed run; the runs judge other classes or other echoes; too few blocks for an
    interval.
    """
    return compare(_blocks(first), _blocks(second), f"{first}, {second}")


def compare(
    first: tuple[tuple[str, ...], BlockCounts], second: tuple[tuple[str, ...], BlockCounts], where: str
) -> dict[str, Any]:
    """`assess_runs` of class names and counts by block; `where` names both in faults."""
    (classes, a), (other, b) = first, second
    if classes != other:
        raise InputError(
            "the runs tell other classes apart",
            where=where,
            expected=", ".join(classes),
            got=", ".join(other),
            do="compare runs with the same survey.classes and assess.block",
        )
    _, first_rows, second_rows = np.intersect1d(_keys(a), _keys(b), return_indices=True)
    x, y = a.counts[first_rows], b.counts[second_rows]
    if len(x) != len(a.place) or len(x) != len(b.place) or (x.sum(axis=2) != y.sum(axis=2)).any():
        raise InputError(
            "the runs were not judged on the same echoes",
            where=where,
            expected="the same reference and test areas",
            got=f"{len(x)} blocks in common of {len(a.place)} and {len(b.place)}",
            do="give both runs the same areas, reference and assess.block",
        )
    intervals = difference(x, y)
    if intervals is None:
        raise InputError(
            "too few blocks to tell two runs apart", where=where, got=f"{len(x)} blocks", do="a larger test area"
        )
    return intervals


def describe(intervals: dict[str, Any]) -> str:
    """One line a figure."""
    lines = [f"second run minus first, {100 * intervals['level']:.0f} % intervals from {intervals['blocks']} blocks"]
    for label, key in _LABELS:
        gain, ends = intervals[key]["difference"], intervals[key]["interval"]
        factor, unit = (1.0, "") if key == "kappa" else (100.0, " points")
        digits = 4 if key == "kappa" else 2
        if gain is None or ends is None:
            lines.append(f"{label:<18}-")
            continue
        change = f"{factor * gain:+.{digits}f} [{factor * ends[0]:+.{digits}f}, {factor * ends[1]:+.{digits}f}]{unit}"
        lines.append(f"{label:<18}{change}")
    if intervals["caution"]:
        lines.append(f"CAUTION: {intervals['caution']}")
    return "\n".join(lines)


def _blocks(run: Path) -> tuple[tuple[str, ...], BlockCounts]:
    """Class names and counts by block of an assessed run."""
    store = Store(run)
    receipt = store.receipt("assess", "all")
    if receipt is None or not receipt.meta["accuracy"]:
        raise InputError(
            "this is no assessed run",
            where=run,
            expected="the directory of a run with test areas",
            do="give two run directories, or two files",
        )
    return tuple(receipt.meta["accuracy"]["classes"]), counts_in(store.arrays_path("assess", "all", COUNTS))


def counts_in(path: Path) -> BlockCounts:
    """The counts by block that assessment left at `path`."""
    arrays, _ = read_arrays(path)
    return BlockCounts(arrays["place"], arrays["blocks"].astype(np.int64, copy=False))


def _keys(blocks: BlockCounts) -> NDArray[np.int64]:
    """Places as one sortable number."""
    return np.asarray(blocks.place[:, 1] * (1 << 31) + blocks.place[:, 0], np.int64)
