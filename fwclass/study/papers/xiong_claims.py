"""What Xiong 2018 claims, tested on our figures."""

from __future__ import annotations

from collections.abc import Callable

from fwclass.study.papers.claims import OPEN, Facts, Verdict, difference_words, of_gain, percent, points, verdict

NEAR = 0.01
"""Two accuracies are called much the same up to this difference."""


def _overall(facts: Facts, name: str) -> float:
    return float(facts["strategies"][name]["overall_accuracy"])


def _accuracy(facts: Facts) -> Verdict:
    one, paper = facts["strategies"]["rf_selected"], facts["printed"]["strategies"]["rf_selected"]
    text = f"{percent(one['overall_accuracy'])}, {one['kappa']:.3f}"
    holds = one["overall_accuracy"] >= paper["overall"] / 100 and one["kappa"] >= paper["kappa"]
    return text, verdict(holds), "on test areas apart from the training areas; other data, other shares of the classes"


def _kept_all(facts: Facts) -> bool:
    return len(facts["chosen"]) == len(facts["candidates"])


NOTHING_DROPPED = ("–", OPEN, "the selection kept all features")


def _gain(pair: str, up: bool = True) -> Callable[[Facts], Verdict]:
    """A claim that the first of a pair is more accurate, or (`up` false) that it hardly differs."""

    def claim(facts: Facts) -> Verdict:
        difference = facts["differences"][pair]
        one = difference["overall_accuracy"]
        first, second = pair.split("/")
        if pair in ("rf_selected/rf", "svm_selected/svm") and _kept_all(facts):
            return NOTHING_DROPPED
        both = f"{percent(_overall(facts, first))} against {percent(_overall(facts, second))}"
        text = f"{points(one['value'])} points ({both})"
        if one["low"] is None:
            return text, OPEN, "too few blocks for an interval"
        sure = one["low"] > 0 or one["high"] < 0
        why = f"{difference_words(difference)}" + ("" if sure else ": no difference beyond chance")
        if not up:
            return text, verdict(abs(one["value"]) < NEAR), why
        printed = facts["printed"]["strategies"]
        return text, of_gain(one, (printed[first]["overall"] - printed[second]["overall"]) / 100), why

    return claim


def _cross_validation(facts: Facts) -> Verdict:
    best, few = facts["selection"]["best"], facts["selection"]["smallest"]
    whole = facts["selection"]["steps"][0]
    text = f"{len(best['features'])} of {len(facts['candidates'])}, {percent(best['accuracy'])}"
    why = (
        f"{len(few['features'])} are as good within one standard error ({percent(few['accuracy'])}), all give "
        f"{percent(whole['accuracy'])}; our folds are apart in space, the paper's are drawn at random"
    )
    return text, verdict(len(best["features"]) < len(facts["candidates"])), why


def _nh_first(facts: Facts) -> Verdict:
    rows = facts["importance"]["rows"]
    place = next((k for k, r in enumerate(rows) if r["name"] == "height_above_ground"), None)
    if place is None:
        return "–", OPEN, "no candidate is the height above ground"
    if len(rows) < 2:
        return "place 1", OPEN, "it is the only candidate"
    first, second = rows[:2]
    why = f"then {second['name']} ({second['score']:.0f})"
    if place:
        why = f"{first['name']} is first, NH has {rows[place]['score']:.0f}"
    return f"place {place + 1}", verdict(place == 0), why


def _groups(facts: Facts) -> list[str]:
    shares = {g: v for g, v in facts["importance"]["groups"].items() if g != "normalised height"}
    return sorted(shares, key=lambda g: -shares[g])


def _without_group(order: list[str], group: str) -> Verdict | None:
    """Why the place of a kind of feature among the others cannot be told; None where it can."""
    if group not in order:
        return "–", OPEN, f"no candidate is one of the {group}"
    if len(order) < 3:
        return "–", OPEN, f"the candidates have too few kinds of features to rank: {', '.join(order)}"
    return None


