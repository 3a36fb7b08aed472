"""Variables of GDAL and PROJ that stand in the environment, of another installation perhaps: no raster is delivered
without its place."""

from __future__ import annotations

from pathlib import Path

import pytest
import rasterio
from commandline import process
from smallsurvey import small_survey


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [("PROJ_DATA", "/nowhere", 1), ("GDAL_GEOREF_SOURCES", "NONE", 1), ("GDAL_DATA", "/nowhere", 0)],
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
