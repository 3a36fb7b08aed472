"""Where the ground commands write: checks before any work, and points with new classes or heights in any format."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError, InputError
from fwclass.grid import quantise
from fwclass.publish.files import check_free, check_other
from fwclass.publish.laz import write_tile_laz
from fwclass.publish.params import PublishParams
from fwclass.publish.strips import check_records, write_strip_laz
from fwclass.publish.text import write_text
from fwclass.read.cloud import PointCloud
from fwclass.read.las import LasSource
from fwclass.read.text import SUFFIXES as TEXT
from fwclass.schema import Table

LAS = (".las", ".laz")
RASTER = (".tif", ".tiff")


def check_output(source: Path, output: Path, overwrite: bool, rasters: Iterable[Path] = ()) -> None:
    """`ConfigError` if an output cannot or must not be written."""
    rasters = list(rasters)
    suffix = output.suffix.lower()
    if suffix not in (*LAS, *TEXT):
        raise ConfigError(
            "the kind of the output is unknown",
            where=output,
            expected=f"a name that ends in {', '.join((*LAS, *TEXT))}",
            got=output.suffix or "no suffix",
            do="name the output with one of these endings",
        )
    if output.name.lower().endswith(".copc.laz"):
        raise ConfigError(
            "no COPC is written here",
            where=output,
            expected="a name that ends in .laz: points keep their order, an octree would change it",
            got=output.name,
            do="write a plain LAZ file; PDAL's writers.copc or untwine makes COPC of it",
        )
    for path in rasters:
        if path.suffix.lower() not in RASTER:
            raise ConfigError(
                "a raster is a GeoTIFF",
                where=path,
                expected="a name that ends in .tif or .tiff",
                got=path.suffix or "no suffix",
                do="name the raster with one of these endings",
            )
    check_places(source, [output, *rasters], overwrite)


def check_places(source: Path, targets: list[Path], overwrite: bool) -> None:
    """`ConfigError` if one of `targets` cannot or must not be written."""
    if len({t.resolve() for t in targets}) < len(targets):
        raise ConfigError("two outputs have the same name", where=", ".join(map(str, targets)), do="name each its own")
    for path in targets:
        if not path.parent.is_dir():
            raise ConfigError("the output's directory does not exist", where=path.parent, do="make it first")
        _require_writable(path)
        check_other(path, source)
        check_free(path, overwrite)


def _require_writable(path: Path) -> None:
    """`ConfigError` where no file can be made beside `path`; tried, as permissions do not tell all (/proc)."""
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as fault:
        raise ConfigError(
            "the output cannot be written", where=path, got=fault.strerror or fault, do="choose another place"
        ) from fault


def check_copy(cloud: PointCloud, output: Path, overwrite: bool) -> None:
    """`InputError` where a LAS file cannot be copied as its header says, and `ConfigError` if waveforms would go onto a
    file that is there already and is not the source's own."""
    if not isinstance(cloud.source, LasSource) or output.suffix.lower() not in LAS:
        return
    check_records(cloud.path)
    if not cloud.source.has_waves:
        return
    own = cloud.source.waves.path
    outside = own is not None and cloud.source.waves.kind == "external"
    target = output.with_suffix(own.suffix.lower() if own is not None and outside else ".wdp")
    if target.exists() and not overwrite and not (own is not None and own.exists() and target.samefile(own)):
        raise ConfigError(
            "the waveforms of the output would replace a file",
            where=target,
            do="choose another name for the output, or add --overwrite",
        )


def write_points(
    cloud: PointCloud,
    output: Path,
    classes: NDArray[np.uint8],
    params: PublishParams,
    z: NDArray[np.float64] | None = None,
    extra: dict[str, NDArray] | None = None,
) -> dict[str, Any]:
    """The points of `cloud`, in its order, with `classes` and, where given, new `z` (file's unit) and extra bytes.

    LAS to LAS keeps every other byte. What a text or a LAS file made of a text cannot hold is told in ``notes``.

    Returns a dict with at least ``path, points, bytes, notes``; ``wdp`` and ``waveforms`` where the source has
    waveforms.
    """
    if output.suffix.lower() in TEXT:
        return _as_text(cloud, output, classes, z)
    if isinstance(cloud.source, LasSource):
        return write_strip_laz(cloud.path, output, classes, extra, params, z)
    return _text_as_las(cloud, output, classes, params, z, extra or {})


def _as_text(
    cloud: PointCloud, output: Path, classes: NDArray[np.uint8], z: NDArray[np.float64] | None
) -> dict[str, Any]:
    x, y, own = original_coordinates(cloud)
    facts = write_text(output, x, y, own if z is None else z, classes)
    notes = []
    if isinstance(cloud.source, LasSource):
        notes.append("the text holds x y z classification, nothing else of the input")
    elif cloud.source.dropped:
        notes.append(f"columns that are not carried over: {', '.join(cloud.source.dropped)}")
    return {**facts, "notes": notes}


def original_coordinates(cloud: PointCloud) -> tuple[NDArray[np.float64], ...]:
    """x, y, z in the file's own unit, with as many decimals as its scales have."""
    if not isinstance(cloud.source, LasSource):
        return cloud.source.x, cloud.source.y, cloud.source.z
    units = (cloud.units.xy, cloud.units.xy, cloud.units.z)
    return tuple(
        np.round(a / unit, _decimals(scale))
        for a, unit, scale in zip((cloud.x, cloud.y, cloud.z), units, cloud.source.scales, strict=True)
    )


def _decimals(scale: float) -> int:
    """Decimals that show every step of `scale`; at most nine."""
    return next((d for d in range(9) if abs(round(scale, d) - scale) < 1e-6 * abs(scale)), 9)


def _text_as_las(
    cloud: PointCloud,
    output: Path,
    classes: NDArray[np.uint8],
    params: PublishParams,
    z: NDArray[np.float64] | None,
    extra: dict[str, NDArray],
) -> dict[str, Any]:
    x, y, own = original_coordinates(cloud)
    own = own if z is None else z
    bad = ~(cloud.usable & np.isfinite(own))
    if bad.any():
        raise InputError(
            "points without coordinates cannot be written to a LAS file",
            where=cloud.path,
            expected="finite numbers in every line",
            got=f"{int(bad.sum())} points without",
            do="name an output that ends in .txt, or remove those lines",
        )
    n = len(x)
    columns: dict[str, NDArray] = {
        "strip": np.zeros(n, np.uint16),
        "echo_number": np.ones(n, np.uint8),
        "number_of_echoes": np.ones(n, np.uint8),
        "x": quantise(x),
        "y": quantise(y),
        "z": quantise(own),
        "classification": classes,
    }
    facts = write_tile_laz(Table({**columns, **extra}), output, cloud.crs, params)
    rounded = max(float(np.abs(quantise(a) - a).max()) for a in (x, y, own)) > 1e-6
    return {**facts, "notes": ["coordinates are rounded to thousandths of a unit"] if rounded else []}
