"""Crowns in a real street: one labelled sweep of a spinning scanner (SemanticKITTI 00, sweep 0).

`python tests/bench/bench_street_kitti.py FOLDER`: FOLDER holds kitti00_000000.bin and .label, which are not part of the
project. Returns within 30 m, vegetation against the rest, depth is |y|. Its rings turn about a mast, so neighbours come
from a k-d tree; formulas are those of `fwclass street`. Error, detection, false alarm in %.

- other side: trained on y < 0, judged on y > 0. Features and method are chosen on folds of the training side, four
  pieces of street; the other side is looked at once.
- unseen piece: the street in four pieces along x, each judged by what was chosen, and trained, on the other three.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fwclass import conf
from fwclass.classify.shares import answer
from fwclass.hashing import hash_keys
from fwclass.model import ClassDef, assemble
from fwclass.street.sphere_kernels import SUMS, UNIT, features_of
from fwclass.train.baselines.stage import train_other
from fwclass.train.sample import Sample
from fwclass.train.stage import card, grow_trees

CLASSES = (ClassDef("crown", 5, (5,)), ClassDef("other", 1, (1,)))
VEGETATION, FAR = 70, 30.0


def sweep(folder: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Places (n, 3) [m] and class index (n,), 0 vegetation."""
    points = np.fromfile(folder / "kitti00_000000.bin", "<f4").reshape(-1, 4)[:, :3].astype(float)
    labels = np.fromfile(folder / "kitti00_000000.label", "<u4") & 0xFFFF
    keep = (labels > 1) & (np.linalg.norm(points, axis=1) < FAR)
    return points[keep], (labels[keep] != VEGETATION).astype(np.uint8)


def features(points: NDArray[np.float64], radius: float) -> NDArray[np.float32]:
    """The eleven features of every return, by a k-d tree."""
    units = np.rint(points / UNIT)
    tree = cKDTree(units)
    out = np.empty((len(points), 11), np.float32)
    for first in range(0, len(points), 2000):
        here = units[first : first + 2000]
        lists = tree.query_ball_point(here, radius / UNIT)
        ends = np.cumsum([len(i) for i in lists])
        apart = units[np.concatenate(lists)] - np.repeat(here, np.diff(ends, prepend=0), axis=0)
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
        features_of(sums, y, z, 0.0, False, out[first : first + 2000])
    return out


def above_lowest(points: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """Height above the lowest return of the cell of `cell` metres and of the eight around it."""
    at = np.floor(points[:, :2] / cell).astype(int)
    at -= at.min(axis=0) - 1
    low = np.full(at.max(axis=0) + 2, np.inf)
    np.minimum.at(low, tuple(at.T), points[:, 2])
    near = [low[at[:, 0] + i, at[:, 1] + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return points[:, 2] - np.min(near, axis=0)


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


def candidates(points: NDArray[np.float64]) -> dict[str, tuple[NDArray, str]]:
    """All that is chosen from: features by name, and the method."""
    one = {r: features(points, r) for r in (0.3, 0.6, 1.0)}
    height, reach = above_lowest(points, 6.0), np.linalg.norm(points, axis=1)
    shape = [k for k in range(11) if k not in (0, 3)]
    no_count = [k for k in shape if k != 6]
    two = np.column_stack([*(one[r][:, shape] for r in (0.3, 0.6)), height, reach])
    three = np.column_stack([*(one[r][:, shape] for r in one), height, reach])
    free = np.column_stack([*(one[r][:, no_count] for r in one), height])
    density = [np.log(one[r][:, 6]) + 2.0 * np.log(reach) for r in one]  # of a surface, whatever its range
    dense = np.column_stack([free, *density])
    deep = np.column_stack([dense, np.abs(points[:, 1])])
    made = {f"paper's 11, {r} m": (one[r], "rbf-svm") for r in (0.3, 0.6)}
    for name, X in (
        ("two radii, height, range", two),
        ("three radii, height, range", three),
        ("three radii, height", free),
        ("three radii, height, density", dense),
        ("and depth", deep),
    ):
        made |= {f"{name}: {method}": (X, method) for method in ("forest", "boosting")}
    return made


def chosen(tries, y, train, groups) -> tuple[str, float]:
    """The candidate that errs least on folds of `train`, whose blocks of street are `groups`, and its error there."""
    errors = {}
    for name, (X, method) in tries.items():
        wrong = 0
        for one in np.unique(groups[train]):
            test = train & (groups == one)
            got = answers(X, y, train & (groups != one), test, method, most=8000, trees=25)
            wrong += int((got != y[test]).sum())
        errors[name] = wrong / int(train.sum())
    best = min(errors, key=errors.__getitem__)
    return best, errors[best]


def main() -> None:
    points, y = sweep(Path(sys.argv[1]))
    print(f"{len(y)} returns, {100 * (y == 0).mean():.1f} % vegetation; error / detection / false alarm, %")
    tries = candidates(points)
    x, side = points[:, 0], points[:, 1]
    chance = np.random.default_rng(1).random(len(y)) < 0.05
    piece = np.searchsorted(np.quantile(x, (0.25, 0.5, 0.75)), x)  # of the street, as many returns in each
    for name, (X, method) in list(tries.items())[:2]:
        cells = [
            f"{kind} {figures(y[test], answers(X, y, train, test, method))}"
            for kind, train, test in (("random 5 %", chance, ~chance), ("other side", side < 0, side > 0))
        ]
        print(f"  {name:<20}", "   ".join(cells), flush=True)
    train, test = side < 0, side > 0
    name, error = chosen(tries, y, train, piece)
    X, method = tries[name]
    print(
        f"  other side {figures(y[test], answers(X, y, train, test, method))}   {name}, {100 * error:.1f} on its folds"
    )
    answered = np.empty_like(y)
    for one in range(4):
        train, test = piece != one, piece == one
        name, error = chosen(tries, y, train, piece)
        X, method = tries[name]
        answered[test] = answers(X, y, train, test, method)
        print(
            f"    piece {one} {figures(y[test], answered[test])}   {name}, {100 * error:.1f} on its folds", flush=True
        )
    print(f"  unseen piece of street, all four {figures(y, answered)}")


if __name__ == "__main__":
    main()
