"""Places of a delivery whose labels teach most, as a file; and what was looked at there, as labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.checkout import read_note
from fwclass.delivery.collect import codes_that_stand, run_of
from fwclass.delivery.echoes import table_columns
from fwclass.delivery.opened import Delivery, open_run
from fwclass.delivery.places import COLUMNS, count_places_away, echoes_in, no_echo, read_places
from fwclass.delivery.worklist import check_geopackage
from fwclass.errors import InputError, several
from fwclass.formats.echo_labels import TAKEN_BACK, EchoLabels
from fwclass.formats.wkb import box_wkb
from fwclass.grid import Box, millimetres, whole_millimetres
from fwclass.label.crossings import crossing_parts
from fwclass.label.params import SuggestParams
from fwclass.label.places import PlaceCounts, SuggestedPlace
from fwclass.publish.gpkg import Layer, write_gpkg
from fwclass.schema import PLACE
from fwclass.store.corrections import add_corrections, place_of, read_corrections
from fwclass.store.run_location import RunLocation

LAYER = "places"

CROSSES = (
    "with an outline that crosses itself: confirmed are the echoes from which a line to one side crosses it an odd "
    "number of times, as QGIS fills it (docs/labels.md); look whether these are those that you mean"
)


def suggest(run: RunLocation, params: SuggestParams, path: Path, overwrite: bool) -> str:
    """Write the places of a run whose labels teach most as a GeoPackage, layer `LAYER`; a sentence of what was written.

    `InputError`: `run` is no run that has delivered, or its echoes have no entropy. `ConfigError`: there is such a file
    already.
    """
    check_geopackage(path, overwrite)
    delivery = open_run(run)
    counts = PlaceCounts(params.size)
    for tile in delivery.tiles:
        columns = table_columns(delivery.table(str(tile["tile"])), (*PLACE, "classification", "entropy"))
        if "entropy" not in columns:
            raise InputError(
                "this delivery does not tell how sure its classes are",
                where=delivery.path,
                expected="a run that classifies by a model",
                got="no column entropy",
                do="suggest places of another run",
            )
        x, y, z = (millimetres(columns[n]) for n in PLACE)
        counts.add(x, y, z, columns["classification"], columns["entropy"])
    counts = counts.widened(params.echoes)
    useful, places = len(counts.useful(params)), counts.suggest(params, _settled(delivery, counts.size))
    names = {int(c["code"]): str(c["name"]) for c in delivery.report["classes"]}
    fields: dict[str, NDArray[Any] | Sequence[str]] = {
        "rank": np.arange(1, len(places) + 1, dtype=np.int32),
        "echoes": np.array([p.echoes for p in places], np.int64),
        "entropy": np.array([p.entropy for p in places], np.float64),
        "mixture": np.array([p.mixture for p in places], np.float64),
        "classes": [", ".join(f"{names.get(code, f'code {code}')} {n}" for code, n in p.classes) for p in places],
    }
    write_gpkg([Layer(LAYER, box_wkb([p.box for p in places]), fields)], path, delivery.crs)
    return _summary(useful, places, counts.size, path)


def _settled(delivery: Delivery, size: float) -> Callable[[SuggestedPlace], bool]:
    """Whether labels of a place would teach nothing: it meets an area that is tested or trains already, or half of its
    echoes are corrected."""
    config, areas = delivery.report["config"], delivery.report["areas"]  # as they were looked up: files, polygons, all
    survey = config["survey"]
    boxes = [Box(*b).grown(float(config["areas"]["gap"])) for b in areas["test"]]
    if survey["model"] is None:
        boxes += [Box(*b) for b in areas["train"]]
    stands = read_corrections(delivery.root).standing()
    stands = stands.take(stands.code != TAKEN_BACK)
    edge = whole_millimetres(size, "suggest.size")
    squares = np.stack([millimetres(stands.x) // edge, millimetres(stands.y) // edge], axis=1)
    keys, counts = np.unique(squares, axis=0, return_counts=True)
    corrected = dict(zip(map(tuple, keys.tolist()), counts.tolist(), strict=True))

    def settled(place: SuggestedPlace) -> bool:
        square = round(place.box.xmin / size), round(place.box.ymin / size)
        return 2 * corrected.get(square, 0) >= place.echoes or any(b.touches(place.box) for b in boxes)

    return settled


def _summary(useful: int, places: Sequence[SuggestedPlace], size: float, path: Path) -> str:
    if not places:
        none = f"no place of {size:g} m teaches more: the model is sure of it, or it is labelled or tested already"
        return f"{none}; {path} is empty"
    echoes = sum(p.echoes for p in places)
    return (
        f"{several(len(places), 'place')} of {size:g} m, out of {useful:,}, with {echoes:,} echoes: "
        f"layer {LAYER} of {path}"
    )


@dataclass(frozen=True)
class Confirmed:
    """What was confirmed: `echoes` by class code, `corrected` echoes that had been corrected before, and how many were
    `passed_over`, as they have no class by the model, all in `places` places, `away` of which lie off the survey and
    `crossing` of which cross themselves; `where` it was written."""

    echoes: Mapping[int, int]
    corrected: int
    passed_over: int
    places: int
    names: Mapping[int, str]
    where: str
    away: int = 0
    crossing: int = 0

    def __str__(self) -> str:
        total = sum(self.echoes.values())
        listed = ", ".join(f"{self.names.get(c, f'code {c}')} {n:,}" for c, n in sorted(self.echoes.items()))
        without = f", {self.passed_over:,} have no class to confirm" if self.passed_over else ""
        off = f" ({self.away:,} of them away from the survey)" if self.away else ""
        return (
            f"{several(self.places, 'place')}{off}: {total:,} echoes keep their class ({listed or 'none'}), "
            f"{self.corrected:,} had been corrected{without}; {self.where}"
            + (f"\nnote: {several(self.crossing, 'place')} {CROSSES}" if self.crossing else "")
        )


def confirm(run: RunLocation, path: Path, who: str, time: int) -> Confirmed:
    """Add the classes of all echoes in the places of a file to the corrections of a run; what was corrected stays.

    `time`: of these rows, microseconds since 1970 (UTC).

    `InputError`: `run` is no run that has delivered, or no classified echo lies in any place. `StoreError`: the run
    cannot be written to.
    """
    delivery = open_run(run)
    places = read_places(path, delivery)
    rows = echoes_in(delivery, places)
    if not _classified(delivery, rows).any():
        raise no_echo(path, places, delivery)
    confirmed = _confirm(delivery, rows, places.parts, who, time)
    return replace(confirmed, away=count_places_away(delivery, places), crossing=int(crossing_parts(places).sum()))


def confirm_tiles(directory: Path, run: Path | None, who: str, time: int) -> Confirmed:
    """Confirm all echoes of the tiles in a directory of `checkout` that were not changed there, after `collect`.

    `InputError`: the run has delivered anew since: what was looked at is not what it says now.
    """
    note = read_note(directory)
    delivery = run_of(note, run, directory)
    if delivery.path.name != note.generation:
        raise InputError(
            "the run has delivered anew since these tiles were checked out",
            where=directory,
            expected=f"delivery {note.generation}",
            got=delivery.path.name,
            do="what was changed is collected; to confirm the rest, check the tiles out again and look at them",
        )
    parts = [table_columns(delivery.table(tile), COLUMNS) for tile in sorted(note.tiles)]
    rows = {n: np.concatenate([p[n] for p in parts]) for n in COLUMNS}
    return _confirm(delivery, rows, len(parts), who, time)


def _classified(delivery: Delivery, rows: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
    classes = [int(c["code"]) for c in delivery.classes]
    return np.isin(rows["classification"], classes) & np.isfinite(rows["confidence"])


def _confirm(delivery: Delivery, rows: Mapping[str, NDArray[Any]], places: int, who: str, time: int) -> Confirmed:
    classified = _classified(delivery, rows)
    echoes = {n: v[classified] for n, v in rows.items()}
    labels = EchoLabels.of(echoes, echoes["classification"], time, who)
    corrected = 0

    def change(earlier: EchoLabels) -> EchoLabels:
        nonlocal corrected
        stands = codes_that_stand(labels, earlier.standing()) != TAKEN_BACK
        corrected = int(stands.sum())
        return labels.take(~stands)

    added = add_corrections(delivery.root, change)
    codes, counts = np.unique(added.code, return_counts=True)
    names = {int(c["code"]): str(c["name"]) for c in delivery.report["classes"]}
    by_code = dict(zip(codes.tolist(), counts.tolist(), strict=True))
    passed_over = int((~classified).sum())
    return Confirmed(by_code, corrected, passed_over, places, names, str(place_of(delivery.root)))
