"""What a selection found: plain data, a feature set's file, a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from fwclass import __version__
from fwclass.select.score import Names, cheapest, front
from fwclass.select.search import Search, Step
from fwclass.study.select.cost import parts_of

TITLES = {
    "forward": "forward selection (Fan 2013)",
    "rffs": "backward elimination by permutation importance (RFFS, Xiong 2018)",
    "fscore": "ranking by F-score (Shi 2019)",
}

PICKS = ("best", "smallest", "cheapest")
"""Which of the sets on the curve is written: the best score; or, among those that are as good within one standard
error, the one with fewest features or with least time."""


def sets_to_time(search: Search, smallest_parts: bool = True) -> list[Names]:
    """Every set on the curve, and parts of the best one."""
    parts = parts_of(search.best.features) if smallest_parts else ({}, {}, {})
    more = [s for group in parts for s in group.values()]
    return list(dict.fromkeys([(), *(s.score.features for s in search.steps), *more]))


def told(search: Search, cost: Mapping[Names, float], pick: str) -> dict[str, Any]:
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


def set_file(made: Mapping[str, Any]) -> str:
    """The feature-set file: what a run with ``survey.features`` takes. No times: the same inputs give the same bytes
    (but for a set that was picked by its time)."""
    picked = made[made["pick"]]
    steps = [
        {
            "tried": s["tried"],
            "kept": s["kept"],
            "size": len(s["features"]),
            "accuracy": s["accuracy"],
            "accuracy_std": s["accuracy_std"],
            "kappa": s["kappa"],
        }
        for s in made["steps"]
    ]
    tree = {
        "about": f"{len(made['chosen'])} of {len(made['candidates'])} candidates by {TITLES[made['method']]} on "
        f"{made['survey']}",
        "source": f"fwclass {__version__} select",
        "features": made["chosen"],
        "selection": {
            "method": made["method"],
            "pick": made["pick"],
            "survey": made["survey"],
            "accuracy": picked["accuracy"],
            "accuracy_std": picked["accuracy_std"],
            "kappa": picked["kappa"],
            "kappa_std": picked["kappa_std"],
            "candidates": made["candidates"],
            "left_out": made["left_out"],
            "sample": made["sample"]["digest"],
            "rows": made["sample"]["rows"],
            "params": made["params"],
            "steps": steps,
        },
    }
    return str(yaml.safe_dump(tree, sort_keys=False, width=110, default_flow_style=None))


def describe(made: Mapping[str, Any]) -> str:
    """The curve as a table for a terminal, and what it advises."""
    sample = made["sample"]
    lines = [
        f"{TITLES[made['method']]}: {len(made['candidates'])} candidates, {sample['rows']:,} echoes of the training "
        f"areas in {sample['blocks']} blocks, {made['params']['folds']} folds",
        *(f"note: {text}" for text in made["notes"]),
        *(f"left out: {name}, {why}" for name, why in made["left_out"].items()),
        "",
        f"{'':2}{'features':>8}  {'accuracy':>15}  {'kappa':>15}  {'us/echo':>8}  tried",
    ]
    lines += [_row(step, made, k in made["front"]) for k, step in enumerate(made["steps"])]
    lines += ["b best, s smallest and c cheapest set as good as the best; * nothing else is as good at less time", ""]
    lines += _advice(made)
    return "\n".join(lines)


def _row(step: Mapping[str, Any], made: Mapping[str, Any], on_front: bool) -> str:
    marks = "".join(letter for letter, n in zip("bsc", PICKS, strict=True) if made[n]["features"] == step["features"])
    sign = "" if made["method"] != "rffs" else "-"
    tried = step["tried"]
    shown = ", ".join(sign + n for n in tried[:3]) + (f" and {len(tried) - 3} more" if len(tried) > 3 else "")
    shown += "" if step["kept"] else " (no gain, dropped)"
    accuracy = f"{_percent(step['accuracy'])} ± {_percent(step['accuracy_std'])}"
    kappa = f"{_percent(step['kappa'])} ± {_percent(step['kappa_std'])}"
    star = "*" if on_front else " "
    time = f"{step['microseconds']:8.2f}"
    return f"{marks:<3}{star}{len(step['features']):>6}  {accuracy:>15}  {kappa:>15}  {time}  {shown}"


def _advice(made: Mapping[str, Any]) -> list[str]:
    cheap, chosen = made["cheapest"], made["chosen"]
    found = [f"{made['pick']}: {', '.join(made['chosen'])}"]
    for name, one in made["cost"]["scales"].items():
        alone, saved = f"alone {one['alone']:.2f} us", f"without it {one['saved']:.2f} us less"
        found.append(f"  {name}: {len(one['features'])} features, {alone}, {saved}")
    if list(cheap["features"]) != list(chosen):
        saved = max(made["cost"]["set"] - cheap["microseconds"], 0.0)
        found.append(
            f"as good within one standard error as the best: {len(cheap['features'])} features, {saved:.2f} us per "
            f"echo less (--pick cheapest): {', '.join(cheap['features'])}"
        )
    return found


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"


def curve_of(made: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """The steps as the picture takes them."""
    return [{**s, "size": len(s["features"])} for s in made["steps"]]