def _group_text(facts: Facts) -> str:
    shares = facts["importance"]["groups"]
    return ", ".join(f"{g} {shares[g]:.0f}" for g in _groups(facts)[:4])


def _echoes(facts: Facts) -> Verdict:
    order = _groups(facts)
    lacking = _without_group(order, "echoes")
    if lacking:
        return lacking
    return (
        f"place {order.index('echoes') + 1} of {len(order)} groups",
        verdict(order[0] == "echoes"),
        (f"sums of the scores: {_group_text(facts)}"),
    )


def _height_statistics(facts: Facts) -> Verdict:
    order = _groups(facts)
    lacking = _without_group(order, "height statistics")
    if lacking:
        return lacking
    statistics = [n for r in facts["radii"] for n in r["ours"] if n.startswith("height_")]
    text = f"{len(statistics)} of {len(facts['chosen'])} features"
    little = order.index("height statistics") >= len(order) - 2
    return (
        text,
        verdict(little and len(statistics) <= len(facts["chosen"]) / 5),
        (f"place {order.index('height statistics') + 1} of {len(order)} groups by importance"),
    )


def _larger_radii(facts: Facts) -> Verdict:
    rows = [r for r in facts["radii"] if r["of"]]
    count = [len(r["ours"]) for r in rows]
    half = len(count) // 2
    text = ", ".join(map(str, count)) or "–"
    if not half:
        return text, OPEN, "the candidates have only one radius" if rows else "no candidate has a radius"
    small, large = sum(count[:half]) / half, sum(count[-half:]) / half
    why = f"at the {half} smaller radii {small:.1f} on average, at the {half} larger {large:.1f}"
    return text, verdict(large > small), why


def _building_omission(facts: Facts) -> Verdict:
    omission = {n: v for n, v in facts["strategies"]["rf_selected"]["omission"].items() if v is not None}
    if "building" not in omission or len(omission) < 2:
        return "–", OPEN, "no test echo is a building, or of another class"
    worst = max(omission, key=lambda n: omission[n])
    why = ", ".join(f"{n} {percent(v)}" for n, v in omission.items())
    return percent(omission["building"]), verdict(worst == "building"), why


def _time(key: str) -> Callable[[Facts], Verdict]:
    def claim(facts: Facts) -> Verdict:
        if _kept_all(facts):
            return NOTHING_DROPPED
        before, after = facts["times"]["rf"][key], facts["times"]["rf_selected"][key]
        rows = facts["times"]["rf"][f"{key}_rows"]
        return f"{before:.2f} to {after:.2f} s", verdict(after < before), f"{rows:,} echoes, one thread"

    return claim


def _thinning(facts: Facts) -> Verdict:
    steps = facts["thinning"]["steps"]
    whole = max(steps, key=lambda s: s["rate"])
    rate = facts["printed"]["thinning"]["rate"]
    least = min(steps, key=lambda s: abs(s["rate"] - rate))
    if not 0.5 * rate <= least["rate"] <= 2 * rate:
        return "–", OPEN, f"no rate near {100 * rate:g} % is among select.rates"
    lost = whole["accuracy"] - least["accuracy"]
    text = f"{percent(least['accuracy'])} at {100 * least['rate']:g} %, {percent(whole['accuracy'])} at all"
    why = (
        f"costs {100 * lost:.1f} points; as good as the best is {100 * facts['thinning']['lowest']:g} % and more; "
        "the paper's cloud has 17 points/m²"
    )
    return text, verdict(lost <= NEAR), why


CLAIMS: dict[str, Callable[[Facts], Verdict]] = {
    "accuracy": _accuracy,
    "selection_helps": _gain("rf_selected/rf"),
    "forest_over_svm": _gain("rf_selected/svm_selected"),
    "svm_unchanged": _gain("svm_selected/svm", up=False),
    "cross_validation": _cross_validation,
    "nh_first": _nh_first,
    "echoes": _echoes,
    "height_statistics": _height_statistics,
    "larger_radii": _larger_radii,
    "building_omission": _building_omission,
    "train_time": _time("train"),
    "test_time": _time("test"),
    "thinning": _thinning,
}
