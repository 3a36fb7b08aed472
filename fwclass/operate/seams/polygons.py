"""What was computed once more as polygons, and the echoes that differ as points: a GeoPackage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fwclass.errors import ConfigError
from fwclass.formats.geopackage import points, rectangles, write_layer
from fwclass.operate.seams.summary import Found
from fwclass.store.atomic import move_into_place, staged


def check_free(path: Path, overwrite: bool) -> None:
    """`ConfigError` where there is a file that may not be replaced."""
    if path.exists() and not overwrite:
        raise ConfigError("there is such a file already", where=path, do="--overwrite, or another name")


def write_gpkg(found: Found, path: Path, crs: str | None) -> None:
    """Layers ``strips`` and, where there are any, ``echoes``.

    Strips lie along the borders; ``part`` is the tile of the shifted grid, ``differ`` how many of its echoes do, in the
    stage with most of them. Echoes are those listed: stage, column, the run's value and the other.
    """
    bounds: list[tuple[float, ...]] = []
    fields: dict[str, list[Any]] = {"part": [], "differ": []}
    tiles = [s for s in found.bounded if s.parts == "tile"]
    for place in found.strips:
        wrong = max((s.at.get(place.tile.key, (0, 0))[1] for s in tiles), default=0)
        for strip in place.strips:
            bounds.append(strip.bounds)
            fields["part"].append(place.tile.key)
            fields["differ"].append(wrong)
    listed = [{"stage": s.stage, **e} for s in found.bounded for e in s.examples]
    path.parent.mkdir(parents=True, exist_ok=True)
    with staged(path.parent) as directory:
        write_layer(directory / path.name, "strips", "Polygon", rectangles(bounds), fields, crs)
        if listed:
            places = points((e["x"], e["y"]) for e in listed)
            names = ("stage", "part", "strip", "pulse", "echo_number", "column")
            told: dict[str, list[Any]] = {n: [e[n] for e in listed] for n in names}
            told |= {n: [str(e[n]) for e in listed] for n in ("run", "shifted")}
            write_layer(directory / path.name, "echoes", "Point", places, told, crs)
        move_into_place(directory / path.name, path)
