"""Variables of GDAL and PROJ that stand in the environment, of another installation perhaps: no raster is delivered
without its place, and none of other bytes."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
import rasterio
from commandline import process
from smallsurvey import small_survey

from fwclass import isolation
from fwclass.run.part import settle_process


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [("PROJ_DATA", "/nowhere", 1), ("GDAL_GEOREF_SOURCES", "NONE", 0), ("GDAL_DATA", "/nowhere", 0)],
)
def test_a_raster_without_its_place_is_refused(tmp_path: Path, monkeypatch, name: str, value: str, code: int) -> None:
    """It was written as lying in a system of its own, or nowhere, and the command ended with 0."""
    small_survey(tmp_path)
    raster = tmp_path / "dtm.tif"
    monkeypatch.setenv(name, value)
    ended = process("ground", tmp_path / "a.las", tmp_path / "g.laz", "--dtm", raster, "--crs", "EPSG:25832")
    assert ended.returncode == code, ended.stderr
    if code:
        assert "without its coordinate system or its place" in ended.stderr and f"unset {name}" in ended.stderr
        assert not raster.exists()
        return
    monkeypatch.delenv(name)
    with rasterio.open(raster) as file:
        assert file.crs == rasterio.crs.CRS.from_epsg(25832) and file.transform.c == 500_000


SETTINGS = {
    "GDAL_TIFF_ENDIANNESS": "BIG",
    "GDAL_TIFF_OVR_BLOCKSIZE": "256",
    "COMPRESS_OVERVIEW": "LZW",
    "GTIFF_WRITE_TOWGS84": "YES",
    "GTIFF_ESRI_CITATION": "YES",
    "OSR_STRIP_TOWGS84": "NO",
    "GDAL_PAM_ENABLED": "NO",
    "OGR_ORGANIZE_POLYGONS": "SKIP",
}


@pytest.mark.parametrize("where", ["environment", "file", "home"])
def test_settings_of_gdals_change_no_byte(tmp_path: Path, monkeypatch, where: str) -> None:
    """A raster came out in the other order of bytes."""
    small_survey(tmp_path)
    words = ("ground", tmp_path / "a.las", tmp_path / "g.laz", "--crs", "EPSG:25832", "--overwrite", "--dtm")
    assert process(*words, tmp_path / "one.tif").returncode == 0
    lines = "".join(f"{name}={value}\n" for name, value in SETTINGS.items())
    file = tmp_path / ".gdal" / "gdalrc"
    file.parent.mkdir()
    file.write_text(f"[configoptions]\n{lines}")
    for name, value in SETTINGS.items() if where == "environment" else ():
        monkeypatch.setenv(name, value)
    if where == "file":
        monkeypatch.setenv("GDAL_CONFIG_FILE", str(file))
    if where == "home":
        monkeypatch.setenv("XDG_CACHE_HOME", str(Path.home() / ".cache"))
        monkeypatch.setenv("HOME", str(tmp_path))
    ended = process(*words, tmp_path / "two.tif")
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "one.tif").read_bytes() == (tmp_path / "two.tif").read_bytes()


def test_a_worker_that_was_started_by_hand_has_none(monkeypatch) -> None:
    monkeypatch.setenv("GDAL_TIFF_ENDIANNESS", "BIG")
    monkeypatch.setenv("GDAL_DATA", "/place")
    settle_process()
    assert "GDAL_TIFF_ENDIANNESS" not in os.environ and os.environ["GDAL_DATA"] == "/place"
    assert os.environ["GDAL_CONFIG_FILE"] == os.devnull


def test_variables_of_other_programs_stay(monkeypatch) -> None:
    """Whatever ended with _OVERVIEW went, on workers that were started by hand too."""
    for name in ("MY_OVERVIEW", "COMPRESS_OVERVIEW", "JXL_EFFORT_OVERVIEW"):
        monkeypatch.setenv(name, "9")
    settle_process()
    assert {n for n in os.environ if n.endswith("_OVERVIEW")} == {"MY_OVERVIEW"}


def test_all_that_gdal_packs_overviews_by_is_known() -> None:
    """Another version of it may have more."""
    libraries = list(Path(rasterio.__file__).parents[1].glob("*.libs/libgdal*"))
    if not libraries:
        pytest.skip("GDAL is not that of wheels")
    held = {m.decode() for f in libraries for m in re.findall(rb"\0([A-Z_]{1,30}_OVERVIEW)(?=\0)", f.read_bytes())}
    assert "COMPRESS_OVERVIEW" in held
    assert {name for name in held if not name.startswith(isolation.SETTINGS)} <= isolation.OVERVIEWS
