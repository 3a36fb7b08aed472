"""GeoPackages: what is written, and a full disk that is told as one, whatever SQLite calls it."""

from __future__ import annotations

import resource
import shutil
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyogrio
import pytest
import shapely

from fwclass.errors import FwclassError
from fwclass.formats.gdal import write_shapes
from fwclass.formats.wkb import point_wkb

PLACES = [(float(k), 0.0) for k in range(5_000)]


def shapes(path: Path) -> None:
    wkb = [shapely.to_wkb(shapely.Point(p)) for p in PLACES]
    write_shapes(path, "a", wkb, {"n": np.arange(len(wkb))}, None, "Point")


def layer(path: Path) -> None:
    """Whole numbers as a list."""
    write_shapes(path, "a", point_wkb(*np.array(PLACES).T), {"n": list(range(len(PLACES)))}, None, "Point")


def _limited(write: Callable[[Path], None], path: Path, words: object) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, 1 << 16))
    try:
        write(path)
    except Exception as fault:  # told to the parent, which judges it
        words.put((type(fault).__name__, str(fault)))  # type: ignore[attr-defined]


@pytest.mark.parametrize("write", [shapes, layer])
def test_a_file_that_may_not_grow_is_told_in_words(tmp_path: Path, write: Callable[[Path], None]) -> None:
    context = get_context("fork")
    words = context.SimpleQueue()
    child = context.Process(target=_limited, args=(write, tmp_path / "a.gpkg", words))
    child.start()
    child.join(60)
    kind, text = words.get()
    assert kind in ("FwclassError", "OSError") and "a.gpkg" in text


@pytest.mark.parametrize("write", [shapes, layer])
def test_a_full_disk_is_told_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write) -> None:
    def refuse(*_, **__) -> None:
        raise pyogrio.errors.FeatureError("Could not add feature to layer at index 0: database or disk is full")

    monkeypatch.setattr(pyogrio.raw, "write", refuse)
    with pytest.raises(FwclassError, match="cannot be written"):
        write(tmp_path / "a.gpkg")
    monkeypatch.setattr(shutil, "disk_usage", lambda where: SimpleNamespace(free=0, total=1))
    with pytest.raises(OSError, match="No space left"):
        write(tmp_path / "a.gpkg")


def test_numbers_in_a_list_stay_what_they_are(tmp_path: Path) -> None:
    fields = {"whole": [1, 2], "share": [0.25, 1.5], "text": ["a", "b"]}
    write_shapes(tmp_path / "a.gpkg", "a", point_wkb(np.zeros(2), np.zeros(2)), fields, None, "Point")
    meta, _, _, columns = pyogrio.raw.read(tmp_path / "a.gpkg")
    read = dict(zip(meta["fields"], columns, strict=True))
    assert {name: values.tolist() for name, values in read.items()} == fields and read["whole"].dtype == np.int64
