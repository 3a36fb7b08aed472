"""What Fan 2013 claims, tested on our figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from fwclass.schema import base_of
from fwclass.study.papers.claims import (
    FAILS,
    HOLDS,
    OPEN,
    Facts,
    Verdict,
    difference_words,
    of_gain,
    percent,
    points,
    verdict,
)

WORDS = {
    "zc": "Zc",
    "echo_number": "echo number",
    "amplitude": "amplitude",
    "echo_ratio": "echo ratio",
    "backscatter": "γ",
    "inclination": "A",
    "width": "width",
}


def _accuracy(facts: Facts) -> Verdict:
    ours, wanted = facts["splits"][_m(facts)]["overall_accuracy"], facts["printed"]["splits"]["3"]["overall"] / 100
    if len(facts["features"]) != 6:
        return percent(ours), OPEN, f"{len(facts['features'])} features are known here, not six"
    why = f"{'above' if ours > wanted else 'below'} the paper's, on echoes apart from the training blocks"
    return percent(ours), verdict(ours >= wanted), why


def _m(facts: Facts) -> str:
    return next(iter(facts["splits"]))


def _forest_over_svm(facts: Facts) -> Verdict:
    difference = facts["differences"][f"{facts['forest']}/rbf-svm"]
    one = difference["overall_accuracy"]
    forest, svm = facts["splits"][_m(facts)], facts["machines"]["rbf-svm"]
    text = f"{percent(forest['overall_accuracy'])} against {percent(svm['overall_accuracy'])} (RBF)"
    if one["low"] is None:
        return text, OPEN, "too few blocks for an interval"
    same = difference_words(facts["differences"]["forest-fewer/rbf-svm"])
    rows = f"on the SVM's {svm['rows']:,} training rows: {same}"
    printed = facts["printed"]
    claimed = (printed["splits"]["3"]["overall"] - printed["svm"]["overall"]) / 100
    chance = "no difference beyond chance: " if one["low"] <= 0 <= one["high"] else "difference "
    return text, of_gain(one, claimed), f"{chance}{difference_words(difference)}, {difference['blocks']} blocks; {rows}"


def _split(facts: Facts) -> Verdict:
    accuracies = [v["overall_accuracy"] for v in facts["splits"].values()]
    text = ", ".join(f"{100 * v:.1f}" for v in accuracies) + " %"
    if len(accuracies) < 2:
        return text, OPEN, f"{len(facts['features'])} features leave one m to try"
    falling = all(a >= b for a, b in zip(accuracies[:-1], accuracies[1:], strict=True))
    spread = 100 * (max(accuracies) - min(accuracies))
    best = accuracies[0] == max(accuracies)
    why = "m = 3 is best and accuracy falls with m" if falling and best else "the order differs"
    return text, verdict(best and falling), f"{why}; all within {spread:.1f} points"


def _steps(facts: Facts) -> dict[str, float]:
    """Gain of accuracy over the best set before, by base, in the paper's order."""
    gains: dict[str, float] = {}
    best = 0.0
    for step in facts["selection"]["paper"]["steps"]:
        base = base_of(step["tried"][0])
        gains[base] = gains.get(base, 0.0) + step["accuracy"] - best
        best = max(best, step["accuracy"])
    return gains


def _unknown(facts: Facts, *bases: str) -> Verdict | None:
    """Why a claim on some features cannot be judged; None where all are candidates."""
    lacking = [WORDS[b] for b in bases if b not in _steps(facts)]
    return ("–", OPEN, f"not known here: {', '.join(lacking)}") if lacking else None


def _zc_alone(facts: Facts) -> Verdict:
    lacking = _unknown(facts, "zc")
    if lacking:
        return lacking
    first = facts["selection"]["paper"]["steps"][0]
    best = facts["selection"]["best"]["steps"][0]
    ours = first["accuracy"]
    why = (
        "also the first choice of forward selection"
        if best["tried"] == first["tried"]
        else (f"forward selection begins with {WORDS[base_of(best['tried'][0])]} ({percent(best['accuracy'])})")
    )
    return percent(ours), verdict(ours > 0.8), why


def _largest(facts: Facts) -> Verdict:
    lacking = _unknown(facts, "zc", "echo_number", "echo_ratio")
    if lacking:
        return lacking
    gains = _steps(facts)
    if len(gains) < 4:
        return "–", OPEN, f"only {len(gains)} of the paper's features are known here"
    later = sorted(((v, n) for n, v in list(gains.items())[1:]), reverse=True)
    text = ", ".join(f"{WORDS[n]} {points(v)}" for v, n in later[:3])
    return text, verdict({n for _, n in later[:2]} == {"echo_number", "echo_ratio"}), "gains in the paper's order"


def _backscatter(facts: Facts) -> Verdict:
    gains = _steps(facts)
    if "backscatter" not in gains:
        return "–", OPEN, "γ is not known here"
    if len(gains) < 2:
        return "–", OPEN, "γ is the only feature of the paper that is known here"
    gain = gains["backscatter"]
    every, six = facts["every_feature"]["overall_accuracy"], facts["splits"][_m(facts)]["overall_accuracy"]
    why = f"on the test areas all features give {percent(every)}, the six {percent(six)}"
    return f"{points(gain)} points", verdict(gain <= 0), why


