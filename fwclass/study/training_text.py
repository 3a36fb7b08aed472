"""What a training tells at its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.assess.confusion import describe as confusion_table
from fwclass.assess.objects import describe_objects
from fwclass.report.sampling import ambiguous_text

MOST = 10
"""Features whose importance is shown."""


def describe(result: dict[str, Any]) -> str:
    """Samples, notes and accuracy of a trained model, for a terminal."""
    card = result["card"]
    lines = [f"classifier  {card['kind']}, {len(card['features'])} features"]
    eligible = card.get("eligible", card["samples"])
    for one, n, of in zip(card["classes"], card["samples"], eligible, strict=True):
        lines.append(f"sample      {one['name']:<14} {n:>10,} of {of:,} labelled echoes")
    lines += _out_of_bag(card.get("out_of_bag"), card["classes"], sum(card["samples"]))
    lines += _in_folds(result.get("cross_validation"))
    lines += [f"left out    {line}" for line in left_out_lines(result.get("left_out") or ())]
    lines += _importance(card.get("importance"))
    lines += [f"note        {note}" for note in card.get("notes", ())]
    if result.get("ambiguous"):
        lines.append(f"note        {ambiguous_text(result['ambiguous'])}")
    if result["accuracy"]:
        lines += ["", confusion_table(result["accuracy"]), ""]
        lines += [text, ""] if (text := describe_objects(result["accuracy"].get("objects"))) else []
    lines += [f"remark      {text}" for text in result.get("remarks", ())]
    return "\n".join(lines)


def measured_facts(result: Mapping[str, Any]) -> dict[str, Any] | None:
    """What is known of how good a model is where it did not learn, for its card: ``left_out``, ``tested`` (``source``,
    ``overall_accuracy``, ``kappa``, ``mean_iou``, ``echoes``) and ``in_folds``, each where it was judged."""
    accuracy, facts = result["accuracy"], {}
    if result["left_out"]:
        facts["left_out"] = result["left_out"]
    if accuracy:
        figures = {n: accuracy[n] for n in ("overall_accuracy", "kappa", "mean_iou")}
        facts["tested"] = {**figures, "echoes": sum(map(sum, accuracy["confusion"]))}
    if result["cross_validation"]:
        facts["in_folds"] = result["cross_validation"]
    return facts or None


def measured_lines(measured: Mapping[str, Any]) -> list[str]:
    """The same in words; none where nothing is known, or it is no such fact."""
    lines = left_out_lines(measured.get("left_out") or ())
    if tested := measured.get("tested"):
        lines.append(
            f"test areas of its own survey: {100 * tested['overall_accuracy']:.1f} % right, kappa "
            f"{tested['kappa'] or 0:.3f}, mean IoU {100 * tested['mean_iou']:.1f} % of {tested['echoes']:,} echoes"
        )
    if (folds := measured.get("in_folds")) and not lines:
        lines.append(
            f"in folds of its training areas: {100 * folds['accuracy']:.1f} % right, kappa {folds['kappa'] or 0:.3f}"
        )
    return lines


def left_out_lines(judged: Sequence[Mapping[str, Any]]) -> list[str]:
    """Accuracy on every source that a model of the others has not seen, in words."""
    return [
        f"{one['source']}: {100 * one['overall_accuracy']:.1f} % right, kappa {one['kappa'] or 0:.3f}, "
        f"mean IoU {100 * one['mean_iou']:.1f} % of {one['echoes']:,} echoes, by all others"
        + (f", unsure of {100 * unsure:.1f} %" if (unsure := one.get("unsure")) is not None else "")
        for one in judged
    ]


def _out_of_bag(card: Mapping[str, Any] | None, classes: Sequence[Mapping[str, Any]], rows: int) -> list[str]:
    """Accuracy on rows that a tree did not see, whole and by class; n/a where there were none."""
    if card is None:
        return []
    if card["accuracy"] is None:
        return ["out of bag  n/a: every tree saw every training row"]
    each = ", ".join(
        f"{one['name']} {'n/a' if share is None else f'{100 * share:.2f}'}"
        for one, share in zip(classes, card["per_class"], strict=True)
    )
    few = f", judged on {card['rows']:,} of {rows:,} rows" if card["rows"] < rows else ""
    lines = [f"out of bag  {100 * card['accuracy']:.2f} % right ({each}{few})"]
    if card["accuracy"] * len(classes) <= 1:
        lines.append("            no better than guessing: few training rows, or trees that hardly divide them (train)")
    return lines


def _in_folds(figures: Mapping[str, Any] | None) -> list[str]:
    """What cross-validation says where nothing was tested."""
    if figures is None or figures["accuracy"] is None:
        return []
    spread = "" if figures["accuracy_std"] is None else f" ± {100 * figures['accuracy_std']:.2f}"
    kappa = "" if figures["kappa"] is None else f", kappa {figures['kappa']:.3f}"
    return [
        f"in folds    {100 * figures['accuracy']:.2f}{spread} % right{kappa}, in {figures['folds']} folds of "
        f"{figures['squares']} squares of {figures['block']:g} m, {figures['gap']:g} m apart: what other places may "
        "give (out of bag has seen the neighbours of every row, and counts classes as they were drawn)"
    ]


def _importance(card: Mapping[str, Any] | None) -> list[str]:
    """The features that the forest loses most without, best first."""
    if card is None:
        return []
    drop = sorted(card["drop"].items(), key=lambda item: -item[1]["mean"])
    width = max(len(name) for name, _ in drop[:MOST])
    lines = [f"importance  what permuting a feature takes from the accuracy out of bag, {card['repeats']} times"]
    for name, one in drop[:MOST]:
        spread = "" if one["std"] is None else f" ± {100 * one['std']:.2f}"
        lines.append(f"            {name:<{width}} {100 * one['mean']:>7.2f}{spread} %")
    if len(drop) > MOST:
        lines.append(f"            and {len(drop) - MOST} more, in the card")
    return lines
