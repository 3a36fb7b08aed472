"""The work list of a run as a file: places of unsure echoes, as the viewer goes through them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.errors import ConfigError, several
from fwclass.formats.wkb import box_wkb
from fwclass.grid import Box
from fwclass.publish.files import check_free
from fwclass.publish.gpkg import Layer, write_gpkg
from fwclass.store.run_location import RunLocation
from fwclass.view.params import ViewParams

LAYER = "places"


def check_geopackage(path: Path, overwrite: bool) -> None:
    """`ConfigError` where there is something that may not be replaced, or the name is none of a GeoPackage."""
    if path.suffix.lower() != ".gpkg":
        raise ConfigError(
            "places are written as a GeoPackage", where=path, do=f"call it {path.with_suffix('.gpkg').name}"
        )
    check_free(path, overwrite)


def write_work_list(run: RunLocation, params: ViewParams, path: Path, overwrite: bool) -> str:
    """Write the places of a run as a GeoPackage, layer `LAYER`, rank 1 the largest; a sentence of what was written.

    `InputError`: `run` is no run that has delivered. `ConfigError`: there is such a file already.
    """
    check_geopackage(path, overwrite)
    scene = ViewedRun(open_run(run), params)
    listed = scene.work_list()
    places = listed.places
    names = {int(c["code"]): str(c["name"]) for c in scene.delivery.report["classes"]}
    texts = [", ".join(f"{names.get(code, f'code {code}')} {n}" for code, n in p.classes) for p in places]
    fields: dict[str, NDArray[Any] | Sequence[str]] = {
        "rank": np.arange(1, len(places) + 1, dtype=np.int32),
        "echoes": np.array([p.echoes for p in places], np.int64),
        "confidence": np.array([p.confidence for p in places], np.float64),
        "classes": texts,
        **{axis: np.array([getattr(p, axis) for p in places], np.float64) for axis in ("x", "y", "z", "size")},
    }
    write_gpkg([Layer(LAYER, box_wkb([Box(*p.box) for p in places]), fields)], path, scene.delivery.crs)
    if not places:
        return f"no echo has a confidence below {params.unsure:g}: the layer {LAYER} of {path} is empty"
    echoes = f"{sum(p.echoes for p in places):,} unsure echoes"
    most = f", the largest of {listed.total:,}" if listed.total > len(places) else ""
    return f"{several(len(places), 'place')} of {echoes}{most}: layer {LAYER} of {path}"
