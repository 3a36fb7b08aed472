"""How good the classes of a run are, what they were learned from, and how good its ground is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.assess.intervals import caution
from fwclass.conf import Config
from fwclass.graph.classify import OUTSIDE
from fwclass.graph.density import COUNT_ECHOES, SQUARES, densities_by_receipts
from fwclass.graph.ground_auto import AUTO, auto_facts
from fwclass.model.ranges import RANGES
from fwclass.report.drift import drift
from fwclass.report.facts import metas_of_run, receipts_of_run
from fwclass.report.ground import ground_remarks, hall_facts, pits_of
from fwclass.run.runner import Runner


def class_accuracy(runner: Runner, config: Config) -> dict[str, Any] | None:
    """Figures of the classes on the test areas, and which these are; None where nothing was judged."""
    receipt = next(iter(receipts_of_run(runner, "assess")), None)
    if receipt is None or receipt.meta["accuracy"] is None:
        return None
    area = "the listed test areas" if config.areas.test else "all echoes"
    if config.survey.model is not None and not config.areas.train:
        area += ", by a model that was given"
    else:
        area += (
            " outside of every training area"
            if not config.areas.gap
            else f" further than {config.areas.gap:g} m from every training area"
        )
    accuracy = dict(receipt.meta["accuracy"])
    if accuracy.get("intervals"):
        accuracy["intervals"] = {**accuracy["intervals"], "caution": caution(accuracy["intervals"]["blocks"])}
    return {**accuracy, "area": area}


def feature_distribution(runner: Runner) -> dict[str, Any] | None:
    """Quantiles of every feature by class, and how many echoes have a value; None where nothing was judged."""
    receipt = next(iter(receipts_of_run(runner, "assess")), None)
    if receipt is None:
        return None
    distribution = receipt.meta["distribution"]
    labels = [f"p{round(100 * s)}" for s in distribution["shares"]]
    features = {
        feature: {
            name: {**dict(zip(labels, row["quantiles"], strict=True)), "n": row["rows"] - row["without_value"]}
            for name, row in by_class.items()
        }
        for feature, by_class in distribution["features"].items()
    }
    return features if any(row["n"] for by_class in features.values() for row in by_class.values()) else None


def training_facts(runner: Runner, names: tuple[str, ...]) -> dict[str, Any] | None:
    """What the classifier was trained on, and what training said; None where a model was given or nothing trained."""
    receipt = next(iter(receipts_of_run(runner, "train")), None)
    if receipt is None:
        return None
    card = receipt.meta["card"]
    samples = {c["name"]: n for c, n in zip(card["classes"], card["samples"], strict=True)}
    second = receipt.meta.get("fine")
    return {
        "method": card.get("method", "forest"),
        "samples": samples,
        "second_layer": second
        and {
            "method": second.get("method", "forest"),
            "between": [c["name"] for c in second["classes"]],
            "samples": sum(second["samples"]),
            "notes": second.get("notes", []),
        },
        "trees": receipt.meta["trees"],
        "in_context": (card.get("context") or {}).get("cells"),
        "context_trial": receipt.meta.get("tried"),
        "features": list(names),
        "out_of_bag": card.get("out_of_bag", {}).get("accuracy"),
        "notes": card.get("notes", []),
        "importance": card.get("importance"),
    }


def drift_of_run(runner: Runner, given: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """How much lies outside of what the model has seen; None where nothing was classified, or it does not say. `given`:
    the card of a model that the run did not learn itself."""
    counts = [
        r.meta[OUTSIDE]
        for stage in ("coarse", "first-shares", "model-shares", "classify")
        for r in receipts_of_run(runner, stage)
        if OUTSIDE in r.meta
    ]
    if not counts:
        return None
    cards = [r.meta["card"] for stage in ("train-coarse", "train") for r in receipts_of_run(runner, stage)]
    here = densities_by_receipts(metas_of_run(runner, COUNT_ECHOES.name, SQUARES))
    return drift(cards[0] if cards else {RANGES: {}} | dict(given or {}), counts, here)


def ground_facts(runner: Runner, config: Config, withheld: int) -> dict[str, Any]:
    """The filter, what it found, and what cutting the survey into blocks changed. `withheld`: returns that their source
    flags so."""
    blocks = [r.meta for r in receipts_of_run(runner, "ground-filter")]
    seams = next((r.meta for r in receipts_of_run(runner, "seams")), None)
    judged = next((r.meta["ground"] for r in receipts_of_run(runner, "assess")), None)
    squares = [(r.part, r.meta) for r in receipts_of_run(runner, AUTO)]
    edge = config.ground.block * config.ground_auto.blocks
    by_source = [r.meta["of_source"] for r in receipts_of_run(runner, "classify") if "of_source" in r.meta]
    return {
        "method": config.ground.method,
        "auto": auto_facts(squares, edge) if squares else None,
        "echoes": sum(m["rows"] for m in blocks),
        "ground": sum(m["ground"] for m in blocks),
        "noise": sum(m["noise"] for m in blocks),
        "without_terrain": sum(r.meta["without_terrain"] for r in receipts_of_run(runner, "terrain")),
        "block": config.ground.block,
        "accuracy": judged,
        "halls": hall_facts(blocks),
        "pits": pits_of(blocks),
        "seams": dict(seams) if seams else None,
        "remarks": ground_remarks(blocks, withheld, config.ground, by_source, judged),
    }
