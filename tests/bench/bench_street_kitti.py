"""Crowns in a real street: one labelled sweep of a spinning scanner (SemanticKITTI 00, sweep 0).

`python tests/bench/bench_street_kitti.py FOLDER`: FOLDER holds kitti00_000000.bin and .label, which are not part of the
project. Returns within 30 m, vegetation against the rest, depth is |y|. Its rings turn about a mast, so neighbours come
from a k-d tree; formulas are those of `fwclass street`. Error, detection, false alarm in %.

- other side: trained on y < 0, judged on y > 0.
- plain: the features of `fwclass street`, without and with intensities, as they are; and a recipe whose figures on a
  whole other street are known (error 5.3, detection 84.4, false alarm 2.9).
- unseen piece: the street in four pieces along x, each judged by what was chosen, and trained, on the other three.

Features and methods are chosen on folds of what trains: six sectors about the mast, each judged by the others less a
gap of four degrees to both sides. The two that err least answer together, by the mean of their shares; folds say too
within which radius the shares of neighbours are averaged, if at all (`street.smooth`). What is reported is looked at
once.
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

RECIPE = "recipe of 5.3 % elsewhere: two radii, height, range"
"""Known from a whole other street."""

SMOOTH = (0.0, 0.3, 0.6)
"""m, radii that shares are averaged within; 0: not at all."""

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


def figures(y: NDArray[np.uint8], share: NDArray[np.float64]) -> str:
    answered = share < 0.5
    error = (answered != y).mean()
    detection, alarm = 1.0 - answered[y == 0].mean(), 1.0 - answered[y == 1].mean()
    return f"{100 * error:5.1f} / {100 * detection:5.1f} / {100 * alarm:5.1f}"


def shares(X, y, train, test, method, most=40000, trees=100) -> NDArray[np.float64]:
    """Share of vegetation of the rows that test."""
    model = fitted(X[train], y[train], method, most, trees)
    return np.asarray(answer(np.ascontiguousarray(X[test], np.float32), model)[1][:, 0])


def smoothed(points: NDArray[np.float64], share: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Means of `share` within the spheres of `points`."""
    if radius == 0:
        return share
    tree, out = cKDTree(points), np.empty(len(points))
    for first in range(0, len(points), 2000):
        lists = tree.query_ball_point(points[first : first + 2000], radius)
        count = np.array([len(i) for i in lists])
        sums = np.add.reduceat(share[np.concatenate(lists).astype(np.int64)], np.r_[0, np.cumsum(count)[:-1]])
        out[first : first + 2000] = sums / count
    return out


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
    tries[RECIPE] = np.column_stack([*(one[r][:, sorted([*shape, 6])] for r in (0.3, 0.6)), low, reach]), "forest"
    for name, parts in named.items():
        tries |= {f"{name}: {method}": (np.column_stack(parts), method) for method in ("forest", "boosting")}
    return tries


def chosen(tries, points, y, train, azimuth) -> tuple[tuple[str, str], float]:
    """The two candidates that err least on folds of `train`, sectors of `azimuth` [deg], and the radius that their mean
    shares are averaged within."""
    edges = np.quantile(azimuth[train], np.linspace(0.0, 1.0, SECTORS + 1))
    edges[-1] += 1.0
    folds = [(first, last, train & (azimuth >= first) & (azimuth < last)) for first, last in pairwise(edges)]
    known, errors = {}, {}

    def error(share: NDArray[np.float64]) -> float:
        return 100 * float(((share < 0.5) != y)[train].mean())

    for name, (X, method) in tries.items():
        if name.startswith((OWN, RECIPE)):
            continue
        share = np.empty(len(y))
        for first, last, test in folds:
            apart = np.abs((azimuth - 0.5 * (first + last) + 180.0) % 360.0 - 180.0) - 0.5 * (last - first)
            share[test] = shares(X, y, train & (apart > GAP), test, method, most=8000, trees=25)
        known[name], errors[name] = share, error(share)
        print(f"      {name:<50}{errors[name]:5.1f}", flush=True)
    first, second = sorted(errors, key=errors.__getitem__)[:2]
    mean, by_radius = 0.5 * (known[first] + known[second]), {}
    for radius in SMOOTH:
        share = np.empty(len(y))
        for _, _, test in folds:
            share[test] = smoothed(points[test], mean[test], radius)
        by_radius[radius] = error(share)
    print("      the best two, smoothed within", *(f"{r:g} m {e:.1f}  " for r, e in by_radius.items()), flush=True)
    return (first, second), min(by_radius, key=by_radius.__getitem__)


def by_choice(tries, points, y, train, test, azimuth) -> NDArray[np.float64]:
    """Shares of the rows that test, by what folds of `train` choose."""
    names, radius = chosen(tries, points, y, train, azimuth)
    mean = np.mean([shares(X, y, train, test, method) for X, method in (tries[n] for n in names)], axis=0)
    print(f"      {' + '.join(names)}: {figures(y[test], mean)}, within {radius:g} m", flush=True)
    return smoothed(points[test], mean, radius)


def plain(tries, points, y, side, piece) -> None:
    """Nothing is chosen: the recipe, and the features of `fwclass street`, the latter also smoothed."""
    for name in (n for n in tries if n.startswith((OWN, RECIPE))):
        X, method = tries[name]
        share, there = np.empty(len(y)), side > 0
        for one in range(4):
            share[piece == one] = shares(X, y, piece != one, piece == one, method)
        other = shares(X, y, side < 0, there, method)
        for radius in SMOOTH[:1] if name == RECIPE else SMOOTH:
            even = np.empty(len(y))
            for one in range(4):
                even[piece == one] = smoothed(points[piece == one], share[piece == one], radius)
            across = figures(y[there], smoothed(points[there], other, radius))
            print(f"  {name:<58} {radius:g} m  other side {across}   unseen pieces {figures(y, even)}", flush=True)


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
            f"{kind} {figures(y[test], shares(X, y, train, test, method))}"
            for kind, train, test in (("random 5 %", chance, ~chance), ("other side", side < 0, side > 0))
        ]
        print(f"  {name:<20}", "   ".join(cells), flush=True)
    plain(tries, points, y, side, piece)
    test = side > 0
    print(f"  other side {figures(y[test], by_choice(tries, points, y, side < 0, test, azimuth))}")
    share = np.empty(len(y))
    for one in range(4):
        test = piece == one
        share[test] = by_choice(tries, points, y, ~test, test, azimuth)
        print(f"    piece {one} {figures(y[test], share[test])}", flush=True)
    print(f"  unseen piece of street, all four {figures(y, share)}")


if __name__ == "__main__":
    main()
