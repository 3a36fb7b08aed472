"""Raw waveforms as Parquet and text: the true places through the command line, and words for what is wrong."""

from __future__ import annotations

import json

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from commandline import fwclass
from pyproj import CRS
from rawmaker import GROUND, HALF_LIGHT, scene, write_csv, write_parquet

from fwclass.errors import InputError
from fwclass.read.info import info
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_span

TOLD = {"crs": "EPSG:32632", "spacing_ns": "1.0"}
PARAMS = ReadParams(
    chunk_pulses=37,
    max_span_points=1000,
    missing_packets="error",
    mirror_beams=False,
    sensor_ranges=True,
    use_flagged=False,
    project_to=None,
)
WITHIN = 0.01
"""Eight standard errors of a place at these heights over noise of 1 DN: 1.3 mm."""


def echoes(path, *words):
    out = path.with_name("out.laz")
    ended = fwclass("decompose", path, out, "--overwrite", *words)
    assert ended.returncode == 0, ended.stderr
    las = laspy.read(out)
    return las, np.stack([las.x, las.y, las.z], axis=1), ended.stdout + ended.stderr


def off(las, places, truth):
    """Distance of every echo from the true place of its pulse."""
    row = np.searchsorted(truth.time, np.asarray(las.gps_time) - 2e-6)
    return np.linalg.norm(places - truth.place[row], axis=1)


@pytest.mark.parametrize(
    ("write", "ending", "per", "at", "tilt", "spacing"),
    [
        (write_parquet, "parquet", "ns", "first", 0.0, 1.0),
        (write_parquet, "parquet", "sample", "sensor", 20.0, 2.0),
        (write_csv, "csv", "unit", "sensor", 20.0, 1.0),
        (write_csv, "txt", "ns", "first", 0.0, 1.0),
    ],
)
def test_places_are_true(tmp_path, write, ending, per, at, tilt, spacing):
    truth = scene(pulses=400, tilt=tilt, spacing=spacing)
    path = write(tmp_path / f"a.{ending}", truth.columns(per, at), TOLD | {"spacing_ns": str(spacing)})
    las, places, _ = echoes(path)
    away = off(las, places, truth)
    assert np.quantile(away, 0.99) < WITHIN * spacing and len(las.x) >= 400
    assert las.header.parse_crs().to_epsg() == 32632
    if at == "sensor":  # the format knows the range
        wanted = np.linalg.norm(truth.place - truth.origin, axis=1)
        assert abs(np.median(las["range"]) - np.median(wanted)) < 0.05


def test_floats_become_counts_that_change_nothing(tmp_path):
    """Volts below zero and far from whole: the same places, heights in steps that are told."""
    truth, volts = scene(pulses=300), scene(pulses=300, scale=1e-5)
    table = volts.columns()
    table["samples"] = [row - 4e-4 for row in table["samples"]]
    las, places, _ = echoes(write_parquet(tmp_path / "v.parquet", table, TOLD))
    assert np.quantile(off(las, places, truth), 0.99) < WITHIN
    found = json.loads(fwclass("info", tmp_path / "v.parquet", "--json").stdout)
    assert dict(map(tuple, found["notes"]))["samples"].startswith("counted in steps of")


@pytest.mark.parametrize("own", [False, True])
def test_two_channels_and_segments(tmp_path, own):
    """Rows of one pulse: of two channels the first counts, a second segment is added where it lies, whether its time
    counts from the first one's place or from its `own`."""
    truth, second = scene(pulses=300), scene(pulses=300, seed=9)
    a, later = truth.columns(), {}
    apart = 200.0
    shifted = second.first + (apart * HALF_LIGHT) * second.away
    later = second.columns() | dict(zip("xyz", shifted.T, strict=True))
    b = second.columns()
    parts = [
        a | {"pulse": np.arange(300), "channel": np.zeros(300)},
        b | {"pulse": np.arange(300), "channel": np.ones(300)},
        later | {"pulse": np.arange(300), "channel": np.zeros(300), "begin_ns": np.full(300, apart)},
    ]
    parts[2] |= {"begin_ns": np.zeros(300)} if own else dict(zip("xyz", second.first.T, strict=True))
    order = np.lexsort((np.repeat([0, 1, 2], 300), np.tile(np.arange(300), 3)))
    table = {
        n: np.concatenate([p.get(n, np.zeros(300)) for p in parts])[order]
        for n in ("begin_ns", *parts[0])
        if n != "samples"
    }
    rows = [row for p in parts for row in p["samples"]]
    las, places, said = echoes(
        write_parquet(tmp_path / "a.parquet", table | {"samples": [rows[k] for k in order]}, TOLD)
    )
    assert "second channel" in said and ": 300" in said and "left out: 300" in said and "before them" not in said
    near = off(las, places, truth)
    below = np.abs(near - apart * HALF_LIGHT) < 0.05
    assert (near < WITHIN).sum() >= 298 and below.sum() >= 298
    assert set(np.asarray(las.number_of_returns)[below]) <= {2, 3}


