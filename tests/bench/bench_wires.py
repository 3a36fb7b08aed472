"""What lines of a class gain (`classify.lines`): power lines of a simple generator over real towns (docs/wires.md).

    python tests/bench/bench_wires.py [delft] [town] [--density 1,2,4] [--seeds 11,12,13] [--data DIR] [--set a.b=value]

Lines of one to four wires hang between poles, clear of roofs, and through whatever crowns are in their way. A wire
returns a pulse that comes near it in just over half of the cases. Of the towns as many pulses are kept as give the
density. One part of a town trains, the other is tested, each with lines of its own; every row is a mean over seeds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
WIRE, POLE = 14, 1
TOWNS = {
    "delft": (
        ("other/delft_ahn3_1.laz",),
        ("other/delft_ahn3_2.laz",),
        {"ground": [2], "objects": [1], "building": [6]},
        28992,
    ),
    "town": (
        ("ign_hd/urban_7705*.laz",),
        ("ign_hd/urban_77060*.laz",),
        {"ground": [2], "vegetation": [3, 4, 5], "building": [6], "other": [1]},
        2154,
    ),
}
"""Files that train and files that are tested, codes of the classes, EPSG code."""
WIDTH, SEEN = 0.35, 0.55
"""m, pulses that touch a wire, and the share of them that it returns."""
FIELDS = ("return_number", "number_of_returns", "intensity", "gps_time", "point_source_id", "classification")

Points = dict[str, NDArray]


def read(data: Path, patterns: tuple[str, ...]) -> Points:
    clouds = [laspy.read(path) for pattern in patterns for path in sorted(data.glob(pattern))]
    names = ("x", "y", "z", *FIELDS)
    return {n: np.concatenate([np.asarray(getattr(cloud, n)) for cloud in clouds]) for n in names}


def thinned(points: Points, density: float, random: np.random.Generator) -> Points:
    """Every pulse as a whole, so that `density` echoes/m2 are left on average."""
    x, y = points["x"], points["y"]
    share = density * np.ptp(x) * np.ptp(y) / len(x)
    _, pulse = np.unique(points["gps_time"], return_inverse=True)
    keep = (random.random(pulse.max() + 1) < share)[pulse]
    return {n: values[keep] for n, values in points.items()}


def power_lines(points: Points, density: float, count: int, random: np.random.Generator) -> Points:
    """Echoes of wires and poles over a town of `density` echoes/m2, with as many lines as `count` or fit."""
    x, y, z, code = (points[n] for n in ("x", "y", "z", "classification"))
    ground, roofs = (cKDTree(np.c_[x, y][code == k]) for k in (2, 6))
    low, roof_z = z[code == 2], z[code == 6]
    bounds = np.array([[x.min(), y.min()], [x.max(), y.max()]])
    parts: list[NDArray] = []
    for _ in range(4000):
        if len(parts) >= 2 * count:
            break
        angle, span, spans = random.uniform(0, np.pi), random.uniform(20, 60), int(random.integers(1, 5))
        way, begin = np.array([np.cos(angle), np.sin(angle)]), random.uniform(*bounds)
        poles = begin + way * span * np.arange(spans + 1)[:, None]
        if (poles < bounds[0]).any() or (poles > bounds[1]).any():
            continue
        foot = np.median(low[ground.query(poles, k=5)[1]], axis=1)
        top, sag = foot + random.uniform(7.5, 11.0), random.uniform(0.3, 1.0)
        s = np.arange(0.0, span * spans, 1.0)
        under = roofs.query_ball_point(begin + way * s[:, None], 1.5)
        height = hanging(s, span, top, sag)
        if np.mean([bool(at) and roof_z[at].max() > h - 1.0 for at, h in zip(under, height, strict=True)]) > 0.02:
            continue
        wires, stacked = int(random.integers(1, 5)), random.random() < 0.5
        for k in range(wires):
            n = random.poisson(span * spans * density * WIDTH * SEEN)
            s = random.uniform(0, span * spans, n)
            aside = (0.0 if stacked else 0.7 * (k - (wires - 1) / 2)) + random.normal(0, 0.09, n)
            place = begin + way * s[:, None] + np.array([-way[1], way[0]]) * aside[:, None]
            up = hanging(s, span, top, sag + 0.1 * k) - (0.4 * k if stacked else 0.0) + random.normal(0, 0.03, n)
            parts.append(np.c_[place, up, np.full(n, WIRE), np.full(n, 2)])
        counts = random.poisson(2.0 * density, len(poles))
        place = np.repeat(poles, counts, axis=0) + random.normal(0, 0.12, (counts.sum(), 2))
        up = random.uniform(np.repeat(foot, counts) + 0.5, np.repeat(top, counts))
        parts.append(np.c_[place, up, np.full(len(up), POLE), np.full(len(up), 1)])
    echoes = np.concatenate(parts)
    echoes = echoes[((echoes[:, :2] > bounds[0]) & (echoes[:, :2] < bounds[1])).all(axis=1)]
    weak = np.percentile(points["intensity"], 8)
    return {
        **dict(zip("xyz", echoes[:, :3].T, strict=True)),
        "classification": echoes[:, 3].astype(np.uint8),
        "return_number": np.ones(len(echoes), np.uint8),
        "number_of_returns": echoes[:, 4].astype(np.uint8),
        "intensity": (random.uniform(0.3, 1.5, len(echoes)) * weak).astype(np.uint16),
        "gps_time": points["gps_time"].max() + 1 + 1e-5 * np.arange(len(echoes)),
        "point_source_id": np.full(len(echoes), points["point_source_id"][0]),
    }


def hanging(s: NDArray, span: float, top: NDArray, sag: float) -> NDArray:
    """Height of a wire [m] at the way `s` [m] along poles with these tops."""
    i = np.minimum((s // span).astype(int), len(top) - 2)
    f = s / span - i
    return top[i] * (1 - f) + top[i + 1] * f - sag * 4 * f * (1 - f)


def write(path: Path, points: Points, epsg: int) -> None:
    import pyproj

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [np.floor(points[n].min()) for n in "xyz"]
    header.add_crs(pyproj.CRS.from_epsg(epsg))
    cloud = laspy.LasData(header)
    for name, values in points.items():
        setattr(cloud, name, values)
    cloud.write(path)


def run(directory: Path, name: str, settings: list[str]) -> NDArray[np.float64]:
    """The confusion of a run, reference by row."""
    words = [w for text in settings for w in ("--set", text)]
    command = [
        sys.executable,
        "-P",
        "-m",
        "fwclass",
        "run",
        str(directory / "survey.yaml"),
        "--out",
        str(directory / name),
    ]
    ended = subprocess.run([*command, "--workers", "0", *words], capture_output=True, text=True)
    if ended.returncode not in (0, 4):
        raise SystemExit(ended.stderr)
    return np.array(json.loads((directory / name / "report.json").read_text())["accuracy"]["confusion"], float)


def figures(confusion: NDArray[np.float64]) -> list[float]:
    """Overall accuracy, mean IoU; IoU, detected and right of the wires [%]."""
    right, of, answered = confusion.diagonal(), confusion.sum(axis=1), confusion.sum(axis=0)
    iou = right / (of + answered - right)
    return [
        100 * v for v in (right.sum() / of.sum(), iou.mean(), iou[-1], right[-1] / of[-1], right[-1] / answered[-1])
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("towns", nargs="*", default=["delft", "town"])
    parser.add_argument("--density", default="1,2,4")
    parser.add_argument("--seeds", default="11,12,13")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--set", action="append", default=[])
    asked = parser.parse_args()
    ways = {"without": ["classify.lines.codes=[]"], "lines": []}
    print("town, echoes/m2, way: overall, mean IoU; wires: IoU, detected, right [%] (spread of the wires' IoU)")
    for town in asked.towns:
        train, test, classes, epsg = TOWNS[town]
        for density in map(float, asked.density.split(",")):
            rows: dict[str, list[list[float]]] = {way: [] for way in ways}
            for seed in map(int, asked.seeds.split(",")):
                with tempfile.TemporaryDirectory() as temporary:
                    directory, random = Path(temporary), np.random.default_rng(seed)
                    boxes = []
                    for name, patterns in (("train", train), ("test", test)):
                        points = thinned(read(asked.data, patterns), density, random)
                        more = power_lines(points, density, 5, random)
                        write(directory / f"{name}.laz", {n: np.r_[points[n], more[n]] for n in points}, epsg)
                        boxes.append([float(f(points[n])) for f in (np.min, np.max) for n in "xy"])
                    (directory / "survey.yaml").write_text(survey(classes, boxes))
                    for way, settings in ways.items():
                        rows[way].append(figures(run(directory, way, [f"train.seed={seed}", *settings, *asked.set])))
            for way, some in rows.items():
                mean, spread = np.mean(some, axis=0), np.std([r[2] for r in some])
                print(f"{town} {density:g} {way}:", *(f"{v:.2f}" for v in mean), f"(±{spread:.1f})", flush=True)


def survey(classes: dict[str, list[int]], boxes: list[list[float]]) -> str:
    rows = [f"    - {{name: {n}, code: {c[-1] if n != 'objects' else 5}, codes: {c}}}" for n, c in classes.items()]
    return "\n".join(
        [
            "survey:",
            "  name: wires",
            '  directory: "."',
            "  sources: [train.laz, test.laz]",
            "  reference: {kind: source}",
            "  classes:",
            *rows,
            f"    - {{name: wire, code: {WIRE}, codes: [{WIRE}]}}",
            f"areas: {{train: [{boxes[0]}], test: [{boxes[1]}], gap: 12}}",
            "classify: {context: {cells: []}}",
            "plausibility: {accept: true}",
        ]
    )


if __name__ == "__main__":
    main()
