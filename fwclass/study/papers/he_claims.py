"""What He 2023 claims, tested on our figures: held-out ones, with intervals over samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fwclass.study.papers.claims import FAILS, HOLDS, OPEN, UNSURE, Facts, Verdict, of_gain, percent, points, verdict

COMBINED = "csf+smrf"
LITTLE = 0.01
"""Kappa that hardly matters."""

_T = {2: 12.7, 3: 4.30, 4: 3.18, 5: 2.78, 6: 2.57, 7: 2.45, 8: 2.36, 9: 2.31, 10: 2.26, 12: 2.20, 15: 2.14, 20: 2.09}
"""Student's t of 95 % by number of samples."""


def _spread(values: Sequence[float]) -> dict[str, float]:
    """Mean of one difference a sample, and its 95 % interval; infinite for a single sample."""
    n = len(values)
    mean = float(np.mean(values))
    if n < 2:
        return {"value": mean, "low": -math.inf, "high": math.inf}
    half = _T[max(k for k in _T if k <= n)] * float(np.std(values, ddof=1)) / math.sqrt(n)
    return {"value": mean, "low": mean - half, "high": mean + half}


def _figures(facts: Facts, method: str, figure: str, kind: str = "held_out") -> list[float]:
    return [float(s[method][kind][figure]) for s in facts["by_sample"].values()]


def _words(one: Mapping[str, float]) -> str:
    if not math.isfinite(one["low"]):
        return f"{points(one['value'], 2)} points"
    return f"{points(one['value'], 2)} points [{points(one['low'], 2)}, {points(one['high'], 2)}]"


def _families(facts: Facts) -> Verdict:
    errors = {m: facts["means"][m]["held_out"]["total_error"] for m in facts["printed"]["families"]}
    order = sorted(errors, key=errors.__getitem__)
    text = ", ".join(f"{m} {percent(errors[m], 2)}" for m in order)
    return text, verdict(set(order[:2]) == {"smrf", "csf"}), "mean total error of all samples, held out, least first"


def _optimised(facts: Facts) -> Verdict:
    gains = {
        f: _spread([a - b for a, b in zip(_figures(facts, "csf", f), _figures(facts, "csf", f, "start"), strict=True)])
        for f in ("type_i", "type_ii", "kappa")
    }
    ends = [-gains["type_i"]["high"], -gains["type_ii"]["high"], gains["kappa"]["low"]]
    worst = [-gains["type_i"]["low"], -gains["type_ii"]["low"], gains["kappa"]["high"]]
    judged = HOLDS if min(ends) > 0 else FAILS if min(worst) < 0 else UNSURE
    text = "; ".join(
        f"{n.replace('type_ii', 'Type II').replace('type_i', 'Type I')} {_words(g)}" for n, g in gains.items()
    )
    kappas = [float(np.mean(_figures(facts, "csf", "kappa", kind))) for kind in ("best", "start")]
    return (
        text,
        judged,
        f"chosen on half of a sample, judged on the other; on the same points kappa {points(kappas[0] - kappas[1], 2)}",
    )


def _gain(figure: str) -> Callable[[Facts], Verdict]:
    def claim(facts: Facts) -> Verdict:
        ours, csf, smrf = (_figures(facts, m, figure) for m in (COMBINED, "csf", "smrf"))
        one = _spread([a - 0.5 * (b + c) for a, b, c in zip(ours, csf, smrf, strict=True)])
        printed = facts["printed"]["gains"][figure] / 100
        sign = 1.0 if printed > 0 else -1.0
        turned = {"low": min(sign * one["low"], sign * one["high"]), "high": max(sign * one["low"], sign * one["high"])}
        alone = _spread([a - c for a, c in zip(ours, smrf, strict=True)])
        why = f"held out; against SMRF alone {_words(alone)}; the paper judges its roughest sample where it was chosen"
        return _words(one), of_gain(turned, sign * printed), why

    return claim


def _best(facts: Facts) -> Verdict:
    first = [
        s
        for s, by in facts["by_sample"].items()
        if all(
            by[COMBINED]["held_out"]["total_error"] < by[m]["held_out"]["total_error"]
            for m in facts["printed"]["families"]
        )
    ]
    n = len(facts["by_sample"])
    why = "least total error, held out: " + (", ".join(first) or "on none")
    return f"{len(first)} of {n}", verdict(len(first) == n), why


def _steep(facts: Facts) -> Verdict:
    steep = facts["steep"]
    if not steep or len(steep) == len(facts["by_sample"]):
        return "–", OPEN, "all samples are as steep"
    one = _spread([_held(facts, s, "smrf") - _held(facts, s, "csf") for s in steep])
    why = f"total error of SMRF less that of CSF on the steeper half ({', '.join(steep)}), held out"
    return _words(one), of_gain(one, one["value"]), why


def _held(facts: Facts, sample: str, method: str) -> float:
    return float(facts["by_sample"][sample][method]["held_out"]["total_error"])


def _smrf(facts: Facts) -> Verdict:
    one = _spread([_held(facts, s, "csf") - _held(facts, s, "smrf") for s in facts["by_sample"]])
    return _words(one), of_gain(one, one["value"]), "total error of CSF less that of SMRF, all samples, held out"


def _slow(facts: Facts) -> Verdict:
    speeds = {m: facts["means"][m]["speed"] for m in ("csf", "smrf")}
    text = f"SMRF is {speeds['smrf'] / speeds['csf']:.2g} × as fast"
    each = ", ".join(f"{m.upper()} {v / 1e6:.2f}" for m, v in speeds.items())
    why = f"{each} million points a processor second, ours; on sparse samples the area costs, not the points"
    return text, verdict(speeds["csf"] > speeds["smrf"]), why


def _rigidness(facts: Facts) -> Verdict:
    curves = [dict(s["csf"]["curves"]["rigidness"]) for s in facts["by_sample"].values()]
    spans = [max(c.values()) - min(c.values()) for c in curves]
    ones = sum(max(c, key=c.__getitem__) == 1.0 for c in curves)
    why = f"greatest less least kappa over rigidness 1 to 3, all else at its best; 1 is best on {ones} of {len(curves)}"
    return (
        f"{points(float(np.mean(spans)), 2)} points on average, {points(max(spans), 2)} at most",
        verdict(float(np.mean(spans)) < LITTLE),
        why,
    )


def _threshold(facts: Facts) -> Verdict:
    loss = []
    for sample in facts["by_sample"].values():
        line = sample["csf"]["curves"]["class_threshold"]
        near = min(line, key=lambda p: abs(p[0] - 0.3))
        loss.append(max(k for _, k in line) - near[1])
    best = [s["csf"]["best"]["parameters"]["class_threshold"] for s in facts["by_sample"].values()]
    text = f"{points(-float(np.mean(loss)), 2)} points of kappa"
    why = (
        "0.3 m instead of the best threshold; best: "
        + ", ".join(f"{b:g}" for b in sorted(best))
        + " m (ours adds slope × scalar)"
    )
    return text, HOLDS if float(np.mean(loss)) < LITTLE else verdict(False), why


CLAIMS: dict[str, Callable[[Facts], Verdict]] = {
    "families": _families,
    "optimised": _optimised,
    "type_ii": _gain("type_ii"),
    "total": _gain("total_error"),
    "kappa": _gain("kappa"),
    "best": _best,
    "steep": _steep,
    "smrf": _smrf,
    "slow": _slow,
    "rigidness": _rigidness,
    "threshold": _threshold,
}
"""Every claim of ``conf/papers/he2023.yaml`` by its name."""
