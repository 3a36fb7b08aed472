"""What is left behind by what was killed, and what libraries say of damaged files: none of it reaches the user."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import lasmaker
import laspy
import numpy as np
import pytest
from commandline import process

from fwclass.errors import InputError
from fwclass.formats import geoparquet
from fwclass.publish import files
from fwclass.publish.files import written_whole
from fwclass.read.packet_references import References
from fwclass.read.polygons import open_polygons, values_of

TRACKER = """
import multiprocessing, os, signal, time
from multiprocessing import resource_tracker
from fwclass.run.cluster import wait_by_monotonic_clock
wait_by_monotonic_clock()
context = multiprocessing.get_context("spawn")
locks = [context.Lock() for _ in range(3)]
os.kill(resource_tracker._resource_tracker._pid, signal.SIGKILL)
locks.append(context.Lock())
del locks
resource_tracker._resource_tracker._stop()
"""


def test_a_killed_tracker_of_semaphores_says_nothing_when_it_is_started_again() -> None:
    ended = subprocess.run([sys.executable, "-W", "ignore", "-c", TRACKER], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0 and not ended.stderr, ended.stderr


def test_a_command_prints_no_warning_of_a_library(tmp_path: Path) -> None:
    """NaN that signals, in every wave packet block of a file, and in the polygons' rings."""
    truth = lasmaker.survey(tmp_path / "a.las", pulses=20, point_format=9)
    with laspy.open(truth.path) as las:
        start, layout = las.header.offset_to_point_data, las.header.point_format.dtype()
    data = bytearray(truth.path.read_bytes())
    points = np.frombuffer(data, layout, offset=start, count=20)
    for name in ("x_t", "y_t", "z_t", "return_point_wave_location"):
        points[name].view(np.uint32)[:] = 0x7F800001
    truth.path.write_bytes(data)
    ring = "[[0, 0], [10, 0], [10, 10], [5, 5]]"
    (tmp_path / "a.geojson").write_text(f'{{"type": "Polygon", "coordinates": [{ring}]}}')
    ended = process("info", truth.path, tmp_path / "a.geojson")
    assert ended.returncode == 0 and not ended.stderr and "site-packages" not in ended.stdout, ended.stderr
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(References.of(SimpleNamespace(array=points)).step).all()


def test_text_of_a_geoparquet_that_is_none_is_refused(tmp_path: Path) -> None:
    import geopandas
    import shapely

    path = tmp_path / "a.parquet"
    geopandas.GeoDataFrame({"k": ["roofs"]}, geometry=[shapely.box(0, 0, 1, 1)], crs=25832).to_parquet(
        path, compression=None
    )
    path.write_bytes(path.read_bytes().replace(b"roofs", b"\xff\xfe\xff\xfe\xff"))
    with pytest.raises(InputError, match="no GeoParquet file"):
        values_of(open_polygons(path), ["k"])


@pytest.mark.parametrize(
    "crs", ["+init=/etc/passwd:1", "+proj=utm +zone=32 +nadgrids=/etc/passwd", "https://h/crs.wkt"]
)
def test_a_coordinate_system_of_a_geoparquet_names_no_file(crs: str) -> None:
    with pytest.raises(InputError, match="no GeoParquet file"):
        geoparquet._crs(Path("a.parquet"), {"crs": crs})


def gone() -> int:
    """The number of a process that has ended."""
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        return process.pid


def test_what_a_killed_command_left_goes_with_the_next(tmp_path: Path) -> None:
    host, own = files._host(), os.getpid()
    dead = [f".dtm.tif.{host}-{gone()}.part.tif{more}" for more in ("", ".raw", ".ovr.tmp", ".raw.aux.xml")]
    kept = [
        f".dtm.tif.{host}-{own}.part.tif",
        f".other.tif.{host}-{gone()}.part.tif",
        f".dtm.tif.elsewhere-{gone()}.part.tif",
    ]
    for name in (*dead, *kept):
        (tmp_path / name).touch()
    with written_whole(tmp_path / "dtm.tif") as beside:
        beside.write_text("x")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["dtm.tif", *kept[1:]])


KILLED = """
import os, signal, sys
from pathlib import Path
from fwclass.publish.files import written_whole
with written_whole(Path(sys.argv[1])) as beside:
    beside.write_text("half")
    beside.with_name(beside.name + ".raw").write_text("raw")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_command_that_was_killed_leaves_nothing_that_the_next_does_not_remove(tmp_path: Path) -> None:
    for _ in range(2):
        subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "a.tif")], timeout=60)
        assert len(list(tmp_path.iterdir())) == 2
    with written_whole(tmp_path / "a.tif") as beside:
        beside.write_text("x")
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]
