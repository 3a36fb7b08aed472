"""``--auto`` beside fixed parameters and the per-sample optimum: ``python tests/bench/bench_auto.py [--optimum]``.

No label takes part in ``--auto``: the constants of `ground_auto` are lists of candidates and referees. The optimum is
the least total error that the search of ``--optimize`` meets with all labels.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from fwclass import conf
from fwclass.assess.confusion import figures
from fwclass.graph.ground_trial import NAMES, FilterTrial, halves, matrix_of, ranges_of, start_of
from fwclass.ground.auto import adapt_filter
from fwclass.ground.filters import ground_points
from fwclass.ground.measure import measure
from fwclass.ground.search import search
from fwclass.read.cloud import read_point_cloud
from fwclass.single_file.ground.file import filter_cloud, shown_points
from fwclass.single_file.ground.labels import labels_of

DATA = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
SETS = ("isprs/samp*.txt", "ign_hd/urban_*.laz", "other/delft_ahn3_*.laz")


def told(truth, ground):
    made = figures(matrix_of(truth, ground), NAMES)
    return 100 * made["total_error"], 100 * made["kappa"]


def one(path, optimum):
    cloud = read_point_cloud(path)
    truth = labels_of(cloud)
    points, last = (cloud.x, cloud.y, cloud.z), cloud.last
    base, rules, limits = (conf.section(n) for n in ("ground", "ground_auto", "ground_search"))
    start = time.process_time()
    measure(*points, last)
    spent = time.process_time() - start
    start = time.process_time()
    params = adapt_filter(points, last, base, rules).params
    adapting = time.process_time() - start
    row = [told(truth, ground_points(*points, last, p).ground) for p in (base, params)]
    if optimum:
        ranges = ranges_of(base, limits)
        shown = shown_points(cloud)
        seen = shown & ~filter_cloud(cloud, shown, base).noise
        half = halves(cloud.x, cloud.y, cloud.usable)
        trial = FilterTrial((cloud.x, cloud.y, cloud.z), cloud.last, seen, half, truth, base, ranges)

        def right(setting):
            pair = trial.matrices(setting)
            return float(np.trace(pair[0] + pair[1]))

        best = search(ranges, start_of(base, ranges), right, limits).setting
        row.append((100 - 100 * right(best) / (truth >= 0).sum(), 100 * trial.kappa(best)))
    print(
        f"{path.name:28}"
        + "".join(f"{e:8.2f}{k:7.1f}" for e, k in row)
        + f"   slope {params.smrf.slope:g} threshold {params.smrf.threshold:g} scalar {params.smrf.scalar:g}"
        + f"   measured {cloud.points / max(spent, 1e-9) / 1e6:.2f} M points/s, adapted {adapting:.1f} s",
        flush=True,
    )
    return row


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--optimum", action="store_true", help="search the best parameters of every file: minutes each")
    asked.add_argument("--only", default="", help="files whose path contains this")
    asked = asked.parse_args()
    print("total error % and kappa %: fixed, auto" + (", optimum" if asked.optimum else ""))
    for pattern in SETS:
        paths = [p for p in sorted(DATA.glob(pattern)) if asked.only in str(p)]
        if rows := [one(p, asked.optimum) for p in paths]:
            print(f"{'mean of ' + pattern:28}" + "".join(f"{e:8.2f}{k:7.1f}" for e, k in np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
