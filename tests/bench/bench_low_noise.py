"""The ground of data with low noise, with and without `ground.noise.surface` (docs/ground.md).

    python tests/bench/bench_low_noise.py [--share 0,0.005,0.02] [--data DIR] [--set smrf.low_slope=2]

A share of the points is moved down by one to five metres (one seed). Error of the filter's ground among the other last
echoes, against the samples' labels or the files' classes (code 1 is not judged), and the noise filter's time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import laspy
import numpy as np
import yaml

from fwclass import conf
from fwclass.ground.filters import ground_points
from fwclass.ground.methods.noise import noise
from fwclass.ground.params import GroundParams

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
FILES = {
    "ign_hd/urban_77060_627755": None,
    "ign_hd/urban_77050_627760": None,
    "ign_hd/bat": None,
    "ign_hd/crop_1": None,
    "ign_hd/km_0299_6802": 500.0,
    "other/delft_ahn3_2": 200.0,
}
"""Files, and the edge [m] of their south-western square that is taken, None for all."""

Cloud = tuple[str, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Name, x, y, z, which points are ground, the last of their pulse, and judged."""


def clouds(data: Path) -> Iterator[Cloud]:
    for path in sorted((data / "isprs").glob("*.txt")):
        x, y, z, label = np.loadtxt(path).T
        yield path.stem, x, y, z, label == 0, np.ones(len(x), bool), np.ones(len(x), bool)
    for name, edge in FILES.items():
        las = laspy.read(data / f"{name}.laz")
        x, y, z, code = (np.array(v) for v in (las.x, las.y, las.z, las.classification))
        last = np.array(las.return_number) >= np.array(las.number_of_returns)
        taken = code != 7
        if edge is not None:
            taken &= (x < x.min() + edge) & (y < y.min() + edge)
        yield name.split("/")[1], *(v[taken] for v in (x, y, z, code == 2, last, code > 1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--share", default="0,0.005,0.02")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of `ground`")
    asked = parser.parse_args()
    base = conf.section("ground").model_dump()
    for text in asked.set:
        key, _, value = text.partition("=")
        section, _, name = key.rpartition(".")
        (base[section] if section else base)[name] = yaml.safe_load(value)
    every = list(clouds(asked.data))
    for share in map(float, asked.share.split(",")):
        for surface in (False, True):
            params = GroundParams(**{**base, "noise": {**base["noise"], "surface": surface}})
            print(f"{100 * share:g} % low, ground.noise.surface {surface}", flush=True)
            errors = [judge(cloud, share, params) for cloud in every]
            samples = [wrong for (name, *_), (wrong, _) in zip(every, errors, strict=True) if name.startswith("samp")]
            print(f"  {'ISPRS, mean of ' + str(len(samples)):<24}{np.mean(samples):>8.2f} %")
            for (name, *_), (wrong, micros) in zip(every, errors, strict=True):
                if not name.startswith("samp"):
                    print(f"  {name:<24}{wrong:>8.2f} %  {micros:.2f} us a point")


def judge(cloud: Cloud, share: float, params: GroundParams) -> tuple[float, float]:
    """Error of the ground [%], and what the noise filter takes [us of the processor a point]."""
    _, x, y, z, ground, last, judged = cloud
    random = np.random.default_rng(7)
    low = random.random(len(z)) < share
    z = z.copy()
    z[low] -= random.uniform(1.0, 5.0, int(low.sum()))
    start = time.process_time()
    noise(x, y, z, last, params.noise)
    micros = 1e6 * (time.process_time() - start) / len(x)
    flags = ground_points(x, y, z, last, params).ground
    rows = judged & last & ~low
    return 100.0 * float((flags[rows] != ground[rows]).mean()), micros


if __name__ == "__main__":
    main()
