"""What a graph cut over the class shares gains, alone and behind the layer in context (docs/context.md).

    python tests/bench/bench_regularize.py [p1train] [p1] [p4] [--data DIR] [--out DIR] [--seeds 1] [--set a.b=value]

Every echo keeps one of its classes, so that the sum of -log(share) over echoes and of the strength over neighbours of
different classes, times exp(-distance / (2 median distances)), is least: alpha-expansion (Boykov, Veksler and Zabih
2001) by scipy's maximum flow, one round of all classes. Neighbours are the 20 nearest, a metre of height counts as 4.
Blocks of the fixed grid are cut with a margin around each, so that no tile could change an answer; `--whole` cuts a
file at once, to see what the blocks cost. `p1train` leaves out one training tile of P1 at a time: strengths are chosen
there, and nowhere else. One layer alone: `--set classify.context.cells=[]`. Beside it the program's own mean field
(`classify.regularize`), which `--no-cut` measures alone.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import scipy
from bench_accuracy import DATA, judged, line, percents, splits
from numpy.typing import NDArray

from fwclass import conf
from fwclass.assess.confusion import confusion, figures
from fwclass.classes import ClassDef
from fwclass.classify.mean_field import agreed_shares
from fwclass.grid import millimetres
from fwclass.model.contextual import WHOLE
from fwclass.run.inputs import PartInputs
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner

NEIGHBOURS, HEIGHT, FALL = 20, 4.0, 2.0
"""Nearest echoes; what a metre of height counts; median distances over which weights fall to 1/e."""
BLOCK, MARGIN = 25.0, 5.0
"""m, squares of the fixed grid that are cut by themselves, and what is cut around them besides."""
LEAST = 0.01
"""Share of a class at least: a forest's 0 is no proof."""
UNIT = 1000
"""Energies are whole numbers of this part of a nat, so that flows are exact."""

Echoes = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]
"""Places (echoes, 3) [m], shares (echoes, classes), reference codes."""


