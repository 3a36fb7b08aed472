"""What `fwclass adapt` gains without labels: models of all other surveys, before and after, on each of five.

    python tests/bench/bench_adapt.py [--data DIR] [--seeds 1,2]

Forests by the set `portable` without a layer in context. Data are not part of this repository; without them it says so.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from bench_abroad import DATA, SURVEYS
from bench_suggest import MOST, NAMES, Cloud, judged, known, learn

from fwclass import conf
from fwclass.errors import InputError
from fwclass.model import sample_matrix
from fwclass.schema import Table
from fwclass.study.adapted import ADAPTED, SeenEchoes, adapt, draw_seen
from fwclass.train.sample import join


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--seeds", default="1,2")
    asked = parser.parse_args()
    if not asked.data.is_dir():
        sys.exit(f"no data in {asked.data}")
    with tempfile.TemporaryDirectory() as place:
        clouds = {n: Cloud(sorted(asked.data.glob(f)), crs, Path(place)) for n, (f, crs) in SURVEYS.items()}
    print("overall accuracy and mean IoU [%]; unsure: share of echoes below adapt.unsure before")
    for name, cloud in clouds.items():
        for seed in map(int, asked.seeds.split(",")):
            params, training = conf.section("adapt"), conf.section("train", (f"train.seed={seed}",))
            first, samples = 1 << 63, []
            for other, one in clouds.items():
                if other != name:
                    samples.append(one.rows(np.ones(len(one.reference), bool), first, seed, 1500))
                    first += len(one.reference)
            base = join(samples, 10**9)
            model = learn(base, seed)
            X = sample_matrix(Table({n: cloud.columns[n] for n in NAMES}), model.features)
            seen = draw_seen([SeenEchoes(np.arange(len(X), dtype=np.uint64), X)], params.pool, seed)
            test = known(cloud)
            test = test[:: max(1, len(test) // MOST)]
            before = judged(model, cloud, test)
            free = params.model_copy(update={"most_unsure": 1.0})
            after = adapt(model, base, seen, free, training)
            unsure = after.card[ADAPTED]["rounds"][0]["unsure"]
            try:
                adapt(model, base, seen, params, training)
                refused = ""
            except InputError:
                refused = "refused"
            told = "  ".join(f"{a:5.1f} / {b:5.1f}" for a, b in (before, judged(after, cloud, test)))
            print(f"{name:>8} {told}   unsure {100 * unsure:4.1f} {refused}", flush=True)


if __name__ == "__main__":
    main()
