"""How far strips lie apart in plan, measured and known: lines of public surveys, and one town moved by a known way.

    python tests/bench/bench_offsets.py [--data DIR]

The town's pulses are drawn into two strips, of which the second is moved; lines of surveys are told apart by their
point source. Data are not part of this repository (IGN, AHN); without them it says so.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.grid import Box, Window
from fwclass.quality.offsets import Offsets, slope_pairs
from fwclass.quality.params import PlaneParams
from fwclass.quality.planes import plane_pairs, planes_of

DATA = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
SURVEYS = {
    "town": "ign_hd/urban_*.laz",
    "bat": "ign_hd/bat.laz",
    "crop_1": "ign_hd/crop_1.laz",
    "Delft": "other/delft_ahn3_1.laz",
}
SHARES = (0.45, 0.2, 0.06)
MOVED = ((0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (1.5, 0.0, 0.0), (0.0, -1.0, 0.2), (2.0, 1.0, 0.0), (3.0, 0.0, 0.0))


def singles(paths: list[Path]) -> dict[str, NDArray]:
    """Single returns of some files: place [m], line and time."""
    names = {"x": "x", "y": "y", "z": "z", "line": "point_source_id", "time": "gps_time", "of": "number_of_returns"}
    clouds = [laspy.read(p) for p in paths]
    whole = {n: np.concatenate([np.asarray(c[field]) for c in clouds]) for n, field in names.items()}
    return {n: values[whole["of"] == 1] for n, values in whole.items()}


def measured(xyz: NDArray, piece: NDArray, params: PlaneParams) -> list[tuple[int, int, dict[str, float]]]:
    """Offsets of every two pieces that slopes tell."""
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0) + 0.001
    box = Box(float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    flat = plane_pairs(planes_of(*xyz.T, piece, Window.covering(box, params.cell), params))
    steep = params.model_copy(update={"max_slope": params.steepest})
    planes = planes_of(*xyz.T, piece, Window.covering(box, params.slope_cell), steep)
    offsets = Offsets()
    offsets.add(slope_pairs(planes, params.max_slope), np.arange(piece.max() + 1))
    out = []
    for a, b in np.unique(np.stack([flat.first, flat.second], axis=1), axis=0).tolist():
        dz = flat.dz[(flat.first == a) & (flat.second == b) & (np.abs(flat.dz) <= params.max_step)]
        facts = offsets.facts(a, b, float(dz.mean()), len(dz)) if len(dz) else None
        if facts is not None:
            out.append((a, b, facts))
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA)
    data = parser.parse_args().data
    if not sorted(data.glob(SURVEYS["town"])):
        print(f"no data in {data}")
        return 0
    params = conf.section("quality").planes
    for name, pattern in SURVEYS.items():
        cloud = singles(sorted(data.glob(pattern)))
        line, piece = np.unique(cloud["line"], return_inverse=True)
        for a, b, f in measured(np.column_stack([cloud[n] for n in "xyz"]), piece, params):
            way = f"{f['east']:+.3f} east {f['north']:+.3f} north"
            print(f"{name:<8} {line[a]} of {line[b]}: {way}, {f['distance']:.3f} ± {f['error']:.3f} m, {f['slopes']}")
    cloud = singles(sorted(data.glob(SURVEYS["town"])))
    drawn = np.random.default_rng(1).random(len(cloud["x"]))
    xyz = np.column_stack([cloud[n] for n in "xyz"])
    for share in SHARES:
        some = drawn < 2 * share
        piece = (drawn[some] >= share).astype(np.int64)
        for moved in MOVED:
            began = time.process_time()
            found = measured(xyz[some] + piece[:, None] * np.array(moved), piece, params)
            off = [np.hypot(f["east"] + moved[0], f["north"] + moved[1]) for _, _, f in found]
            told = f"{off[0]:.3f} m off, ± {found[0][2]['error']:.3f}" if found else "not told"
            print(f"town, {share:.2f} of the pulses, moved by {moved}: {told}; {time.process_time() - began:.2f} CPU-s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
