"""What a selection found: plain data, a feature set's file, a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from fwclass import __version__
from fwclass.assess.confusion import percent
from fwclass.errors import first_few
from fwclass.select.score import Names, cheapest, front
from fwclass.select.search import Search, Step
from fwclass.study.select.cost import parts_of

TITLES = {
    "forward": "forward selection (Fan 2013)",
    "rffs": "backward elimination by permutation importance (RFFS, Xiong 2018)",
    "fscore": "ranking by F-score (Shi 2019)",
    "scales": "forward selection of the second layer's scales (Shi 2019)",
}

PICKS = ("best", "smallest", "cheapest")
"""Which of the sets on the curve is written: the best score; or, among those that are as good within one standard
error, the one with fewest features or with least time."""


def sets_to_time(search: Search) -> list[Names]:
    """Every set on the curve, and parts of the best one."""
    more = [s for group in parts_of(search.best.features) for s in group.values()]
    return list(dict.fromkeys([(), *(s.score.features for s in search.steps), *more]))


def plain_result(search: Search, cost: Mapping[Names, float], pick: str) -> dict[str, Any]:
    """The curve, the sets that stand out, the front of accuracy and cost: plain data."""
    scores = [s.score for s in search.steps]
    spent = [cost[s.features] for s in scores]
    sets = {"best": search.best, "smallest": search.smallest, "cheapest": scores[cheapest(scores, spent, search.best)]}
    return {
        "steps": [_step(s, cost) for s in search.steps],
        "ranks": [[name, round(figure, 6)] for name, figure in search.ranks],
        **{name: {**s.plain(), "microseconds": cost[s.features]} for name, s in sets.items()},
        "pick": pick,
        "chosen": list(sets[pick].features),
        "front": list(front([s.value for s in scores], spent)),
        "cost": _cost(search.best.features, cost),
    }


def _step(step: Step, cost: Mapping[Names, float]) -> dict[str, Any]:
    tried = list(step.tried)
    return {"tried": tried, "kept": step.kept, **step.score.plain(), "microseconds": cost[step.score.features]}


def _cost(chosen: Names, cost: Mapping[Names, float]) -> dict[str, Any]:
    """Microseconds per echo of the best set and its parts; `saved` is what leaving a part out saves."""
    without, alone, less = parts_of(chosen)
    whole = cost[chosen]
    return {
        "set": whole,
        "normals": cost[()],
        "scales": {
            t: {"alone": cost[alone[t]], "saved": round(whole - cost[s], 3), "features": list(alone[t])}
            for t, s in without.items()
        },
        "features": {name: round(whole - cost[s], 3) for name, s in less.items()},
    }


def set_file(result: Mapping[str, Any]) -> str:
    """The feature-set file: what a run with ``survey.features`` takes. No times: the same inputs give the same bytes
    (but for a set that was picked by its time)."""
    picked = result[result["pick"]]
    steps = [
        {
            "tried": s["tried"],
            "kept": s["kept"],
            "size": len(s["features"]),
            "accuracy": s["accuracy"],
            "accuracy_std": s["accuracy_std"],
            "kappa": s["kappa"],
        }
        for s in result["steps"]
    ]
    tree = {
        "about": f"{len(result['chosen'])} of {len(result['candidates'])} candidates by {TITLES[result['method']]} on "
        f"{result['survey']}",
        "source": f"fwclass {__version__} select",
        "features": result["chosen"],
        "selection": {
            "method": result["method"],
            "pick": result["pick"],
            "survey": result["survey"],
            "accuracy": picked["accuracy"],
            "accuracy_std": picked["accuracy_std"],
            "kappa": picked["kappa"],
            "kappa_std": picked["kappa_std"],
            "candidates": result["candidates"],
            "left_out": result["left_out"],
            "sample": result["sample"]["digest"],
            "rows": result["sample"]["rows"],
            "params": result["params"],
            "steps": steps,
        },
    }
    return str(yaml.safe_dump(tree, sort_keys=False, width=110, default_flow_style=None))


def scales_file(result: Mapping[str, Any]) -> str:
    """The chosen scales as settings, which a survey's file can take over."""
    tree = {"classify": {"refine": {"between": list(result["classes"]), "scales": list(result["scales"])}}}
    return str(yaml.safe_dump(tree, sort_keys=False, width=110, default_flow_style=None))


def describe(result: Mapping[str, Any]) -> str:
    """The curve as a table for a terminal, and what it advises."""
    sample = result["sample"]
    lines = [
        f"{TITLES[result['method']]}: {len(result['candidates'])} candidates, {sample['rows']:,} echoes of the "
        f"training areas in {sample['blocks']} blocks, {result['params']['folds']} folds",
        *(f"note: {text}" for text in result["notes"]),
        *(f"left out: {name}, {why}" for name, why in result["left_out"].items()),
        "",
        f"{'':2}{'features':>8}  {'accuracy':>15}  {'kappa':>15}  {'us/echo':>8}  tried",
    ]
    lines += [_row(step, result, k in result["front"]) for k, step in enumerate(result["steps"])]
    lines += ["b best, s smallest and c cheapest set as good as the best; * nothing else is as good at less time", ""]
    lines += _advice(result)
    if result["method"] == "scales":
        lines.append(f'--set "classify.refine.scales=[{", ".join(f"{s:g}" for s in result["scales"])}]"')
    return "\n".join(lines)


def _row(step: Mapping[str, Any], result: Mapping[str, Any], on_front: bool) -> str:
    marks = "".join(letter for letter, n in zip("bsc", PICKS, strict=True) if result[n]["features"] == step["features"])
    sign = "" if result["method"] != "rffs" else "-"
    tried = step["tried"]
    shown = first_few([sign + n for n in tried], 3)
    shown += "" if step["kept"] else " (no gain, dropped)"
    accuracy = f"{percent(step['accuracy'])} ± {percent(step['accuracy_std'])}"
    kappa = f"{percent(step['kappa'])} ± {percent(step['kappa_std'])}"
    star = "*" if on_front else " "
    time = f"{step['microseconds']:8.2f}"
    return f"{marks:<3}{star}{len(step['features']):>6}  {accuracy:>15}  {kappa:>15}  {time}  {shown}"


def _advice(result: Mapping[str, Any]) -> list[str]:
    cheap, chosen = result["cheapest"], result["chosen"]
    lines = [f"{result['pick']}: {', '.join(result['chosen'])}"]
    for name, one in result["cost"]["scales"].items():
        alone, saved = f"alone {one['alone']:.2f} us", f"without it {one['saved']:.2f} us less"
        lines.append(f"  {name}: {len(one['features'])} features, {alone}, {saved}")
    if list(cheap["features"]) != list(chosen):
        saved = max(result["cost"]["set"] - cheap["microseconds"], 0.0)
        lines.append(
            f"as good within one standard error as the best: {len(cheap['features'])} features, {saved:.2f} us per "
            f"echo less (--pick cheapest): {', '.join(cheap['features'])}"
        )
    return lines


def curve_of(result: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """The steps as the picture takes them."""
    return [{**s, "size": len(s["features"])} for s in result["steps"]]
