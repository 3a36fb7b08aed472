"""What a report remarks on: accuracy, crowded places, empty files, water, contour lines and vectors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.classify.lines import line_remarks
from fwclass.classify.stage import CLASSIFY
from fwclass.conf import Config
from fwclass.errors import first_few, several, visible
from fwclass.features.dense import Crowd
from fwclass.formats.echo_labels import written_by_fwclass
from fwclass.graph.breaklines import BREAKLINES, breakline_remarks, outside_remarks
from fwclass.graph.contours import DELIVER_CONTOURS
from fwclass.graph.outputs import DELIVER_STRIP, DELIVER_TILE
from fwclass.graph.vectors import DELIVER_VECTORS, vector_remarks
from fwclass.graph.water import LEVELS
from fwclass.ground.stage import TERRAIN
from fwclass.report.accuracy_remarks import accuracy_remarks
from fwclass.report.facts import receipts_of_run
from fwclass.report.summary import SHOWN
from fwclass.run.runner import Runner
from fwclass.store.metas import META
from fwclass.survey.layout import Survey

CORRECTED_FROM = 0.01
"""Corrections over tested echoes from which it is said that some of them are tested."""


def remarks_on_accuracy(
    accuracy: Mapping[str, Any] | None,
    counted: Mapping[str, Any] | None,
    echoes: int,
    config: Config,
    names: tuple[str, ...],
    survey: Survey,
    cells: Iterable[float],
    lines: bool,
) -> list[str]:
    """Remarks on the accuracy; none where there is none. `counted`: labels, which only a run that trains counts;
    `echoes` of the whole survey; `cells`: edges of those that a second layer decides by [m];
    `lines`: `lines_changed`."""
    if accuracy is None:
        return []
    own = _own_answers(survey)
    if counted is None:
        return own + accuracy_remarks(accuracy, config, names, echoes, cells=cells, lines=lines)
    nearest = counted["gap"]["found"]
    own += _corrected(accuracy, counted.get("corrections"))
    others = counted["left_codes"]
    return own + accuracy_remarks(accuracy, config, names, counted["echoes"], others, nearest, cells, lines)


def _own_answers(survey: Survey) -> list[str]:
    """That labels by echo are what a run has delivered."""
    paths = [path for path, _ in survey.echo_labels if isinstance(path, Path)]
    names = [visible(path.name) for path in paths if written_by_fwclass(path)]
    if not names:
        return []
    return [
        f"The reference is what a run of fwclass delivered ({first_few(names, SHOWN)}): where nobody corrected it, the "
        "figure tells how a classifier agrees with another one, or with itself, and nothing of how often it is right."
    ]


def _corrected(accuracy: Mapping[str, Any], corrections: Mapping[str, int] | None) -> list[str]:
    """That corrections take their places out of the test, or that they and confirmed answers may be tested."""
    applied, scored = (corrections or {}).get("applied", 0), int(np.sum(accuracy["confusion"]))
    if not applied:
        return []
    if applied <= CORRECTED_FROM * scored:
        return [
            f"{applied:,} labels are corrections. What lies near one that was learned is not tested, and people "
            "correct the worst places: part of what the figure gains over one without them comes from that."
        ]
    return [
        f"{applied:,} labels are corrections, or answers of the model that were confirmed; those in the test areas "
        "make the figure rather too good, as who confirms sees the answer first."
    ]


def remarks_on_crowds(runner: Runner, config: Config) -> list[str]:
    """That some places are too dense for all echoes of a neighbourhood to count."""
    crowd = Crowd.of_parts(r.meta.get("dense") for r in receipts_of_run(runner, "features"))
    return [crowd.text(config.features)] if crowd else []


def remarks_on_files(files: Mapping[str, Any]) -> list[str]:
    """That source files have nothing in them, or are left out."""
    empty = [visible(f["path"]) for f in files["files"] if f["points"] == 0 and not f["pulses"]]
    left = [visible(name) for name in files["excluded"]]
    remarks = [f"files without any point: {first_few(empty, SHOWN)}"] if empty else []
    remarks += _of_headers(files["files"])
    count = several(len(left), "source file")
    return [*remarks, f"left out by survey.exclude: {count}, {first_few(left, SHOWN)}"] if left else remarks


def _of_headers(files: Iterable[Mapping[str, Any]]) -> list[str]:
    """That headers count other points than there are."""
    some = [f"{visible(f['path'])}: {'; '.join(f['header'])}" for f in files if f["header"]]
    if not some:
        return []
    return [f"points are counted here, and taken as such; other programs may go by headers ({first_few(some, SHOWN)})"]


def lines_changed(runner: Runner) -> bool:
    """Whether the class of any echo has changed along lines."""
    return any(any(r.meta.get("lines", ())) for r in receipts_of_run(runner, CLASSIFY.name))


def remarks_of_parts(runner: Runner) -> list[str]:
    """What the parts of water, contour lines, breaklines, wires, vectors, tiles and strips say."""
    stages = (LEVELS, DELIVER_CONTOURS.name)
    remarks = [
        line for stage in stages for receipt in receipts_of_run(runner, stage) for line in receipt.meta["remarks"]
    ]
    blocks = [r.meta["breaklines"] for r in receipts_of_run(runner, TERRAIN.name) if "breaklines" in r.meta]
    remarks += outside_remarks(r.meta for r in receipts_of_run(runner, BREAKLINES))
    remarks += breakline_remarks(blocks)
    remarks += [*_of_strips(runner), *_of_ranges(runner), *_of_own_stages(runner)]
    remarks += line_remarks(r.meta for r in receipts_of_run(runner, CLASSIFY.name))
    return [*remarks, *(line for r in receipts_of_run(runner, DELIVER_VECTORS.name) for line in vector_remarks(r.meta))]


def _of_strips(runner: Runner) -> list[str]:
    """What delivered strips lack of their sources' waveforms."""
    lacking: dict[str, list[str]] = {}
    for receipt in receipts_of_run(runner, DELIVER_STRIP.name):
        for text in receipt.meta.get("lacking", ()):
            lacking.setdefault(text, []).append(receipt.part)
    return [f"delivered strips {first_few(parts, SHOWN)}: {text}" for text, parts in lacking.items()]