def test_channels_of_their_own_pulses_are_all_read(tmp_path):
    truth = scene(pulses=300)
    las, places, _ = echoes(
        write_parquet(tmp_path / "a.parquet", truth.columns() | {"channel": np.arange(300) % 2}, TOLD)
    )
    assert len(las.x) >= 300 and np.quantile(off(las, places, truth), 0.99) < WITHIN


@pytest.mark.parametrize("chunk", [1, 7, 400])
@pytest.mark.parametrize("write", [write_parquet, write_csv])
def test_spans_are_the_file(tmp_path, write, chunk):
    """However it is cut, the samples are those that were written, in their order."""
    truth = scene(pulses=60)
    more = {"row_group_size": 13} if write is write_parquet else {}
    path = write(tmp_path / ("a.parquet" if more else "a.csv"), truth.columns(), TOLD, **more)
    params = PARAMS.model_copy(update={"chunk_pulses": chunk})
    source = open_source(path)
    parts = [read_span(source, span, params) for span in index_source(source, params)]
    assert np.array_equal(np.concatenate([p.samples for p in parts]), truth.samples.reshape(-1))
    assert np.array_equal(np.concatenate([p.pulses["pulse"] for p in parts]), np.arange(60))
    assert np.allclose(np.concatenate([p.pulses["anchor_x"] for p in parts]), truth.first[:, 0], atol=1e-9)


def test_outgoing_pulses(tmp_path):
    truth = scene(pulses=50)
    wave = np.array([0, 3, 60, 120, 60, 3, 0], np.uint16)
    more = {"outgoing": [wave] * 49 + [wave[:0]], "outgoing_begin_ns": np.full(50, -3.0)}
    source = open_source(write_parquet(tmp_path / "a.parquet", truth.columns("ns", "sensor") | more, TOLD))
    (span,) = index_source(source, PARAMS.model_copy(update={"chunk_pulses": 100}))
    waves = read_span(source, span, PARAMS)
    assert np.array_equal(waves.outgoing, np.tile(wave, 49)) and list(np.diff(waves.outgoing_offsets)) == [7] * 49 + [0]
    assert (waves.pulses["outgoing_start"][:49] == -3.0).all() and np.isnan(waves.pulses["outgoing_start"][49])


def test_info(tmp_path):
    path = write_csv(tmp_path / "a.csv", scene(pulses=100).columns(), TOLD, ";")
    said = fwclass("info", path).stdout
    assert "raw waveforms, text" in said and "metres per nanosecond" in said and "no faults found" in said
    found = json.loads(fwclass("info", path, "--json").stdout)
    assert found["pulses"] == 100 and found["crs"]["epsg"] == 32632 and abs(found["bounds"][2] - GROUND) < 30
    shown = fwclass("info", "--waveforms", path, "--out", tmp_path / "a.png")
    assert shown.returncode == 0 and (tmp_path / "a.png").is_file()


