"""Annotation: rectangles applied, checked and shown, slice by slice."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import InputError
from fwclass.graph.street_recordings import NO_TRAJECTORY, TrajectoryFiles, open_on_trajectory
from fwclass.publish.files import check_free, written_whole
from fwclass.publish.street_pictures import draw_slice
from fwclass.store.unchanged import check_unchanged
from fwclass.street.annotation import HEAD, Box, Labeller, annotated_end, overlaps, read_boxes
from fwclass.street.frames import Frame
from fwclass.street.params import StreetParams
from fwclass.street.recording_parquet import write_recording
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.track import Track

MOST_SHOWN = 200_000
"""Returns of a picture; of more, evenly chosen ones."""

MOST_PICTURES = 200

MOST_NAMED = 20
"""Rectangles, or pairs of them, that are named of each fault."""

FAR = 1e7
"""m of road, whose places a picture's name has to the centimetre."""

Seen = tuple[list[Any], list[Any], list[Any]]


def annotate(
    source: Path,
    file: Path,
    out: Path | None,
    preview: Path | None,
    slice_: float,
    overwrite: bool,
    params: StreetParams,
    trajectory: TrajectoryFiles = NO_TRAJECTORY,
) -> dict[str, Any]:
    """Apply the rectangles of `file` to a recording; plain data.

    `out`: the recording is written there with its labels. `preview`: a directory for a picture of every slice that has
    rectangles, and of the next one, `slice_` metres long. A `file` that is not there is begun.
    """
    if out is not None:
        check_free(out, overwrite)
    begun = not file.exists()
    if begun:
        with written_whole(file) as beside:
            beside.write_text(",".join(HEAD) + "\n")
    boxes = read_boxes(file)
    track = Track(params)
    labeller = Labeller(boxes, track)
    slices: dict[tuple[float, float], Seen] = {(b.begin, b.end): ([], [], []) for b in boxes}
    spans = list(slices)
    begins, ends = np.array(spans).reshape(-1, 2).T
    last = annotated_end(boxes)
    ahead: list[tuple[float, float]] = [] if last is None else [(last, last + slice_)]
    places: list[float] = []

    def labelled() -> Any:
        for frame, placed in labeller.frames(open_on_trajectory(source, params, trajectory).frames()):
            place = placed.place * UNIT
            places.append(place)
            if not ahead:
                ahead.append((place, place + slice_))
            if preview is not None:
                seen = _seen(frame, placed)
                there = {spans[int(k)] for k in np.flatnonzero((begins <= place) & (place < ends))}
                for span in there | {(begin, end) for begin, end in ahead if begin <= place < end}:
                    for column, values in zip(slices.setdefault(span, ([], [], [])), seen, strict=True):
                        column.append(values)
            yield frame

    none = InputError("no frame of the recording can be used", where=source, do="fwclass street info")
    read_from = (source, *trajectory.files)
    if out is None:
        with check_unchanged(*read_from):
            for _ in labelled():
                pass
    else:
        with written_whole(out) as beside, check_unchanged(*read_from):
            if not write_recording(beside, labelled()):
                raise none
    if not places:
        raise none
    pictures = _pictures(preview, slices, boxes, ahead[0]) if preview is not None else []
    return {
        "recording": str(source),
        "annotation": str(file),
        "begun": begun,
        "metres": [min(places), max(places)],
        "next": list(ahead[0]) if ahead[0][0] < max(places) else None,
        "labels": {str(k): int(n) for k, n in enumerate(labeller.labels) if n and k},
        "unlabelled": float(labeller.labels[0] / max(1, labeller.labels.sum())),
        "remarks": _remarks(boxes, labeller),
        "pictures": pictures,
        "out": None if out is None else str(out),
    }


def _seen(frame: Frame, placed: Any) -> tuple[Any, Any, Any]:
    """y, z [m] and labels of a frame's returns: one copy, however many slices show them."""
    here = ~np.isnan(placed.r)
    labels = np.zeros(int(here.sum()), np.uint8) if frame.labels is None else frame.labels[here]
    return placed.y[here] * UNIT, placed.z[here] * UNIT, labels


def _remarks(boxes: list[Box], labeller: Labeller) -> list[str]:
    empty = [b for b, held in zip(boxes, labeller.held, strict=True) if not held and b.kind != "rest"]
    said = [f"line {box.line}: no return lies in this rectangle ({box.kind})" for box in empty[:MOST_NAMED]]
    more = len(empty) - len(said)
    said += [f"no return lies in {more:,} more rectangles"] * (more > 0)
    pairs = list(islice(overlaps(boxes), MOST_NAMED + 1))
    said += [
        f"lines {a.line} and {b.line}: class {a.code} and {b.code} overlap; the later line wins"
        for a, b in pairs[:MOST_NAMED]
    ]
    return said + ["more rectangles overlap"] * (len(pairs) > MOST_NAMED)


def _pictures(
    preview: Path, slices: dict[tuple[float, float], Seen], boxes: list[Box], ahead: tuple[float, float]
) -> list[str]:
    preview.mkdir(parents=True, exist_ok=True)
    paths = []
    for (begin, end), held in sorted(slices.items())[-MOST_PICTURES:]:
        if not held[0]:
            continue
        y, z, codes = (np.concatenate(v) for v in held)
        few = slice(None, None, max(1, len(y) // MOST_SHOWN))
        inside = [b for b in boxes if b.begin < end and b.end > begin and b.kind != "rest"]
        place = f"{begin:09.2f}" if abs(begin) < FAR else f"{begin:g}"
        name = "next.png" if (begin, end) == ahead else f"slice-{place}.png"
        title = f"{begin:g} to {end:g} m" + (": to be annotated" if (begin, end) == ahead else "")
        with written_whole(preview / name) as beside:
            beside.write_bytes(draw_slice(y[few], z[few], codes[few], inside, title))
        paths.append(str(preview / name))
    return paths


def describe(summary: dict[str, Any]) -> str:
    """The same for a terminal."""
    lines = [f"begun        {summary['annotation']}"] if summary["begun"] else []
    labels = ", ".join(f"{k}: {n}" for k, n in summary["labels"].items()) or "none"
    lines += [
        f"road         {summary['metres'][0]:.2f} to {summary['metres'][1]:.2f} m",
        f"labels       {labels}; {100 * summary['unlabelled']:.1f} % of the returns have none",
        *(f"remark       {text}" for text in summary["remarks"]),
        *(f"picture      {path}" for path in summary["pictures"]),
    ]
    if summary["next"]:
        lines.append(f"next         {summary['next'][0]:g} to {summary['next'][1]:g} m")
    return "\n".join([*lines, *([f"recording    {summary['out']}"] if summary["out"] else [])])
