"""What Li 2018 claims, tested on our figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from fwclass.study.papers.claims import FAILS, OPEN, Facts, Verdict, percent, verdict

LITTLE = 0.005
"""Errors that differ by less are called much the same."""

WELL = 0.015
"""Error on a street that the model has not seen, up to which it generalises well."""


def _bound(key: str, below: bool) -> Callable[[Facts], Verdict]:
    def claim(facts: Facts) -> Verdict:
        values = [r["random"][key] for r in facts["radii"]]
        bound = facts["printed"]["bounds"][key] / 100
        low, high = min(values), max(values)
        holds = high < bound if below else low > bound
        other = [r["other"][key] for r in facts["radii"]]
        why = f"at random, as the paper; on another street {percent(min(other), 2)} to {percent(max(other), 2)}"
        return f"{percent(low, 2)} to {percent(high, 2)}", verdict(holds), why

    return claim


def _radius(facts: Facts) -> Verdict:
    values = [r["random"]["error"] for r in facts["radii"]]
    other = [r["other"]["error"] for r in facts["radii"]]
    text = f"{100 * (max(values) - min(values)):.2f} points"
    why = f"between the best and the worst radius at random; {100 * (max(other) - min(other)):.2f} on another street"
    return text, verdict(max(values) - min(values) < LITTLE), why


def _general(facts: Facts) -> Verdict:
    best = next(r for r in facts["radii"] if r["radius"] == facts["best"])
    ends = best["other"]["error_interval"]
    span = f" [{percent(ends[0], 2)}, {percent(ends[1], 2)}]" if ends else ""
    text = f"{percent(best['other']['error'], 2)}{span}"
    why = (
        f"another simulated street at another speed, δ = {facts['best']:g} m, against "
        f"{percent(best['random']['error'], 2)} at random; without leaves {percent(best['leafless']['error'], 2)}"
    )
    return text, verdict(best["other"]["error"] <= WELL), why


def _single(facts: Facts) -> Verdict:
    worst = max(facts["singles"], key=lambda s: s["error"])
    bound = facts["printed"]["single"]["error"] / 100
    why = f"{worst['name']}; whoever always says the larger class errs on {percent(facts['guess'])} here, 40.6 % there"
    if facts["guess"] <= bound:
        return percent(worst["error"]), OPEN, why + ": the bound asks for nothing here"
    return percent(worst["error"]), verdict(worst["error"] < bound), why


def _ranked(facts: Facts) -> list[Mapping[str, Any]]:
    return sorted(facts["singles"], key=lambda s: s["error"])


def _base(name: str) -> str:
    return name.rsplit("_", 1)[0].replace("street_road_", "street_")


def _best(facts: Facts) -> Verdict:
    first = _ranked(facts)[:2]
    text = ", ".join(f"{_base(s['name']).removeprefix('street_')} {percent(s['error'])}" for s in first)
    single = facts["printed"]["single"]
    same = {_base(s["name"]) for s in first} == set(single["order"][:2])
    return text, verdict(same and first[1]["error"] < single["best"] / 100), "the two best single features here"


def _order(facts: Facts) -> Verdict:
    ranked = [_base(s["name"]) for s in _ranked(facts)]
    places = [ranked.index(n) + 1 for n in facts["printed"]["single"]["order"][2:]]
    return f"places {places[0]} and {places[1]}", verdict(sorted(places) == [3, 4]), "of eleven, by test error"


def _shape(facts: Facts) -> Verdict:
    means = {_base(s["name"]).removeprefix("street_"): s["means"] for s in facts["singles"]}
    names = ("linearity", "planarity", "sphericity")
    text = ", ".join(f"{n} {means[n][0]:.2f} against {means[n][1]:.2f}" for n in names)
    lower = all(means[n][0] < means[n][1] for n in names)
    return text, verdict(lower) if lower else FAILS, "means of crowns against others; the three add up to one"


def _online(facts: Facts) -> Verdict:
    slowest = max(r["frame_ms"] for r in facts["radii"])
    text = f"{slowest:.1f} ms"
    return (
        text,
        verdict(slowest < 25.0),
        "processor time of a frame's features at the slowest radius; a frame lasts 25 ms",
    )


CLAIMS: Mapping[str, Callable[[Facts], Verdict]] = {
    "error": _bound("error", True),
    "detection": _bound("detection", False),
    "false_alarm": _bound("false_alarm", True),
    "radius": _radius,
    "general": _general,
    "single": _single,
    "best": _best,
    "order": _order,
    "shape": _shape,
    "online": _online,
}
