"""Train a model on labelled recordings, and judge it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.intervals import LEAST
from fwclass.assess.remarks import chance_remarks
from fwclass.classes import ClassDef, class_index
from fwclass.conf import Config
from fwclass.errors import InputError, first_few
from fwclass.graph.street import (
    Rows,
    Split,
    answered_rows,
    as_answered,
    fit_model,
    judge_answers,
    recordings_of,
    rows_of,
    sample_of,
)
from fwclass.graph.street_recordings import TrajectoryFiles
from fwclass.single_file.model_directory import check_target, copy_model
from fwclass.store.models import save_model
from fwclass.store.unchanged import check_unchanged
from fwclass.street.ring import feature_names
from fwclass.temporary import temporary_directory


def train(
    config: Config, target: Path, overwrite: bool, assess: bool, say: Callable[[str], None], directory: Path | None
) -> dict[str, Any]:
    """Train the model of `config` on its recordings (those in `directory`, if given), deliver it to `target`, and with
    `assess` judge it on the returns that are left; plain data."""
    check_target(target, overwrite)
    paths = recordings_of(config, directory)
    params, classes, split = config.street, config.classes, Split.of(config)
    names, way = feature_names(params), TrajectoryFiles.of(config)
    say(f"features     {len(names)} of {len(paths)} recordings")
    odd: dict[str, list[str]] = {}
    codes = np.zeros(256, np.int64)

    def tell(path: Path, faults: list[str]) -> None:
        odd.update({path.name: faults} if faults else {})

    with check_unchanged(*paths, *way.files):
        rows = counted(rows_of(paths, params, way, tell), codes)
        sample = sample_of(rows, names, split, classes, config.train.samples_per_class)
    say(f"training     {config.train.method} on {sample.rows} returns")
    model = fit_model(sample, params, config.train, config.compare, classes)
    with temporary_directory("street", target.parent) as beside:
        save_model(beside / "model", model)
        copy_model(beside / "model", target, overwrite)
    summary: dict[str, Any] = {"model": str(target), "card": dict(model.card), "accuracy": None, "remarks": []}
    summary["implausible"] = [f"{name}: {fault}" for name, faults in odd.items() for fault in faults]
    share, text = codes_of_no_class(codes, classes)
    if share:
        summary["implausible" if share > config.plausibility.max_uncounted else "remarks"].append(text)
    if assess:
        say("assessing    the returns that did not train")
        try:
            with check_unchanged(*paths, *way.files):
                accuracy = judge_answers(
                    answered_rows(paths, params, model, way), as_answered, split, classes, config.assess.block
                )
        except ValueError as fault:
            raise InputError("the answers cannot be judged", where=paths[0], got=str(fault)) from fault
        if accuracy["rows"]:
            summary["accuracy"] = accuracy
            if split.kind == "random":
                summary["remarks"].append(
                    "neighbours of the test returns trained: a random split flatters, threefold on a real street"
                )
        else:
            summary["remarks"].append("no labelled return is left to test on: give smaller areas.train, or more road")
    return summary


def counted(blocks: Iterable[Rows], codes: NDArray[np.int64]) -> Iterator[Rows]:
    """The same blocks; `codes`, int64 (256,), takes how many of their returns have each reference code."""
    for rows in blocks:
        codes += np.bincount(rows.codes, minlength=256)
        yield rows


def codes_of_no_class(codes: NDArray[np.int64], classes: Sequence[ClassDef]) -> tuple[float, str]:
    """Share of the labelled returns, by `codes` as `counted` has them, that no class counts, and what is said of it."""
    every = np.arange(1, 256, dtype=np.uint8)
    alien = every[(class_index(every, classes) < 0) & (codes[1:] > 0)]
    total, left = int(codes[1:].sum()), int(codes[alien].sum())
    if not left:
        return 0.0, ""
    listed = first_few([f"{code} ({codes[code]:,})" for code in alien.tolist()], 5)
    return left / total, (
        f"{left:,} of {total:,} labelled returns train and test nothing: no class counts their reference code {listed} "
        "(survey.classes)"
    )


def describe(summary: dict[str, Any]) -> str:
    """The same for a terminal."""
    card = summary["card"]
    counts = ", ".join(f"{c['name']} {n}" for c, n in zip(card["classes"], card["samples"], strict=True))
    lines = [f"trained on   {counts}", *(f"remark       {n}" for n in card.get("notes", ()))]
    if summary["accuracy"]:
        lines += crown_lines(summary["accuracy"])
    lines += [f"remark       {n}" for n in summary["remarks"]]
    lines += [f"  ! {text}" for text in summary["implausible"]]
    return "\n".join([*lines, f"model        {summary['model']}"])


def crown_lines(accuracy: dict[str, Any]) -> list[str]:
    """Error, detection and false alarm with their intervals."""
    few = f", too few for intervals: {LEAST} are wanted" if accuracy["blocks"] < LEAST else ""
    lines = [f"tested on    {accuracy['rows']} returns in {accuracy['blocks']} blocks of road{few}"]
    for key, word in (("error", "error"), ("detection", "detection"), ("false_alarm", "false alarm")):
        value, ends = accuracy[key], accuracy[f"{key}_interval"]
        span = f"  [{100 * ends[0]:.2f}, {100 * ends[1]:.2f}]" if ends else ""
        lines.append(f"{word:<12} {'-' if value is None else f'{100 * value:.2f} %'}{span}")
    return [
        *lines,
        f"kappa        {accuracy['kappa']:.4f}" if accuracy["kappa"] is not None else "kappa        -",
        *(f"remark       {text}" for text in chance_remarks(accuracy)),
    ]
