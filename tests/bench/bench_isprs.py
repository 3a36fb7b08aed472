"""Every ground filter on the ISPRS reference samples with the configured parameters, no tuning by sample.

Prints Type I, Type II, total error and κ [%] by sample and filter. `python tests/bench/bench_isprs.py [filter ...]`
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import yaml

from fwclass.ground.filters import FILTERS, ground_points
from fwclass.ground.params import GroundParams

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / ".." / "shared" / "data" / "isprs"


def scores(truth, found):
    """Type I, Type II, total error and κ [%]; He 2023, with P_c over e²."""
    a, b = (truth & found).sum(), (truth & ~found).sum()
    c, d = (~truth & found).sum(), (~truth & ~found).sum()
    e = len(truth)
    agree, chance = (a + d) / e, ((a + b) * (a + c) + (c + d) * (b + d)) / e**2
    return 100.0 * b / (a + b), 100.0 * c / (c + d), 100.0 * (b + c) / e, 100.0 * (agree - chance) / (1.0 - chance)


def main(methods):
    files = sorted(SAMPLES.glob("samp*.txt"))
    if not files:
        print(f"no samples at {SAMPLES}")
        return
    ground = GroundParams(**yaml.safe_load((ROOT / "conf" / "base.yaml").read_text())["ground"])
    clouds = {f.stem.removeprefix("samp"): np.loadtxt(f).T.copy() for f in files}
    print(f"{'filter':15} sample  Type I Type II  total  kappa")
    for method in methods:
        params, table = ground.model_copy(update={"method": method}), []
        for name, (x, y, z, label) in clouds.items():
            flags = ground_points(x, y, z, np.ones(len(x), bool), params)
            table.append(scores(label == 0, flags.ground))
            print(f"{method:15} {name:6} " + " ".join(f"{v:6.2f}" for v in table[-1]))
        print(f"{method:15} mean   " + " ".join(f"{v:6.2f}" for v in np.mean(table, axis=0)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or list(FILTERS))