def test_bad_rows_are_left_out_and_counted(tmp_path):
    table = scene(pulses=200).columns()
    table["spacing_ns"] = np.where(np.arange(200) == 3, np.nan, 1.0)
    table["x"][7], table["dz"][9] = np.nan, -3.0
    table["samples"][11] = table["samples"][11][:0]
    las, _, said = echoes(write_parquet(tmp_path / "a.parquet", table, TOLD))
    assert len(set(np.asarray(las.gps_time))) == 196
    for words in ("sample spacing", "finite place", "beam vector", "no samples"):
        assert words in said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: {k: v for k, v in t.items() if k != "dy"}, "no dy"),
        (lambda t: t | {"spacing_ns": np.full(90, 1000.0)}, "means nothing|no waveform of the file"),
        (lambda t: t | {"spacing_ns": np.full(90, np.nan)}, "no waveform of the file"),
        (lambda t: t | {"dx": t["dx"] * 1e3, "dy": t["dy"] * 1e3, "dz": t["dz"] * 1e3}, "means nothing"),
        (lambda t: t | {"z": t["z"] / 0.3048, "dz": t["dz"] / 0.3048}, "feet"),
        (lambda t: t | {"dx": -t["dx"], "dy": -t["dy"], "dz": -t["dz"]}, "point down"),
        (lambda t: t | {"pulse": np.arange(90) % 30}, "do not follow"),
        (lambda t: t | {"pulse": np.arange(90) * 0.5}, "pulse has no whole number"),
        (lambda t: t | {"pulse": 2.0**60 + np.arange(90) * 1024}, "pulse has no whole number"),
        (lambda t: t | {"pulse": np.where(np.arange(90) < 3, np.nan, np.arange(90))}, "pulse has no whole number"),
        (lambda t: t | {"channel": np.full(90, 3.7)}, "channel has no whole number"),
        (lambda t: t | {n: t[n] * 1e-5 for n in ("x", "y", "dx", "dy")}, "degrees"),
        (lambda t: {k: v[:0] for k, v in t.items()}, "nothing to decompose"),
    ],
)
@pytest.mark.parametrize("write", [write_parquet, write_csv])
def test_refused_in_words(tmp_path, write, change, words):
    told = TOLD if "degrees" not in words else {"spacing_ns": "1.0"}
    path = write(
        tmp_path / ("a.parquet" if write is write_parquet else "a.csv"), change(scene(pulses=90).columns()), told
    )
    ended = fwclass("decompose", path, tmp_path / "o.laz")
    assert ended.returncode == 1, ended.stderr
    assert any(w in ended.stderr for w in words.split("|")), ended.stderr
    assert fwclass("info", path).returncode in (0, 1)


@pytest.mark.parametrize(
    ("column", "cell"),
    [("x", "512_000"), ("x", "\u0665\u0661\u0662"), ("samples", "1_2 13 14"), ("samples", '"12,5 13,5 14,5"')],
)
def test_words_that_python_alone_takes_for_numbers_are_refused(tmp_path, column, cell):
    """1_2 was taken for 12, and samples with decimal commas for two each."""
    path = write_csv(tmp_path / "a.csv", scene(pulses=9).columns(), TOLD)
    lines = path.read_text().splitlines()
    heading = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    words = lines[heading + 4].split(",")
    words[lines[heading].split(",").index(column)] = cell
    path.write_text("\n".join([*lines[: heading + 4], ",".join(words), *lines[heading + 5 :]]) + "\n")
    with pytest.raises(InputError, match="no number") as fault:
        open_source(path)
    assert "row 4" in str(fault.value)


@pytest.mark.parametrize("cell", ["[12, 13, 14]", "12,13,14", "(12;13;14)", "12 13 14.5"])
def test_lists_are_written_as_people_write_them(tmp_path, cell):
    path = write_csv(tmp_path / "a.csv", scene(pulses=9).columns(), TOLD)
    lines = path.read_text().splitlines()
    lines[-1] = ",".join([*lines[-1].split(",")[:-1], f'"{cell}"'])
    path.write_text("\n".join(lines) + "\n")
    assert open_source(path).census.rows == 9


