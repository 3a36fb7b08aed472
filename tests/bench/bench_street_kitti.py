"""Crowns in a real street: one labelled sweep of a spinning scanner (SemanticKITTI 00, sweep 0).

`python tests/bench/bench_street_kitti.py FOLDER`: FOLDER holds kitti00_000000.bin and .label, which are not part of the
project. Returns within 30 m, vegetation against the rest, depth is |y|. Its rings turn about a mast, so neighbours come
from a k-d tree; formulas are those of `fwclass street`. Error, detection, false alarm in %.

- other side: trained on y < 0, judged on y > 0.
- own: the features of `fwclass street`, without and with intensities, as they are.
- unseen piece: the street in four pieces along x, each judged by what was chosen, and trained, on the other three.

Features and method are chosen on folds of what trains: six sectors about the mast, each judged by the others less a gap
of four degrees to both sides. What is reported is looked at once.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from fwclass import conf
from fwclass.classify.shares import answer
from fwclass.hashing import hash_keys
from fwclass.model import ClassDef, assemble
from fwclass.street.frames import levels_of
from fwclass.street.sphere_kernels import SUMS, UNIT, features_of
from fwclass.train.baselines.stage import train_other
from fwclass.train.sample import Sample
from fwclass.train.stage import card, grow_trees

CLASSES = (ClassDef("crown", 5, (5,)), ClassDef("other", 1, (1,)))
VEGETATION, FAR = 70, 30.0

RADII = (0.3, 0.6, 1.0)
"""m, of the spheres."""

OWN = "fwclass street"
"""What the program itself has, by name."""

SECTORS, GAP = 6, 4.0
"""Folds about the mast, and the degrees to both sides of one that do not train for it."""


def sweep(folder: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
    """Places (n, 3) [m], intensity (n,) and class index (n,), 0 vegetation."""
    points = np.fromfile(folder / "kitti00_000000.bin", "<f4").reshape(-1, 4).astype(float)
    labels = np.fromfile(folder / "kitti00_000000.label", "<u4") & 0xFFFF
    keep = (labels > 1) & (np.linalg.norm(points[:, :3], axis=1) < FAR)
    return points[keep, :3], points[keep, 3], (labels[keep] != VEGETATION).astype(np.uint8)


def features(points: NDArray[np.float64], intensity: NDArray[np.float64], radius: float) -> NDArray[np.float32]:
    """The eleven features of every return, by a k-d tree; mean and standard deviation of the sphere's intensities."""
    units, levels = np.rint(points / UNIT), levels_of(intensity.astype(np.float32), 1.0).astype(np.int64)
    tree = cKDTree(units)
    out = np.empty((len(points), 13), np.float32)
    for first in range(0, len(points), 2000):
        here = units[first : first + 2000]
        lists = tree.query_ball_point(here, radius / UNIT)
        ends = np.cumsum([len(i) for i in lists])
        members = np.concatenate(lists).astype(np.int64)
        apart = units[members] - np.repeat(here, np.diff(ends, prepend=0), axis=0)
        starts = np.r_[0, ends[:-1]]
        sums = np.empty((len(here), SUMS), np.int64)
        sums[:, 0] = np.diff(ends, prepend=0)
        for k in range(3):
            sums[:, 1 + k] = np.add.reduceat(apart[:, k], starts)
            sums[:, 4 + k] = np.add.reduceat(apart[:, k] ** 2, starts)
        for k, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
            sums[:, 7 + k] = np.add.reduceat(apart[:, a] * apart[:, b], starts)
        for k, axis in enumerate((1, 2)):
            sums[:, 10 + 2 * k] = np.minimum.reduceat(apart[:, axis], starts)
            sums[:, 11 + 2 * k] = np.maximum.reduceat(apart[:, axis], starts)
        y, z = (here[:, k].astype(np.int32) for k in (1, 2))
        there = out[first : first + 2000]
        for k in (1, 2):
            sums[:, 13 + k] = np.add.reduceat(levels[members] ** k, starts)
        features_of(sums, y, z, 0.0, False, there)
    return out