def _of_own_stages(runner: Runner) -> list[str]:
    """Echoes without a value in the columns of stages that the program does not know."""
    counts: Counter[tuple[str, str]] = Counter()
    for stage in sorted({name for name, _ in runner.outcomes}.difference(META)):
        for receipt in receipts_of_run(runner, stage):
            counts.update({(stage, n): count for n, count in receipt.meta.get("without_value", {}).items()})
    return [f"{n:,} echoes have no value of {visible(name)} (stage {stage})" for (stage, name), n in counts.items()]


def _of_ranges(runner: Runner) -> list[str]:
    """Values of delivered tiles that their LAZ files cannot hold."""
    beyond, counts = Counter[str](), Counter[str]()
    for receipt in receipts_of_run(runner, DELIVER_TILE.name):
        beyond.update(receipt.meta["beyond"])
        counts.update({name: receipt.meta.get(name, 0) for name in ("rows", "clipped", "without_time")})
    remarks = []
    if counts["without_time"]:
        remarks.append(
            f"{counts['without_time']:,} of {counts['rows']:,} echoes have no GPS time, which is 0 in the LAZ tiles; "
            "the Parquet files have none"
        )
    if counts["clipped"]:
        remarks.append(
            f"{counts['clipped']:,} of {counts['rows']:,} echoes are of pulses with more than 15: their numbers end at "
            "15 in the LAZ tiles; the Parquet files have them"
        )
    if not beyond:
        return remarks
    some = first_few([f"{visible(name)} {n:,}" for name, n in sorted(beyond.items())], SHOWN)
    return [
        *remarks,
        f"values beyond what an extra byte of the LAZ tiles holds are its least or greatest one there ({some}); the "
        "Parquet files have them",
    ]