def _best_set(facts: Facts) -> Verdict:
    chosen = {base_of(n) for n in facts["selection"]["best"]["chosen"]}
    order = facts["printed"]["selection"]
    paper = set(order["order"]) - set(order["dropped"])
    known = {base_of(n) for n in facts["selection"]["best"]["candidates"]}
    text = f"{len(chosen)} of {len(known)}"
    if known < set(order["order"]):
        return text, OPEN, f"not known here: {', '.join(WORDS[n] for n in order['order'] if n not in known)}"
    more, less = sorted(chosen - paper), sorted(paper - chosen)
    why = "; ".join([*(f"also {WORDS[n]}" for n in more), *(f"without {WORDS[n]}" for n in less)]) or "the same six"
    return text, verdict(chosen == paper), why


def _waveform(facts: Facts) -> Verdict:
    thesis = facts["thesis"]
    if thesis is None:
        return "–", OPEN, "the features are not both with and without waveform: width is missing, or all others"
    differences = [facts["differences"][f"with-{s}/without-{s}"] for s in thesis["seeds"]]
    if differences[0]["overall_accuracy"]["low"] is None:
        return "–", OPEN, "too few blocks for an interval"
    low = min(f["overall_accuracy"]["low"] for f in differences)
    high = max(f["overall_accuracy"]["high"] for f in differences)
    gain = sum(f["overall_accuracy"]["value"] for f in differences) / len(differences)
    text = f"{points(gain)} points overall"
    why = f"95 % intervals of {len(differences)} seeds lie within [{points(low, 2)}, {points(high, 2)}]"
    return text, HOLDS if low > 0 else FAILS, why


def _row(facts: Facts, base: str, name: str) -> Mapping[str, Any] | None:
    for feature, by_class in facts["distribution"].items():
        if base_of(feature) == base:
            return by_class.get(name)
    return None


def _rows(facts: Facts, base: str) -> dict[str, Mapping[str, Any]] | None:
    ours = facts["printed"]["classes"]
    names = {c["name"] for c in facts["classes"]}
    rows = {n: _row(facts, base, n) for n in ours.values() if n in names}
    return None if None in rows.values() or len(rows) < len(ours) else rows  # type: ignore[return-value]


def _of_table(base: str, test: Callable[[dict[str, Any]], tuple[str, bool, str]]) -> Callable[[Facts], Verdict]:
    """A claim on the distribution of `base`; `test` gives (our figure, holds, why)."""

    def claim(facts: Facts) -> Verdict:
        rows = _rows(facts, base)
        if rows is None or any(r.get("p50") is None for r in rows.values()):
            return "–", OPEN, "this feature, or one of its classes, is not known here"
        text, holds, why = test(rows)
        return text, verdict(holds), why

    return claim


def _ratio(rows: dict[str, Any]) -> tuple[str, bool, str]:
    tree, house, ground = (rows[n]["p50"] for n in ("vegetation", "building", "ground"))
    text = f"medians {100 * tree:.0f} %, {100 * house:.0f} %, {100 * ground:.0f} %"
    return (
        text,
        tree < 0.6 and min(house, ground) >= 0.95,
        "trees, buildings, ground; at eaves the cylinder holds the ground below",
    )


def _ground(rows: dict[str, Any]) -> tuple[str, bool, str]:
    row = rows["ground"]
    why = "on slopes and at walls the lowest echo of a 12 m × 10 m cell lies far below" if row["p95"] > 0.5 else ""
    return f"median {row['p50']:.2f} m, 95 % {row['p95']:.2f} m", row["p95"] <= 0.5, why


def _slopes(rows: dict[str, Any]) -> tuple[str, bool, str]:
    house, ground = rows["building"], rows["ground"]
    text = f"95 %: {house['p95']:.0f}°, {ground['p95']:.0f}°; 75 %: {house['p75']:.0f}°, {ground['p75']:.0f}°"
    return text, house["p95"] <= 20 and ground["p95"] <= 15, "buildings, ground; steep roofs and edges go beyond"


def _amplitude(rows: dict[str, Any]) -> tuple[str, bool, str]:
    tree, house, ground = (rows[n]["p50"] for n in ("vegetation", "building", "ground"))
    least = min(rows[n]["p25"] for n in ("building", "ground"))
    why = f"trees, buildings, ground; the lower quartile of the latter two begins at {least:.0f} DN"
    return f"medians {tree:.0f}, {house:.0f}, {ground:.0f} DN", tree < least, why


def _width(rows: dict[str, Any]) -> tuple[str, bool, str]:
    tree, house, ground = (rows[n]["p50"] for n in ("vegetation", "building", "ground"))
    why = "trees, buildings, ground; several leaves in one echo widen it, a roof does not"
    return f"medians {tree:.2f}, {house:.2f}, {ground:.2f} ns", tree < min(house, ground), why


def _time(facts: Facts) -> Verdict:
    forest, svm = facts["times"][facts["forest"]], facts["times"]["rbf-svm"]
    ours, other = (one["train"] + one["test"] for one in (forest, svm))
    rows = facts["machines"]["rbf-svm"]["rows"]
    why = f"training and {forest['test_rows']:,} test echoes, one thread; the SVM trained on {rows:,} rows"
    text = " against ".join(f"{s:.1f} s" if s >= 1 else f"{s:.3f} s" for s in (ours, other))
    return text, verdict(ours < other), why


CLAIMS: dict[str, Callable[[Facts], Verdict]] = {
    "accuracy": _accuracy,
    "forest_over_svm": _forest_over_svm,
    "split": _split,
    "zc_alone": _zc_alone,
    "steps": _largest,
    "backscatter": _backscatter,
    "best_set": _best_set,
    "waveform": _waveform,
    "tree_ratio": _of_table("echo_ratio", _ratio),
    "ground_zc": _of_table("zc", _ground),
    "slopes": _of_table("inclination", _slopes),
    "amplitude": _of_table("amplitude", _amplitude),
    "width": _of_table("width", _width),
    "time": _time,
}