def above_lowest(points: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """Height above the lowest return of the cell of `cell` metres and of the eight around it."""
    at = np.floor(points[:, :2] / cell).astype(int)
    at -= at.min(axis=0) - 1
    low = np.full(at.max(axis=0) + 2, np.inf)
    np.minimum.at(low, tuple(at.T), points[:, 2])
    near = [low[at[:, 0] + i, at[:, 1] + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return points[:, 2] - np.min(near, axis=0)


def above_ground(points: NDArray[np.float64], cell: float = 2.0) -> NDArray[np.float64]:
    """Height above a ground that bends and slopes: a quadratic surface through the low returns of cells of `cell`
    metres, drawn down on the lowest of them step by step, and what those that stay near it lie off it around."""
    at, of = np.unique(np.floor(points[:, :2] / cell), axis=0, return_inverse=True)
    cells = [np.flatnonzero(of == k) for k in range(len(at))]
    centre = np.array([points[rows, :2].mean(axis=0) for rows in cells])
    low = np.array([np.percentile(points[rows, 2], 3.0) for rows in cells])
    ground = np.ones(len(low), bool)
    for step in range(30):
        surface = np.linalg.lstsq(_quadratic(centre[ground]), low[ground], rcond=None)[0]
        off = low - _quadratic(centre) @ surface
        ground = (off > -1.0) & (off < max(0.3, 2.0 * 0.8**step))
    apart, near = cKDTree(centre[ground]).query(points[:, :2], k=6)
    weight = 1.0 / (apart + 1.0) ** 2
    local = (off[ground][near] * weight).sum(axis=1) / weight.sum(axis=1)
    return np.asarray(points[:, 2] - _quadratic(points[:, :2]) @ surface - local)


def _quadratic(at: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = at.T / 10.0
    return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def column(points: NDArray[np.float64], height: NDArray[np.float64], wide: int) -> NDArray[np.float64]:
    """What stands below and above every return in a column of `wide` × `wide` cells of 0.5 m, by layers of 0.25 m of
    `height`: the lowest layer, those to the highest, share of empty ones below, filled ones without a gap downwards
    and upwards, and all filled ones."""
    at = np.floor(points[:, :2] / 0.5).astype(int)
    at -= at.min(axis=0)
    layer = np.clip((height / 0.25).astype(int) + 2, 0, 63)[:, None]
    filled = np.zeros((*(at.max(axis=0) + 1), 64), bool)
    filled[at[:, 0], at[:, 1], layer[:, 0]] = True
    here, k = maximum_filter(filled, (wide, wide, 1))[at[:, 0], at[:, 1]], np.arange(64)
    below, above = ~here & (k < layer), ~here & (k > layer)
    own = layer[:, 0]
    return np.column_stack(
        [
            here.argmax(axis=1),
            63 - here[:, ::-1].argmax(axis=1) - own,
            (below & (k > 2)).sum(axis=1) / np.maximum(own - 3, 1),
            own - np.where(below, k, -1).max(axis=1),
            np.where(above, k, 64).min(axis=1) - own,
            here.sum(axis=1),
        ]
    )


def fitted(X, y, method, most=40000, trees=100):
    config = conf.load("street-sim", (f"train.method={method}", f"train.trees={trees}"))
    rng = np.random.default_rng(1)
    rows = rng.permutation(len(y))[:most]
    rows.sort()
    names = tuple(f"f{k}" for k in range(X.shape[1]))
    key = rows.astype(np.uint64)
    sample = Sample(
        names, np.ascontiguousarray(X[rows], np.float32), y[rows], key, hash_keys(1, key), np.bincount(y, minlength=2)
    )
    if method == "forest":
        train = config.train
        return assemble(grow_trees(sample, CLASSES, 0, train.trees, train), card(sample, CLASSES, train))
    rbf = config.compare.rbf_svm.model_copy(update={"max_rows": 6000, "c": (10.0,), "gamma": (0.1,)})
    return train_other(sample, config.train, config.compare.model_copy(update={"rbf_svm": rbf}), CLASSES, method)


def figures(y: NDArray[np.uint8], answered: NDArray[np.uint8]) -> str:
    error = (y != answered).mean()
    detection, alarm = (answered[y == 0] == 0).mean(), (answered[y == 1] == 0).mean()
    return f"{100 * error:5.1f} / {100 * detection:5.1f} / {100 * alarm:5.1f}"


def answers(X, y, train, test, method, most=40000, trees=100) -> NDArray[np.uint8]:
    model = fitted(X[train], y[train], method, most, trees)
    return np.asarray(answer(np.ascontiguousarray(X[test], np.float32), model)[0])


def candidates(points: NDArray[np.float64], intensity: NDArray[np.float64]) -> dict[str, tuple[NDArray, str]]:
    """All that is chosen from: features by name, and the method."""
    one = {r: features(points, intensity, r) for r in RADII}
    low, ground, reach = above_lowest(points, 6.0), above_ground(points), np.linalg.norm(points, axis=1)
    shape = [1, 2, 4, 5, 7, 8, 9, 10]
    three = np.column_stack([one[r][:, shape] for r in RADII])
    lit = np.column_stack([one[r][:, 11:] for r in RADII])
    density = np.column_stack([np.log(one[r][:, 6]) + 2.0 * np.log(reach) for r in RADII])  # of a surface, at any range
    columns = np.column_stack([column(points, ground, wide) for wide in (1, 3, 5)])
    whole = [one[r][:, :11] for r in RADII]
    named = {
        f"{OWN}, three radii": tuple(whole),
        f"{OWN}, three radii, intensity": (*whole, lit),
        "three radii, height": (three, low),
        "three radii, ground": (three, ground),
        "three radii, ground, density": (three, ground, density),
        "three radii, ground, columns": (three, ground, columns),
        "three radii, ground, intensity": (three, ground, lit),
        "three radii, ground, intensity, columns": (three, ground, lit, columns),
    }
    tries: dict[str, tuple[NDArray, str]] = {f"paper's 11, {r} m": (one[r][:, :11], "rbf-svm") for r in (0.3, 0.6)}
    for name, parts in named.items():
        tries |= {f"{name}: {method}": (np.column_stack(parts), method) for method in ("forest", "boosting")}
    return tries


def chosen(tries, y, train, azimuth) -> tuple[str, float]:
    """The candidate, but for `own`, that errs least on folds of `train`, sectors of `azimuth` [deg], and its error."""
    edges = np.quantile(azimuth[train], np.linspace(0.0, 1.0, SECTORS + 1))
    edges[-1] += 1.0
    errors = {}
    for name, (X, method) in tries.items():
        if name.startswith(OWN):
            continue
        wrong = 0
        for first, last in pairwise(edges):
            test = train & (azimuth >= first) & (azimuth < last)
            apart = np.abs((azimuth - 0.5 * (first + last) + 180.0) % 360.0 - 180.0) - 0.5 * (last - first)
            got = answers(X, y, train & (apart > GAP), test, method, most=8000, trees=25)
            wrong += int((got != y[test]).sum())
        errors[name] = wrong / int(train.sum())
        print(f"      {name:<50}{100 * errors[name]:5.1f}", flush=True)
    best = min(errors, key=errors.__getitem__)
    return best, errors[best]


def own(tries, y, side, piece) -> None:
    """The features of `fwclass street` at three radii, without and with intensities; nothing is chosen."""
    for name in (n for n in tries if n.startswith(OWN)):
        X, method = tries[name]
        answered = np.empty_like(y)
        for one in range(4):
            answered[piece == one] = answers(X, y, piece != one, piece == one, method)
        other = figures(y[side > 0], answers(X, y, side < 0, side > 0, method))
        print(f"  {name:<50} other side {other}   unseen pieces {figures(y, answered)}", flush=True)


def main() -> None:
    points, intensity, y = sweep(Path(sys.argv[1]))
    print(f"{len(y)} returns, {100 * (y == 0).mean():.1f} % vegetation; error / detection / false alarm, %")
    tries = candidates(points, intensity)
    x, side = points[:, 0], points[:, 1]
    azimuth = np.degrees(np.arctan2(side, x))
    chance = np.random.default_rng(1).random(len(y)) < 0.05
    piece = np.searchsorted(np.quantile(x, (0.25, 0.5, 0.75)), x)  # of the street, as many returns in each
    for name, (X, method) in list(tries.items())[:2]:
        cells = [
            f"{kind} {figures(y[test], answers(X, y, train, test, method))}"
            for kind, train, test in (("random 5 %", chance, ~chance), ("other side", side < 0, side > 0))
        ]
        print(f"  {name:<20}", "   ".join(cells), flush=True)
    own(tries, y, side, piece)
    train, test = side < 0, side > 0
    name, error = chosen(tries, y, train, azimuth)
    X, method = tries[name]
    print(
        f"  other side {figures(y[test], answers(X, y, train, test, method))}   {name}, {100 * error:.1f} on its folds"
    )
    answered = np.empty_like(y)
    for one in range(4):
        train, test = piece != one, piece == one
        name, error = chosen(tries, y, train, azimuth)
        X, method = tries[name]
        answered[test] = answers(X, y, train, test, method)
        print(
            f"    piece {one} {figures(y[test], answered[test])}   {name}, {100 * error:.1f} on its folds", flush=True
        )
    print(f"  unseen piece of street, all four {figures(y, answered)}")


if __name__ == "__main__":
    main()
