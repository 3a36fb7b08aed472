"""What Shi 2019 claims, tested on our figures."""

from __future__ import annotations

from collections.abc import Callable

from fwclass.classes import GROUND
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

NEAR = 0.01
"""Two accuracies are called much the same up to this difference."""


def _gain(pair: str, claimed: float) -> Callable[[Facts], Verdict]:
    def claim(facts: Facts) -> Verdict:
        difference = facts["differences"].get(pair)
        if difference is None:
            return "–", OPEN, "no class is ground"
        one, (first, second) = difference["overall_accuracy"], pair.split("/")
        steps = facts["steps"]
        both = [percent(steps[n]["overall_accuracy"]) for n in (second, first)]
        text = f"{points(one['value'])} points ({both[0]} to {both[1]} overall)"
        if one["low"] is None:
            return text, OPEN, "too few blocks for an interval"
        return text, of_gain(one, claimed), difference_words(difference)

    return claim


def _ground_filter(facts: Facts) -> Verdict:
    steps, difference = facts["steps"], facts["differences"].get("iptd/without_heights")
    if difference is None:
        return "–", OPEN, "no class is ground"
    k = next(k for k, c in enumerate(facts["classes"]) if c["code"] == GROUND)
    both = [steps[n] for n in ("without_heights", "iptd")]
    iou, of_class = ([one[key][k] for one in both] for key in ("iou", "producers_accuracy"))
    if any(v is None for v in (*iou, *of_class)):
        return "–", OPEN, "no test echo is ground"
    of_class = [percent(v) for v in of_class]
    text = f"IoU {percent(iou[0])} to {percent(iou[1])}, producer's accuracy {of_class[0]} to {of_class[1]}"
    gain = difference["iou"][k]
    why = f"{difference_words({'iou': gain}, 'iou')}, overall {difference_words(difference)}; both without heights"
    if gain["low"] is None:
        return text, OPEN, f"too few blocks for an interval: {why}"
    return text, of_gain(gain, 0.0), why


def _heights(facts: Facts) -> Verdict:
    """Every class but ground, which the filter tells in both, and all together."""
    text, judgement, why = _gain("iptd_heights/iptd", 0.05)(facts)
    if judgement == OPEN:
        return text, judgement, why
    before, after = (facts["steps"][n]["iou"] for n in ("iptd", "iptd_heights"))
    pairs = [(c["name"], a, b) for c, a, b in zip(facts["classes"], before, after, strict=True) if c["code"] != GROUND]
    known = [(n, a, b) for n, a, b in pairs if a is not None and b is not None]
    if judgement == HOLDS and any(b <= a for _, a, b in known):
        judgement = FAILS
    return text, judgement, f"{why}; IoU: {', '.join(f'{n} {percent(a)} to {percent(b)}' for n, a, b in known)}"


def _selection(facts: Facts) -> Verdict:
    difference = facts["differences"]["svm/svm_all"]
    one = difference["overall_accuracy"]
    why = f"{difference_words(difference)}; up to {100 * NEAR:g} point counts as the same"
    return f"{points(one['value'])} points overall", verdict(one["value"] >= -NEAR), why


def _trimming_time(facts: Facts) -> Verdict:
    before, after = facts["times"]["svm"], facts["times"]["nn_svm"]
    vectors = [facts["steps"][n]["vectors"] for n in ("svm", "nn_svm")]
    text = " to ".join(f"{s:.2f}" if s < 10 else f"{s:.1f}" for s in (t["train"] + t["test"] for t in (before, after)))
    why = f"{vectors[0]:,} to {vectors[1]:,} support vectors, {before['test_rows']:,} echoes, one thread"
    return f"{text} s", verdict(after["train"] + after["test"] < before["train"] + before["test"]), why


def printed_gain(facts: Facts, name: str) -> float:
    """What the paper's second layer brought a class, of its own figures."""
    first, second = (facts["printed"]["boundary"][layer].get(name, 0.0) for layer in ("coarse", "fine"))
    return (second - first) / 100.0


def _boundary(name: str) -> Callable[[Facts], Verdict]:
    def claim(facts: Facts) -> Verdict:
        first, second = facts["layers"]["coarse_boundary"], facts["layers"]["fine_boundary"]
        if first is None or name not in first["classes"]:
            return "–", OPEN, f"no test echo at a boundary, or no class is called {name}"
        k = first["classes"].index(name)
        iou = [one["iou"][k] for one in (first, second)]
        of_class = [one["producers_accuracy"][k] for one in (first, second)]
        if any(v is None for v in (*iou, *of_class)):
            return "–", OPEN, f"no test echo at a boundary is {name}"
        gain = (facts["layers"]["class_gains"] or {})[name]
        text = f"IoU {percent(iou[0])} to {percent(iou[1])}"
        accuracy = f"producer's accuracy {percent(of_class[0])} to {percent(of_class[1])}"
        why = f"{difference_words({'iou': gain}, 'iou')}; {accuracy}"
        if gain["low"] is None:
            return text, OPEN, f"too few blocks for an interval: {why}"
        return text, of_gain(gain, printed_gain(facts, name)), why

    return claim


def _overall(facts: Facts) -> Verdict:
    one, paper = facts["layers"]["fine"], facts["printed"]["algorithms"]["proposed"]["overall"]
    if one is None:
        return "–", OPEN, "nothing was tested"
    text = f"{percent(one['overall_accuracy'])}, {one['kappa']:.3f}"
    return (text, verdict(one["overall_accuracy"] >= paper / 100), "on the test areas; other data")


def _pv(facts: Facts) -> Verdict:
    order = [name for name, _ in facts["fscores"]]
    if "pulse_intensity_variance" not in order:
        return "–", OPEN, "the survey does not compute it"
    place = order.index("pulse_intensity_variance") + 1
    return f"place {place} of {len(order)}", verdict(place <= 4), ", ".join(f"{n} {v:.3f}" for n, v in facts["fscores"])


CLAIMS: dict[str, Callable[[Facts], Verdict]] = {
    "ground_filter": _ground_filter,
    "heights": _heights,
    "selection": _selection,
    "trimming": _gain("nn_svm/svm", 0.076),
    "trimming_time": _trimming_time,
    "boundary_building": _boundary("building"),
    "boundary_vegetation": _boundary("vegetation"),
    "overall": _overall,
    "pv_kept": _pv,
}
