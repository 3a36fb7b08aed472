"""Trajectories: the simulator's table, other headings, SBET, time scales, and files that are something else."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from fwclass.errors import InputError
from fwclass.read import trajectory
from fwclass.read.trajectory import in_survey_time, read_trajectory, thin_trajectory
from fwclass.schema import Table
from fwclass.simulate.params import SimulateParams
from fwclass.simulate.stage import write_trajectory
from fwclass.units import ADJUSTED, GPS_WEEK

CRS = "EPSG:25832"
ROWS = np.array([[10.0, 500.0, 800.0, 370.5], [10.5, 530.0, 801.0, 371.0], [11.0, 560.0, 802.0, 371.25]])


def written(folder: Path, text: str | bytes, name: str = "path.txt") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("latin-1"))
    return path


def matrix(table: Table) -> np.ndarray:
    return np.stack([table[name] for name in ("gps_time", "x", "y", "z")], axis=1)


def lines(mark: str, columns: Any = slice(None)) -> str:
    return "\n".join(mark.join(f"{v:.3f}" for v in row[columns]) for row in ROWS)


def sbet(rows: np.ndarray) -> bytes:
    """Bytes of an SBET file; `rows` are time, latitude [rad], longitude [rad], altitude."""
    record = np.zeros((len(rows), 17), "<f8")
    record[:, :4] = rows
    record[:, 4:] = np.random.default_rng(1).normal(size=(len(rows), 13))
    return record.tobytes()


@pytest.mark.parametrize(
    "text",
    [
        lines(" "),
        lines("\t") + "\n",
        "# a comment\n\n" + lines(",") + "\n\n",
        "gps_time,x,y,z\n" + lines(","),
        "# time x y z\n" + lines("  "),
        '"Time [s]";"Easting [m]";"Northing [m]";"Height [m]"\r\n' + lines(";").replace("\n", "\r\n"),
        "POSPac export\nproject: T\xfcbingen, 2013\n\nGPS Time, North, East, Alt\n" + lines(",", [0, 2, 1, 3]),
        "z,y,x,t\n" + lines(",", [3, 2, 1, 0]),
        b"\xef\xbb\xbf" + lines(",").encode(),
        b"\xef\xbb\xbfTIME,X,Y,Z\n" + lines(",").encode(),
        "name,gps_time,x,y,z,roll\n" + "\n".join(f"line 1,{row},," for row in lines(",").split("\n")),
        lines(" ").replace("\n", " 0.1 0.2\n") + " 0.1 0.2",
    ],
)
def test_text_tables(text: str | bytes, tmp_path: Path) -> None:
    np.testing.assert_array_equal(matrix(read_trajectory(written(tmp_path, text))), ROWS)


def test_the_simulators_own_table(base: dict[str, Any], tmp_path: Path) -> None:
    params = SimulateParams(**{**base["simulate"], "size": 60.0, "strips": 2})
    path = write_trajectory(params, tmp_path)
    got = matrix(read_trajectory(path))
    rows = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(1, 2, 3, 4))
    np.testing.assert_array_equal(got, rows)
    assert (np.diff(got[:, 0]) > 0).all()
    assert got[0, 0] >= params.flight.first_gps_time


def test_sorted_without_repetitions_and_without_gaps_filled(tmp_path: Path) -> None:
    rows = np.array([[3.0, 1, 1, 1], [1.0, 2, 2, 2], [3.0, 1.01, 1, 1], [2.0, np.nan, 3, 3], [900.0, 4, 4, 4]])
    path = written(tmp_path, "\n".join(" ".join(map(str, row)) for row in rows))
    np.testing.assert_array_equal(matrix(read_trajectory(path)), [[1.0, 2, 2, 2], [3.0, 1, 1, 1], [900.0, 4, 4, 4]])


@pytest.mark.parametrize(
    "rows",
    [
        [[float(t), 30.0 * t, y, 400.0] for t in range(40) for y in (0.0, 600.0)],
        [[float(t) + 1e-3 * k, 30.0 * t, 600.0 * k, 400.0] for k in (0, 1) for t in range(40)],
        [[float(t), 30.0 * t + 700.0 * (t == 20), 0.0, 400.0] for t in range(40)],
    ],
)
def test_two_places_at_one_time_are_refused(rows: list[list[float]], tmp_path: Path) -> None:
    path = written(tmp_path, "\n".join(" ".join(map(str, row)) for row in rows))
    with pytest.raises(InputError, match=r"(?s)two places at one time.*jump"):
        read_trajectory(path)


def test_flights_joined_in_any_order_are_read(tmp_path: Path) -> None:
    flights = [[[900.0 * k + t, 40.0 * t, 500.0 * k, 400.0] for t in range(60)] for k in (1, 0)]
    path = written(tmp_path, "\n".join(" ".join(map(str, row)) for flight in flights for row in flight))
    np.testing.assert_array_equal(matrix(read_trajectory(path)), [*flights[1], *flights[0]])


def around(n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """SBET rows of a flight near 9 deg E, 48.7 deg N, and what they are in UTM."""
    time = 300_000.0 + np.arange(n) / 200.0
    lon, lat = 9.1 + 1e-5 * np.arange(n), 48.7 + 2e-6 * np.arange(n)
    z = 700.0 + np.sin(np.arange(n))
    x, y = Transformer.from_crs("EPSG:4258", CRS, always_xy=True).transform(lon, lat)
    return np.stack([time, np.radians(lat), np.radians(lon), z], axis=1), np.stack([time, x, y, z], axis=1)


def test_sbet(tmp_path: Path) -> None:
    rows, true = around()
    got = read_trajectory(written(tmp_path, sbet(rows), "flight.out"), CRS)
    np.testing.assert_allclose(matrix(got), true, rtol=0, atol=1e-3)
    lifted = read_trajectory(tmp_path / "flight.out", f"{CRS}+7837", undulation=48.2)
    np.testing.assert_allclose(lifted["z"], got["z"] - 48.2)
    np.testing.assert_array_equal(lifted["x"], got["x"])


def test_sbet_in_pieces_and_one_that_is_cut_off_while_it_is_read(tmp_path: Path, monkeypatch: Any) -> None:
    rows, _ = around()
    path = written(tmp_path, sbet(rows), "flight.out")
    whole = read_trajectory(path, CRS)
    monkeypatch.setattr(trajectory, "AT_A_TIME", 7)
    for name, values in read_trajectory(path, CRS).items():
        np.testing.assert_array_equal(values, whole[name])
    calls, opened = [], trajectory.open_regular

    def cut_before_the_records(at: Path) -> Any:
        calls.append(at)
        if len(calls) == 2:
            os.truncate(at, at.stat().st_size // 2)
        return opened(at)

    monkeypatch.setattr(trajectory, "open_regular", cut_before_the_records)
    with pytest.raises(InputError, match="changed while it was read"):
        read_trajectory(path, CRS)


def test_text_in_degrees_is_the_sbet(tmp_path: Path) -> None:
    rows, true = around()
    text = "time lat lon h\n" + "\n".join(
        f"{t:.4f} {np.degrees(a):.9f} {np.degrees(b):.9f} {z:.4f}" for t, a, b, z in rows
    )
    np.testing.assert_allclose(matrix(read_trajectory(written(tmp_path, text), CRS)), true, rtol=0, atol=1e-3)


def test_sbet_across_the_end_of_a_week_runs_on(tmp_path: Path) -> None:
    rows, _ = around()
    rows[:, 0] = (GPS_WEEK - 0.5 + np.arange(len(rows)) / 200.0) % GPS_WEEK
    got = read_trajectory(written(tmp_path, sbet(rows)), CRS)
    np.testing.assert_allclose(np.diff(got["gps_time"]), 1 / 200, atol=1e-9)


@pytest.mark.parametrize("fall", [0.02, 3 * 86_400.0, GPS_WEEK + 2 * 86_400.0])
def test_sbet_whose_times_fall_back_is_refused(tmp_path: Path, fall: float) -> None:
    """It was sorted in silence, or moved by a week."""
    rows, _ = around()
    rows[:, 0] += 2 * GPS_WEEK
    rows[len(rows) // 2 :, 0] -= fall
    with pytest.raises(InputError, match="fall back"):
        read_trajectory(written(tmp_path, sbet(rows)), CRS)


@pytest.mark.parametrize(
    ("content", "crs", "match"),
    [
        (b"", CRS, "empty"),
        (sbet(around()[0])[:-1], CRS, "SBET"),
        (sbet(around()[0]), None, "CRS"),
        (sbet(around()[0]), "EPSG:4326", "metres"),
        (sbet(around()[0]), "EPSG:1", "CRS"),
        (sbet(np.degrees(around()[0])), CRS, "record 0"),
        (np.arange(17 * 9, dtype=">f8").tobytes(), CRS, "SBET"),
        (sbet(np.full((5, 4), np.nan)), CRS, "SBET"),
        (b"LASF" + bytes(300), CRS, "SBET"),
        ("gps_time,x,y,z\n", CRS, "fix"),
        ("gps_time,x,y,z\n1,2,3\n", CRS, "line"),
        ("1 2 3 4\n1 2 three 4\n", CRS, "three"),
        ("1,5;2,5;3,5;4,5\n", CRS, "no trajectory"),
        ("x,y,z\n1,2,3\n", CRS, "no trajectory"),
        ("time lat lon h\n1 2 3\n", None, "line"),
        ("time lat lon h\n1 48 9 3\n", None, "CRS"),
        ("time lat lon h\n1 5403000 512000 3\n", CRS, "degrees"),
        ("time lat lon h\n1 95 500 3\n", CRS, "degrees"),
        ("nan nan nan nan\n", CRS, "fix"),
    ],
)
def test_other_files_are_refused_in_words(content: str | bytes, crs: str | None, match: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=match):
        read_trajectory(written(tmp_path, content), crs)


@pytest.mark.parametrize("ending", [".gz", ".bz2", ".xz"])
def test_text_is_text_whatever_its_name_says(ending: str, tmp_path: Path) -> None:
    """numpy unpacks by the name; a text under `.xz` ended with a traceback."""
    found = read_trajectory(written(tmp_path, "1 2 3 4\n2 3 4 5\n", f"path{ending}"))
    np.testing.assert_array_equal(matrix(found), [[1, 2, 3, 4], [2, 3, 4, 5]])


def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.sbet"
    with path.open("wb") as file:
        file.truncate(136 * 2**32)  # sparse
    with pytest.raises(InputError, match="large"):
        read_trajectory(path, CRS)


BYTES = st.one_of(
    st.binary(max_size=600),
    st.lists(st.floats(width=64), min_size=17, max_size=17 * 4).map(lambda v: np.array(v, "<f8").tobytes()),
    st.text(alphabet="0123456789.,;-+eEnaif \t\r\n#xyz\x1c\x85\"'", max_size=200).map(lambda t: t.encode("latin-1")),
    st.text(alphabet='0123456789.,-eE \n#"', max_size=150).map(lambda t: ("gps_time,x,y,z\n" + t).encode()),
    st.text(max_size=100).map(lambda t: ("time lat lon h\n" + t).encode("utf-8", "replace")),
)


@pytest.mark.statistics
@given(content=BYTES)
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_give_a_trajectory_or_a_refusal(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "any"
    path.write_bytes(content)
    try:
        got = read_trajectory(path, CRS)
    except InputError:
        return
    assert got.rows > 0
    assert np.isfinite(matrix(got)).all()
    assert (np.diff(got["gps_time"]) > 0).all()


def test_thinned_keeps_the_path_and_the_ends_of_gaps() -> None:
    time = np.concatenate([np.arange(0, 2000), np.arange(3000, 5001)]) / 200.0
    path = Table({"gps_time": time, "x": np.sin(time), "y": 60.0 * time, "z": 0 * time})
    got = thin_trajectory(path, 0.1)
    assert 300 < got.rows < 420
    assert {0.0, 1999 / 200, 15.0, 25.0} <= set(got["gps_time"].tolist())
    at = np.interp(time, got["gps_time"], got["x"])
    assert np.abs(at - path["x"]).max() < 0.1**2 / 8 + 1e-9
    one = path.take(np.array([7]))
    np.testing.assert_array_equal(thin_trajectory(one, 1.0)["x"], one["x"])


def flown(begin: float) -> Table:
    time = begin + np.arange(0.0, 600.0)
    return Table({"gps_time": time, "x": 0 * time, "y": 0 * time, "z": 0 * time})


SECOND_OF_WEEK, WEEKS = 216_000.0, 2149
SINCE_1980 = WEEKS * GPS_WEEK + SECOND_OF_WEEK
SCALES = {"week": SECOND_OF_WEEK, "adjusted": SINCE_1980 - ADJUSTED, "1980": SINCE_1980}


@pytest.mark.parametrize("mine", SCALES)
@pytest.mark.parametrize("theirs", ["week", "adjusted"])
def test_time_scales_are_brought_together(mine: str, theirs: str) -> None:
    first = SCALES[theirs] + 100.0
    got = in_survey_time(flown(SCALES[mine]), first, first + 300.0, "flight.out")
    assert got["gps_time"][100] == first


def test_flight_across_the_end_of_a_week() -> None:
    begin = WEEKS * GPS_WEEK - 200.0
    for sow in (GPS_WEEK - 200.0,):
        for first in (begin - ADJUSTED + 20.0, begin - ADJUSTED + 300.0):
            got = in_survey_time(flown(sow), first, first + 100.0, "flight.out")
            assert got["gps_time"][0] == begin - ADJUSTED


@pytest.mark.parametrize("begin", [1.6e9, SCALES["adjusted"] + 86_400.0, SECOND_OF_WEEK + 86_400.0, -5e8])
def test_times_of_another_day_are_refused_with_both_spans(begin: float) -> None:
    first = SCALES["adjusted"] + 100.0
    with pytest.raises(InputError, match="in common") as caught:
        in_survey_time(flown(begin), first, first + 300.0, "flight.out")
    assert f"{first:.3f}" in str(caught.value)
    assert f"{begin:.3f}" in str(caught.value)


def test_seconds_of_the_week_do_not_tell_which_of_several_weeks() -> None:
    first = SCALES["adjusted"] + 100.0
    with pytest.raises(InputError, match="several weeks"):
        in_survey_time(flown(SECOND_OF_WEEK), first, first + GPS_WEEK, "flight.out")
    # adjusted standard time does
    assert in_survey_time(flown(first), first, first + GPS_WEEK, "flight.out")["gps_time"][0] == first


def test_a_survey_without_times_is_told_so() -> None:
    with pytest.raises(InputError, match="no GPS times"):
        in_survey_time(flown(0.0), np.nan, np.nan, "flight.out")