def links(xyz: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Pairs of neighbours, each once, and their weights."""
    places = xyz * [1.0, 1.0, HEIGHT]
    count = min(NEIGHBOURS + 1, len(places))
    distance, near = scipy.spatial.cKDTree(places).query(places, count)
    own = np.repeat(np.arange(len(places)), count)
    low, high = np.minimum(own, near.ravel()), np.maximum(own, near.ravel())
    _, first = np.unique(low * len(places) + high, return_index=True)
    first = first[low[first] < high[first]]
    apart = distance.ravel()[first]
    return low[first], high[first], np.exp(-apart / max(FALL * float(np.median(apart)), 1e-3)) if len(apart) else apart


def cut(xyz: NDArray[np.float64], shares: NDArray[np.float64], strength: float) -> NDArray[np.int64]:
    """Class of every echo, int64 (echoes,)."""
    one, other, weight = links(xyz)
    cost = np.rint(-UNIT * np.log(np.maximum(shares, LEAST))).astype(np.int64)
    weight = np.rint(UNIT * strength * weight).astype(np.int64)
    every = np.arange(len(cost))
    label = shares.argmax(axis=1)

    def energy(label: NDArray[np.int64]) -> int:
        return int(cost[every, label].sum() + weight[label[one] != label[other]].sum())

    for k in range(shares.shape[1]):
        better = np.where(_changed(cost[:, k] - cost[every, label], label, k, one, other, weight), k, label)
        if energy(better) < energy(label):
            label = better
    return label


def _changed(
    gain: NDArray[np.int64],
    label: NDArray[np.int64],
    k: int,
    one: NDArray[np.int64],
    other: NDArray[np.int64],
    weight: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Which echoes change to class k by the least cut (Kolmogorov and Zabih 2004, for two labels)."""
    none, first, second = (weight * m for m in (label[one] != label[other], label[one] != k, label[other] != k))
    gain = gain.copy()
    np.add.at(gain, one, second - none)
    np.add.at(gain, other, -second)
    capacity = first + second - none
    source, sink, held = len(gain), len(gain) + 1, capacity > 0
    up, down = np.flatnonzero(gain > 0), np.flatnonzero(gain < 0)
    rows = np.concatenate([np.full(len(up), source), down, one[held]])
    cols = np.concatenate([up, np.full(len(down), sink), other[held]])
    values = np.concatenate([gain[up], -gain[down], capacity[held]]).astype(np.int32)
    graph = scipy.sparse.csr_array((values, (rows, cols)), (sink + 1, sink + 1))
    left = graph - scipy.sparse.csgraph.maximum_flow(graph, source, sink, method="dinic").flow
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    kept = scipy.sparse.csgraph.breadth_first_order(left, source, return_predecessors=False)
    changed = np.ones(sink + 1, bool)
    changed[kept] = False
    return changed[: len(gain)]


def by_blocks(xyz: NDArray[np.float64], shares: NDArray[np.float64], strength: float) -> NDArray[np.int64]:
    """As `cut`, block by block of the fixed grid."""
    answer = np.empty(len(xyz), np.int64)
    square = np.floor(xyz[:, :2] / BLOCK)
    for corner in np.unique(square, axis=0):
        core = (square == corner).all(axis=1)
        low, high = BLOCK * corner - MARGIN, BLOCK * (corner + 1) + MARGIN
        near = np.flatnonzero(((xyz[:, :2] >= low) & (xyz[:, :2] < high)).all(axis=1))
        answer[core] = cut(xyz[near], shares[near], strength)[core[near]]
    return answer


def by_mean_field(xyz: NDArray[np.float64], shares: NDArray[np.float64], strength: float) -> NDArray[np.int64]:
    """Class of every echo by the program's own mean field."""
    params = conf.section("classify", (f"classify.regularize.strength={strength}",)).regularize
    whole = np.rint(shares * WHOLE).astype(np.uint8)
    return agreed_shares(millimetres(xyz), whole, np.arange(len(xyz)), params).argmax(axis=1)


def answered(root: Path, codes: list[int]) -> Echoes:
    """What a run's model says of the echoes of all tiles."""
    with Display() as display:
        inputs = PartInputs(Runner(root / "test", Loop(), display).store)
    columns = [f"probability_{code}" for code in codes]
    parts = []
    for tile in sorted(p.name for p in (root / "test" / "store" / "classify").iterdir() if p.is_dir()):
        place = inputs.table("tile", tile, ("x", "y", "z"))
        shares = inputs.table("classify", tile, columns)
        reference = inputs.table("label", tile, ("reference",))["reference"]
        parts.append((np.stack([place[n] for n in "xyz"], 1), np.stack([shares[n] for n in columns], 1), reference))
    xyz, share, reference = zip(*parts, strict=True)
    return np.concatenate(xyz), np.concatenate(share).astype(np.float64), np.concatenate(reference)


def tell(name: str, classes: tuple[ClassDef, ...], echoes: list[Echoes], answer: Callable[..., NDArray]) -> None:
    codes = np.array([c.code for c in classes], np.uint8)
    began = time.process_time()
    matrices = [confusion(ref, codes[answer(xyz, shares)], classes) for xyz, shares, ref in echoes]
    spent = 1e6 * (time.process_time() - began) / sum(len(ref) for *_, ref in echoes)
    names = [c.name for c in classes]
    by_split = "  ".join("/".join(f"{v:.2f}" for v in percents(figures(m, names))) for m in matrices)
    print(line(name, percents(figures(np.sum(matrices, axis=0), names))) + f"{spent:>8.1f} µs   {by_split}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("protocols", nargs="*", default=["p1train"])
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seeds", default="1")
    parser.add_argument("--strengths", default="0.1,0.2,0.4")
    parser.add_argument("--fields", default="0.1,0.15,0.2")
    parser.add_argument("--no-cut", action="store_true")
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--set", dest="settings", action="append", default=[])
    chosen = parser.parse_args()
    if not (chosen.data / "km_0299_6802.laz").exists():
        sys.exit(f"no data in {chosen.data}: nothing measured")
    settings = (*chosen.settings, "classify.probabilities=true")
    with tempfile.TemporaryDirectory() as scratch:
        root = (chosen.out or Path(scratch)).resolve()
        for protocol in chosen.protocols:
            parts = splits(protocol)
            classes = conf.load(parts[0][0], (f"survey.directory={chosen.data.resolve()}",)).classes
            for seed in chosen.seeds.split(","):
                echoes = []
                for k, split in enumerate(parts):
                    place = root / f"{protocol}-{k}"
                    judged(split, int(seed), place, chosen.data.resolve(), settings)
                    echoes.append(answered(place, [c.code for c in classes]))
                print(f"\n{protocol}, seed {seed}{'':<30}overall    kappa  mean IoU, then each split")
                tell("as the model says", classes, echoes, lambda xyz, shares: shares.argmax(axis=1))
                for strength in map(float, chosen.fields.split(",")):
                    tell(f"mean field, {strength:g}", classes, echoes, partial(by_mean_field, strength=strength))
                for strength in map(float, () if chosen.no_cut else chosen.strengths.split(",")):
                    how = partial(cut if chosen.whole else by_blocks, strength=strength)
                    tell(f"graph cut, {strength:g}", classes, echoes, how)


if __name__ == "__main__":
    main()