@pytest.mark.parametrize(
    "told",
    [
        {"spacing_ns": "1", "standard_gps_time": "maybe"},
        {"spacing_ns": "fast"},
        {"spacing_ns": "1e9"},
        {"spacing_ns": "1", "crs": "EPSG:1"},
    ],
)
def test_bad_metadata(tmp_path, told):
    path = write_parquet(tmp_path / "a.parquet", scene(pulses=9).columns(), told)
    with pytest.raises(InputError, match=r"metadata|coordinate system"):
        open_source(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_cut_short(tmp_path, share):
    """A Parquet file has its foot at the end; a text loses rows, and its last one is told."""
    path = write_parquet(tmp_path / "a.parquet", scene(pulses=90).columns(), TOLD)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    assert fwclass("decompose", path, tmp_path / "o.laz").returncode == 1
    text = write_csv(tmp_path / "a.csv", scene(pulses=90).columns(), TOLD)
    data = text.read_bytes()
    cut = data.index(b"\n", int(0.5 * len(data))) + 30
    text.write_bytes(data[:cut])
    ended = fwclass("decompose", text, tmp_path / "o.laz")
    assert ended.returncode == 1 and "number of columns" in ended.stderr


@pytest.mark.parametrize("cell", ["1 2 x", "nan nan", ""])
def test_bad_samples_of_a_text(tmp_path, cell):
    path = write_csv(tmp_path / "a.csv", scene(pulses=20).columns(), TOLD)
    lines = path.read_text().splitlines()
    lines[5] = ",".join([*lines[5].split(",")[:-1], cell])
    path.write_text("\n".join(lines))
    if cell == "1 2 x":
        with pytest.raises(InputError, match="no number"):
            open_source(path)
        return
    source = open_source(path)
    check_source(source, PARAMS)
    assert source.census.faults[0] == 19


def test_a_long_cell_is_read_and_a_quote_without_end_refused(tmp_path):
    """csv takes 131 072 letters if nobody asks for more: longer waveforms ended with a traceback."""
    path = write_csv(tmp_path / "a.csv", scene(pulses=20).columns(), TOLD)
    lines = path.read_text().splitlines()
    lines[5] = ",".join([*lines[5].split(",")[:-1], "10 " * 50_000])
    path.write_text("\n".join(lines))
    assert open_source(path).census.faults[0] == 20
    lines[5] = ",".join([*lines[5].split(",")[:-1], '"' + "10 " * 50_000])
    path.write_text("\n".join([*lines[:6], *lines[6:] * 80]))
    with pytest.raises(InputError, match="row"):
        open_source(path)


def test_samples_that_are_nearly_all_equal_are_refused_by_their_number(tmp_path):
    """Zeros pack to nothing: 144 kB of 100 million took 2.7 GB and 54 s. Half of that, uncompressed, is read."""
    columns = scene(pulses=30).columns()
    columns["samples"] = [np.zeros(100_000, np.uint8)] * 30
    write_parquet(tmp_path / "a.parquet", columns, TOLD)
    with pytest.raises(InputError, match="counts more than it can hold"):
        open_source(tmp_path / "a.parquet")
    table = pq.read_table(tmp_path / "a.parquet")
    pq.write_table(table, tmp_path / "b.parquet", compression="none", use_dictionary=False)
    assert index_source(open_source(tmp_path / "b.parquet"), PARAMS)


def test_one_pulse(tmp_path):
    las, places, _ = echoes(write_parquet(tmp_path / "a.parquet", scene(pulses=1).columns(), TOLD))
    assert len(las.x) == 1 and np.linalg.norm(places - scene(pulses=1).place) < 0.05


def test_places_in_feet_are_refused(tmp_path):
    path = write_csv(tmp_path / "a.csv", scene().columns(), {"crs": "EPSG:2277", "spacing_ns": "1.0"})
    with pytest.raises(InputError, match="not in metres"):
        check_source(open_source(path), PARAMS)


def test_beams_that_run_up_are_refused_and_told(tmp_path):
    columns = scene().columns()
    columns |= {name: -columns[name] for name in ("dx", "dy", "dz")}
    rng = np.random.default_rng(4)  # places that no sensor had: the beams meet nowhere, whatever their sign
    columns |= {name: columns[name] + rng.uniform(-300.0, 300.0, len(columns[name])) for name in ("x", "y")}
    path = write_csv(tmp_path / "a.csv", columns, {"crs": "EPSG:32632", "spacing_ns": "1.0"})
    with pytest.raises(InputError, match="run up"):
        check_source(open_source(path), PARAMS)
    assert any("run up" in fault for fault in info(path)["faults"])


def test_rows_that_cannot_be_used_end_with_exit_code_4(tmp_path):
    columns = scene(pulses=600).columns()
    columns["x"][:200] = np.nan
    path = write_csv(tmp_path / "a.csv", columns, {"crs": "EPSG:32632", "spacing_ns": "1.0"})
    ended = fwclass("decompose", path, tmp_path / "o.laz")
    assert ended.returncode == 4, ended.stderr
    assert "200 of 600 pulses (33.3 %)" in ended.stderr + ended.stdout
    assert "200, 33.3 %" in ended.stderr
    assert (tmp_path / "o.laz").exists()
    assert fwclass("decompose", path, tmp_path / "p.laz", "--accept-implausible").returncode == 0


def test_a_code_of_another_system_beside_the_words_is_told(tmp_path):
    text = CRS.from_epsg(32632).to_wkt().replace("32632", "32633")
    path = write_parquet(tmp_path / "a.parquet", scene().columns(), TOLD | {"crs": text})
    faults = json.loads(fwclass("info", path, "--json").stdout)["faults"]
    assert any("zone 32N by its words and WGS 84 / UTM zone 33N by EPSG:32633" in fault for fault in faults)
