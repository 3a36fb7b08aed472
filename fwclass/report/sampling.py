"""What the report tells of the labels: by class, tile, training box and test area."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fwclass.conf import Config
from fwclass.errors import first_few, several, visible
from fwclass.grid import TileGrid
from fwclass.label.counts import label_remarks, total, total_training
from fwclass.store.receipts import Receipt

BLANK_CODES = frozenset({0, 1, 7, 12, 18})
"""Codes of files that nobody has sorted: never classified, unclassified, noise and overlap."""

SHOWN = 3
"""Files that are named."""


def sampling(
    config: Config,
    counted: Sequence[Receipt],
    drawn: Sequence[Receipt],
    labelled: Sequence[Receipt],
    polygons: Sequence[Receipt],
    corrections: Sequence[Receipt] = (),
    by_echo: Sequence[Receipt] = (),
    *,
    files: Mapping[str, Mapping[int, int]] | None = None,
    whole_run: bool = True,
) -> dict[str, Any] | None:
    """Figures for ``report.json``; None where nothing was counted.

    `counted`, `drawn`, `labelled`, `polygons`, `corrections`, `by_echo`: receipts of the parts `label-counts`,
    `sample-counts`, `label`, `polygons`, `corrections` and `echo-labels`. `files`: echoes of every source file by their
    code in it. `whole_run`: all tiles are among them; else nobody knows of the others' corrections.
    """
    if not counted:
        return None
    classes, train, test = config.classes, config.areas.boxes("train"), config.areas.boxes("test")
    whole = total((r.meta for r in counted), len(train), len(classes))
    rows = total_training((r.meta for r in drawn), len(train), len(classes)) if drawn else None
    by_tile = {r.part: r.meta for r in drawn}
    ambiguous = sum(int(r.meta.get("ambiguous", 0)) for r in labelled)
    notes = label_remarks(whole, rows, by_tile, classes, train, test, config.areas.gap)
    drawn_by_class = rows["train"] if rows else [0] * len(classes)
    drawn_by_box = rows["boxes"] if rows else [[0] * len(classes) for _ in train]
    corrected = _corrections(corrections, labelled)
    blank = files_without_classes(files or {}) if config.survey.reference.kind == "source" else {}
    return {
        "reference": config.survey.reference.kind,
        "echoes": whole["echoes"],
        "labelled": sum(whole["labelled"]),
        "unlabelled": whole["unlabelled"],
        "other_codes": whole["other"],
        "without_classes": {name: sum(codes.values()) for name, codes in blank.items()},
        "left_codes": _less(whole["other"], blank.values()),
        "ambiguous": ambiguous,
        "classes": [
            {"name": c.name, "code": c.code, "labelled": a, "train": b, "taken": t, "test": d}
            for c, a, b, t, d in zip(
                classes, whole["labelled"], whole["train"], drawn_by_class, whole["test"], strict=True
            )
        ],
        "boxes": [
            {"box": list(b.bounds), "labelled": n, "taken": t}
            for b, n, t in zip(train, whole["boxes"], drawn_by_box, strict=True)
        ],
        "test_boxes": [list(b.bounds) for b in test],
        "tiles": [_tile(config, r, by_tile.get(r.part)) for r in counted],
        "gap": {"asked": config.areas.gap, "found": whole["nearest"]},
        "polygons": [dict(r.meta) for r in polygons],
        "corrections": corrected,
        "remarks": [
            *notes,
            *_of_blank_files(blank, config),
            *_of_polygons(polygons, ambiguous),
            *(_remarks_on_corrections(corrected, config.label.max_move) if whole_run else ()),
            *(_of_no_test(corrected, config) if not any(whole["test"]) else ()),
            *(_remarks_on_echo_labels(by_echo, labelled, config.label.max_move) if whole_run else ()),
        ],
    }


def files_without_classes(files: Mapping[str, Mapping[int, int]]) -> dict[str, Mapping[int, int]]:
    """Those of `files` that hold no code but those of `BLANK_CODES`, by name; none where no other file is there."""
    blank = {name: codes for name, codes in sorted(files.items()) if codes and set(codes) <= BLANK_CODES}
    return blank if any(set(codes) - BLANK_CODES for codes in files.values()) else {}


def _less(others: Mapping[str, int], blank: Iterable[Mapping[int, int]]) -> dict[str, int]:
    """`others` without the echoes of `blank` files; codes that none are left of are left out."""
    left = Counter({int(code): n for code, n in others.items()})
    for codes in blank:
        left.subtract(codes)
    return {code: left[int(code)] for code in others if left[int(code)] > 0}


def _of_blank_files(blank: Mapping[str, Mapping[int, int]], config: Config) -> list[str]:
    """That files hold no classes; and that they teach one all the same, where a class counts their code."""
    if not blank:
        return []
    names = first_few([visible(name) for name in blank], SHOWN)
    held = f"The source files hold classes, but for {several(len(blank), 'file')} ({names})"
    of = {code: c.name for c in config.classes for code in c.codes}
    if taught := sorted({of[code] for codes in blank.values() for code in codes if code in of}):
        return [
            f"{held}, which nobody has sorted: all of it is learned, and tested, as {', '.join(taught)}. Leave it out "
            "of survey.sources, or out of all areas.train and areas.test."
        ]
    return [f"{held}: it is classified by what was learned from the others, and not tested."]


def _corrections(read: Sequence[Receipt], labelled: Sequence[Receipt]) -> dict[str, int] | None:
    """How many corrections stand, were taken back, and are of an echo of the run; None without a file of them."""
    if not read:
        return None
    applied = sum(int(r.meta.get("corrected", 0)) for r in labelled)
    return {"standing": read[0].meta["rows"], "taken_back": read[0].meta["taken_back"], "applied": applied}


def _remarks_on_corrections(corrected: dict[str, int] | None, reach: float) -> list[str]:
    lost = corrected["standing"] - corrected["applied"] if corrected else 0
    if lost <= 0 or corrected is None:
        return []
    return [
        f"{lost:,} of {corrected['standing']:,} corrections label nothing: their echo is gone, or another one that "
        f"lies further than {reach:g} m (label.max_move) from its place has its number."
    ]


def _of_no_test(corrected: dict[str, int] | None, config: Config) -> list[str]:
    """That corrections are why no echo is tested."""
    if corrected is None or not corrected["applied"] or config.areas.boxes("test"):
        return []
    return [
        f"{corrected['applied']:,} echoes were corrected or confirmed (fwclass label): all of them train, and nothing "
        f"nearer than {config.areas.gap:g} m (areas.gap) to one is tested. List boxes as areas.test, in and near which "
        "corrections do not train, and confirm nothing in them, for what is confirmed there is tested; or confirm "
        "smaller places."
    ]


def _remarks_on_echo_labels(read: Sequence[Receipt], labelled: Sequence[Receipt], reach: float) -> list[str]:
    rows = sum(int(r.meta["rows"]) for r in read)
    lost = rows - sum(int(r.meta.get("by_echo", 0)) for r in labelled)
    if lost <= 0:
        return []
    later = ", a later file has a label of the same echo" if len(read) > 1 else ""
    return [
        f"{lost:,} of {rows:,} labels by echo label nothing: their echo is not in this survey, or another one that "
        f"lies further than {reach:g} m (label.max_move) from its place has its number (files were renamed, cut or "
        f"sorted anew){later}."
    ]


def _tile(config: Config, counted: Receipt, drawn: Any) -> dict[str, Any]:
    meta = counted.meta
    return {
        "key": counted.part,
        "box": list(TileGrid(config.tile.size).tile(counted.part).box.bounds),
        "echoes": meta["echoes"],
        "labelled": meta["labelled"],
        "train": meta["train"],
        "taken": drawn["train"] if drawn else [0] * len(config.classes),
        "test": meta["test"],
    }


def _of_polygons(polygons: Sequence[Receipt], ambiguous: int) -> list[str]:
    lines = []
    for meta in (r.meta for r in polygons):
        name = meta["file"]
        if meta["reprojected"]:
            lines.append(f"{name}: reprojected {meta['reprojected']}.")
        if meta["invalid"]:
            lines.append(
                f"{name}: {meta['invalid']} polygons left out: rings not closed, too short or without numbers."
            )
        if meta["without_polygon"]:
            lines.append(f"{name}: {meta['without_polygon']} features without a geometry.")
        if meta["without_code"]:
            lines.append(f"{name}: {meta['without_code']} features label nothing: no value, or mapped to null.")
    if ambiguous:
        lines.append(f"{ambiguous_text(ambiguous)}.")
    return lines


def ambiguous_text(n: int) -> str:
    """What is told of `n` echoes in polygons of different classes."""
    where = "in polygons of different classes and"
    return f"1 echo lies {where} is not labelled" if n == 1 else f"{n} echoes lie {where} are not labelled"
