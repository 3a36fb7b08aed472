"""`fwclass ground`, `normalize` and `assess --ground` as a user meets them."""

import json
import sys

import laspy
import numpy as np
import pytest
import rasterio
from lasmaker import Descriptor, write_las
from pyproj import CRS
from tolerances import FLOAT32_HEIGHT

from fwclass.cli import main

HOUSE = (20.0, 20.0, 32.0, 32.0)
FOOT = 1200.0 / 3937.0


def scene(n=6000, seed=0):
    """A slope of 5 % with a flat roof 6 m above it and one point 300 m below: x, y, z, is ground."""
    r = np.random.default_rng(seed)
    x, y = np.round(r.uniform(0, 60, (2, n)), 2)
    roof = (x > HOUSE[0]) & (x < HOUSE[2]) & (y > HOUSE[1]) & (y < HOUSE[3])
    z = np.round(100 + 0.05 * x + np.where(roof, 6.0, 0.0), 2)
    z[0] = -200.0
    ground = ~roof
    ground[0] = False
    return np.column_stack([x + 500_000, y + 5_400_000, z]), ground


@pytest.fixture
def fwclass(monkeypatch, capsys):
    """Runs a command in this process: (exit code, standard output, standard error)."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["fwclass", *map(str, words)])
        code = 0
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        told = capsys.readouterr()
        assert "Traceback" not in told.out + told.err
        return code, told.out, told.err

    return run


def las(path, xyz, classification=1, **fields):
    return write_las(path, xyz, point_format=6, scale=0.01, classification=classification, **fields)


def text(path, xyz, *columns):
    np.savetxt(path, np.column_stack([xyz, *columns]), fmt=["%.2f"] * 3 + ["%d"] * len(columns))
    return path


def test_las_to_laz_to_las_keeps_everything_but_the_class(tmp_path, fwclass):
    xyz, ground = scene()
    r = np.random.default_rng(1)
    came = r.choice([0, 3, 6], len(xyz))
    source = las(tmp_path / "a.las", xyz, came, intensity=r.integers(0, 999, len(xyz)), gps_time=np.arange(len(xyz)))
    code, out, err = fwclass("ground", source, tmp_path / "b.laz", "--json")
    assert code == 0
    made = json.loads(out)
    assert made["points"] == len(xyz) and made["noise"] >= 1 and made["method"] == "smrf"
    for words in ("6,000", "smrf", "threshold 0.5", "seconds", "b.laz"):
        assert words in err
    assert fwclass("ground", tmp_path / "b.laz", tmp_path / "c.las")[0] == 0
    old, packed, plain = (laspy.read(tmp_path / n) for n in ("a.las", "b.laz", "c.las"))
    assert packed.header.are_points_compressed and not plain.header.are_points_compressed
    for new in (packed, plain):
        for name in old.point_format.dimension_names:
            if name != "classification":
                np.testing.assert_array_equal(new[name], old[name])
        assert (np.asarray(new.classification) == 2).sum() == made["ground"]
        assert new.classification[0] == 7
        assert ((np.asarray(new.classification) == 2) == ground).mean() > 0.99
    assert set(np.unique(packed.classification)) == {1, 2, 7}


def test_kept_classes_and_flags_stay_out_of_the_filter(tmp_path, fwclass):
    xyz, _ = scene()
    came = np.full(len(xyz), 5)
    came[:100] = 2
    came[0], came[1], came[2] = 18, 7, 7
    source = las(tmp_path / "a.las", xyz, came)
    with laspy.open(source) as file:
        points = file.read()
    withheld = np.zeros(len(xyz), bool)
    withheld[50] = True
    points.withheld = withheld
    points.write(tmp_path / "b.las")
    code, out, err = fwclass("ground", tmp_path / "b.las", tmp_path / "o.laz", "--keep-classes", "--json")
    assert code == 0 and "left out" in err
    made = json.loads(out)
    assert made["left_out"] == 4 and made["shown"] == len(xyz) - 4
    new = np.asarray(laspy.read(tmp_path / "o.laz").classification)
    assert new[:3].tolist() == [18, 7, 7] and new[50] == 1
    assert set(np.unique(new)) <= {1, 2, 5, 7, 18}
    assert ((new == 5) <= (came == 5)).all() and ((new == 1) <= (came == 2)).all()


def test_text_in_and_out_in_its_order(tmp_path, fwclass):
    xyz, ground = scene()
    source = text(tmp_path / "a.txt", xyz, ~ground)
    lines = source.read_text().splitlines()
    lines.insert(7, "nan 5 5 0")
    source.write_text("\n".join(lines) + "\n")
    code, _, err = fwclass("ground", source, tmp_path / "b.csv")
    assert code == 0 and "1 not finite: kept, never ground" in err and "metres are assumed" in err
    head, *rows = (tmp_path / "b.csv").read_text().splitlines()
    assert head == "x,y,z,classification" and len(rows) == len(lines) and rows[7] == "nan,5,5,1"
    back = np.array([row.split(",")[:3] for row in rows if not row.startswith("nan")], float)
    np.testing.assert_array_equal(back, xyz)
    code, out, _ = fwclass("assess", source, tmp_path / "b.csv", "--ground", "--json")
    told = json.loads(out)
    assert told["classes"] == ["ground", "other"] and told["matched"] == len(lines)
    assert told["total_error"] < 0.01 and told["kappa"] > 0.95
    code, _, err = fwclass("ground", source, tmp_path / "b.laz")
    assert code == 1 and "cannot be written to a LAS file" in err and not (tmp_path / "b.laz").exists()


def test_text_to_las_carries_its_crs(tmp_path, fwclass):
    xyz, _ = scene(2000)
    source = text(tmp_path / "a.xyz", xyz)
    for name in ("b.las", "b.laz"):
        assert fwclass("ground", source, tmp_path / name, "--crs", "EPSG:25832")[0] == 0
        new = laspy.read(tmp_path / name)
        np.testing.assert_allclose(np.column_stack([new.x, new.y, new.z]), xyz, atol=1e-9)
        assert new.header.parse_crs().to_epsg() == 25832
        assert (np.asarray(new.classification) == 2).any()


def test_feet_give_the_same_ground_as_metres(tmp_path, fwclass):
    xyz, _ = scene(3000)
    metres = CRS.from_epsg(25832).to_wkt("WKT1_GDAL")
    mixed = CRS.from_user_input("EPSG:25832+6360").to_wkt("WKT1_GDAL")
    feet = CRS.from_user_input("EPSG:2263+6360").to_wkt("WKT1_GDAL")
    found = {}
    for name, wkt, factors in (
        ("metres", metres, (1, 1, 1)),
        ("mixed", mixed, (1, 1, FOOT)),
        ("feet", feet, (FOOT, FOOT, FOOT)),
    ):
        write_las(tmp_path / f"{name}.las", xyz / factors, point_format=6, scale=0.0001, keys=None, wkt=wkt)
        rasters = ("--dtm", tmp_path / f"{name}.tif") if name != "mixed" else ()
        line = ("ground", tmp_path / f"{name}.las", tmp_path / f"{name}.laz", "--json", *rasters)
        code, _out, err = fwclass(*line, *(["--accept-implausible"] if name == "feet" else []))  # far from New York
        assert code == 0
        assert ("works in metres" in err) == (name != "metres")
        found[name] = np.asarray(laspy.read(tmp_path / f"{name}.laz").classification)
    np.testing.assert_array_equal(found["mixed"], found["metres"])
    np.testing.assert_array_equal(found["feet"], found["metres"])
    with rasterio.open(tmp_path / "metres.tif") as a, rasterio.open(tmp_path / "feet.tif") as b:
        np.testing.assert_allclose(b.read(1) * FOOT, a.read(1), atol=FLOAT32_HEIGHT)
        np.testing.assert_allclose(np.array(b.bounds) * FOOT, a.bounds, rtol=1e-12)
    code, _, err = fwclass("normalize", tmp_path / "feet.laz", tmp_path / "n.las")
    heights = np.asarray(laspy.read(tmp_path / "n.las").z) * FOOT
    roof = found["metres"] == 1
    assert np.median(heights[roof]) == pytest.approx(6.0, abs=0.2)


@pytest.mark.parametrize(("code", "east", "north"), [("EPSG:2229", 6_480_000, 1_840_000), ("EPSG:2263+6360", 9e5, 2e5)])
def test_a_file_in_feet_lies_where_its_system_is(tmp_path, fwclass, code, east, north):
    """Metres were taken for feet: sound files ended with exit code 4."""
    xyz = (scene(2000)[0] - scene(2000)[0].min(axis=0)) / FOOT + [east, north, 300]
    wkt = CRS.from_user_input(code).to_wkt("WKT1_GDAL")
    source = write_las(tmp_path / "a.las", xyz, point_format=6, scale=0.001, keys=None, wkt=wkt)
    for name, given in (("ground", source), ("normalize", tmp_path / "ground.laz")):
        code, _, err = fwclass(name, given, tmp_path / f"{name}.laz")
        assert code == 0 and "used from" not in err, err


def test_degrees_are_refused(tmp_path, fwclass):
    xyz, _ = scene(100)
    source = write_las(tmp_path / "a.las", xyz, point_format=6, keys=None, wkt=CRS.from_epsg(4979).to_wkt())
    code, _, err = fwclass("ground", source, tmp_path / "b.laz")
    assert code == 1 and "in degrees" in err and "reproject" in err and not (tmp_path / "b.laz").exists()
    code, _, err = fwclass("ground", text(tmp_path / "a.txt", xyz), tmp_path / "b.laz", "--crs", "EPSG:4326")
    assert code == 1 and "in degrees" in err
    r = np.random.default_rng(0)
    np.savetxt(
        tmp_path / "d.txt", np.column_stack([r.uniform(9.1, 9.2, 200), r.uniform(48.1, 48.2, 200), np.ones(200)])
    )
    code, _, err = fwclass("ground", tmp_path / "d.txt", tmp_path / "d.csv")
    assert code == 4 and "look like degrees" in err and (tmp_path / "d.csv").is_file()


def test_a_file_without_ground_ends_with_4_when_it_is_written(tmp_path, fwclass):
    rough = np.random.default_rng(1).uniform(0.0, 30.0, (800, 3)) * [1.0, 1.0, 0.02]
    line = ("ground", text(tmp_path / "a.txt", rough), "--param", "threshold=0", "--param", "scalar=0")
    code, _, err = fwclass(*line, tmp_path / "b.txt")
    assert code == 4 and "no echo is ground" in err and "got: 0 of " in err and (tmp_path / "b.txt").is_file(), err
    assert fwclass(*line, tmp_path / "c.txt", "--accept-implausible")[0] == 0


def test_a_given_ground_that_others_lie_below_is_told(tmp_path, fwclass):
    """Codes of ground and plants were exchanged: heights of -2.84 m in the median, exit code 0."""
    rng = np.random.default_rng(2)
    plant = rng.random(4000) < 0.4
    xyz = np.column_stack([rng.uniform(0.0, 80.0, (4000, 2)), np.where(plant, rng.uniform(0.5, 8.0, 4000), 0.0)])
    xyz += [500_000.0, 5_400_000.0, 200.0]
    commands = {
        "normalize": (tmp_path / "n.las",),
        "features": (tmp_path / "f.parquet", "--features", "height_above_ground", "--own-ground"),
    }
    for exchanged in (False, True):
        codes = np.where(plant != exchanged, 5, 2)
        source = write_las(tmp_path / "a.las", xyz, point_format=6, keys=None, classification=codes)
        for command, (output, *more) in commands.items():
            code, _, err = fwclass(command, source, output, *more, "--overwrite")
            assert code == (4 if exchanged else 0) and output.is_file(), err
            assert ("lie more than 1 m below what the file calls ground" in err) == exchanged
            if exchanged:
                assert fwclass(command, source, output, *more, "--overwrite", "--accept-implausible")[0] == 0


def test_longitudes_without_a_system_are_refused_at_once_and_told_by_info(tmp_path, fwclass):
    """They were taken for metres, all of them in one cell: the filter looked at every pair."""
    r = np.random.default_rng(0)
    n = 40_000
    xyz = np.column_stack([r.uniform(5.99, 5.993, n), r.uniform(45.11, 45.113, n), r.normal(500, 1, n)])
    source = write_las(tmp_path / "a.las", xyz, point_format=6, keys=None, scale=1e-6)
    code, _, err = fwclass("ground", source, tmp_path / "b.laz")
    assert code == 1 and "look like degrees" in err and "a.las" in err and not (tmp_path / "b.laz").exists()
    code, out, _ = fwclass("info", source)
    assert "look like degrees" in out
    code, _, err = fwclass("ground", source, tmp_path / "c.laz", "--crs", "EPSG:25832")
    assert code == 1 and "look like degrees" in err and "transforms nothing" in err


def test_waveform_packets_survive(tmp_path, fwclass):
    xyz, _ = scene(500)
    waves = [np.full(20, 10 + i % 90) for i in range(len(xyz))]
    for where in ("external", "internal"):
        source = write_las(
            tmp_path / f"{where}.las",
            xyz,
            point_format=9,
            scale=0.01,
            waveforms=waves,
            where=where,
            descriptors={1: Descriptor(n_samples=20)},
        )
        out = tmp_path / f"out-{where}.laz"
        code, said, _ = fwclass("ground", source, out, "--json")
        assert code == 0 and json.loads(said)["waveforms"] == str(out.with_suffix(".wdp"))
        old, new = laspy.read(source), laspy.read(out)
        for name in ("wavepacket_index", "wavepacket_offset", "wavepacket_size", "return_point_wave_location", "x_t"):
            np.testing.assert_array_equal(new[name], old[name])
        packets = out.with_suffix(".wdp").read_bytes()[60:]
        assert packets == b"".join(w.astype("u1").tobytes() for w in waves)
        (tmp_path / "other.wdp").write_bytes(b"mine")
        code, _, err = fwclass("ground", source, tmp_path / "other.laz")
        assert code == 2 and "would replace a file" in err
        assert (tmp_path / "other.wdp").read_bytes() == b"mine"
    beside, own = tmp_path / "external.wdp", (tmp_path / "external.wdp").stat()
    code, said, err = fwclass("ground", beside.with_suffix(".las"), beside.with_suffix(".laz"), "--json", "--overwrite")
    assert code == 0 and json.loads(said)["waveforms"] == str(beside), err
    assert (beside.stat().st_ino, beside.stat().st_mtime_ns) == (own.st_ino, own.st_mtime_ns), "it is the source's own"


def test_parameters_by_name(tmp_path, fwclass):
    source = text(tmp_path / "a.txt", scene(500)[0])
    out = tmp_path / "b.txt"

    def asked(*words):
        return fwclass("ground", source, out, "--overwrite", "--json", *words)

    code, told, _ = asked("--preset", "town", "--param", "slope=0.3")
    made = json.loads(told)
    assert made["parameters"]["slope"] == 0.3 and made["parameters"]["window"] == 12.5 and made["preset"] == "town"
    _, told, _ = asked("--preset", "town", "--set", "ground.max_building_size=40", "--param", "max_building_size=8")
    assert json.loads(told)["parameters"]["window"] == 4.0
    code, _, err = asked("--param", "slop=0.3")
    assert code == 2 and "smrf has no parameter 'slop'" in err and "did you mean 'slope'" in err and "scalar" in err
    code, _, err = asked("--param", "slope=steep")
    assert code == 2 and "smrf.slope: a number" in err and "slope=steep" in err and "what to do:" in err
    code, _, err = asked("--param", "window=-5")
    assert code == 2 and "smrf.window: more than 0" in err and "Input should" not in err
    for words in (("--param", "window=10000"), ("--method", "slope", "--param", "radius=1e6")):
        code, _, err = asked(*words)
        assert code == 2 and "m around a block, more than 1,000 m" in err and "where: --param" in err
    code, _, err = asked("--preset", "citi")
    assert code == 2 and "did you mean 'city'" in err
    code, _, err = asked("--preset", "hills")
    assert code == 2 and err.count("dense-forest") == 1 and "choose one of these" in err
    code, _, err = asked("--set", "train.trees=3")
    assert code == 2 and "no effect here" in err
    assert asked("--method", "magic")[0] == 2


def test_measured_parameters_and_what_a_user_gives_before_them(tmp_path, fwclass):
    source = text(tmp_path / "a.txt", scene()[0])
    code, out, err = fwclass("ground", source, tmp_path / "b.txt", "--auto", "--method", "smrf", "--json")
    made = json.loads(out)
    assert code == 0 and made["measured"]["points"] == 6000 and "density" in err
    words = ("--auto", "--method", "smrf", "--param", "slope=0.77", "--overwrite", "--json")
    _, out, _ = fwclass("ground", source, tmp_path / "b.txt", *words)
    given = json.loads(out)["parameters"]
    assert given["slope"] == 0.77 and given["threshold"] == made["parameters"]["threshold"]


def test_what_belongs_to_studies_only(tmp_path, fwclass):
    source = text(tmp_path / "a.txt", scene(300)[0])
    for words, told in (
        ((), "Missing argument 'OUT'"),
        (("o.txt", "--reference", source), "belong to --optimize"),
        (("o.txt", "--optimize"), "OUT has no place"),
        (("--optimize", "--compare", "all"), "two commands"),
        (("--optimize", "--keep-classes"), "--keep-classes has no place"),
        (("--compare", "smrf,pmf", "--param", "slope=1"), "--set"),
        (("--optimize", "--auto"), "one of them"),
    ):
        code, _, err = fwclass("ground", source, *words)
        assert code == 2 and told in err, err


def test_filters_side_by_side(tmp_path, fwclass):
    xyz, ground = scene(2000)
    source = text(tmp_path / "a.txt", xyz, ~ground)
    code, out, err = fwclass("ground", source, "--compare", "smrf,pmf", "--out", tmp_path / "c", "--json")
    assert code == 0 and (tmp_path / "c" / "comparison.html").stat().st_size > 0
    assert json.loads(out)["methods"] == ["smrf", "pmf"] and "agree" in err


def test_outputs_that_cannot_be(tmp_path, fwclass):
    source = las(tmp_path / "a.las", scene(200)[0])
    before = source.read_bytes()
    for words, told in (
        ((source,), "onto itself"),
        ((tmp_path / "b.ply",), "kind of the output is unknown"),
        ((tmp_path / "b",), "no suffix"),
        ((tmp_path / "b.copc.laz",), "no COPC"),
        ((tmp_path / "no" / "b.laz",), "does not exist"),
        ((tmp_path / "b.laz", "--dtm", tmp_path / "b.png"), "ends in .tif"),
        ((tmp_path / "b.laz", "--dtm", tmp_path / "c.tif", "--dsm", tmp_path / "c.tif"), "same name"),
    ):
        code, _, err = fwclass("ground", source, *words)
        assert code == 2 and told in err and "where:" in err
    assert source.read_bytes() == before
    assert fwclass("ground", source, tmp_path / "b.laz")[0] == 0
    made = (tmp_path / "b.laz").read_bytes()
    code, _, err = fwclass("ground", source, tmp_path / "b.laz")
    assert code == 2 and "--overwrite" in err and (tmp_path / "b.laz").read_bytes() == made


def test_inputs_that_cannot_be(tmp_path, fwclass):
    xyz, _ = scene(200)
    out = tmp_path / "o.laz"
    (tmp_path / "short.txt").write_text("1 2 3\n1 2\n")
    (tmp_path / "binary.txt").write_bytes(bytes(range(256)))
    (tmp_path / "empty.las").write_bytes(b"")
    (tmp_path / "points.ply").write_text("ply\n")
    text(tmp_path / "huge.txt", xyz * 1e9)
    las(tmp_path / "none.las", np.empty((0, 3)))
    las(tmp_path / "first.las", xyz, return_number=1, number_of_returns=2)
    for name, told in (
        ("short.txt", "line 2"),
        ("binary.txt", "no text"),
        ("empty.las", "empty"),
        ("huge.txt", "no point has usable coordinates"),
        ("none.las", "no points"),
        ("missing.las", "no such file"),
        ("first.las", "last_returns=false"),
    ):
        code, _, err = fwclass("ground", tmp_path / name, out)
        assert code == 1 and told in err and name in err and "what to do:" in err, err
        assert not out.exists()
    code, _, err = fwclass("ground", tmp_path / "points.ply", out)
    assert code == 2 and "kind of the file" in err and ".las, .laz" in err
    assert fwclass("ground", tmp_path / "first.las", out, "--param", "last_returns=false")[0] == 0
    points = laspy.read(las(tmp_path / "all.las", xyz))
    points.withheld = np.ones(len(xyz), bool)
    points.write(tmp_path / "withheld.las")
    code, _, err = fwclass("ground", tmp_path / "withheld.las", tmp_path / "w.laz")
    assert code == 1 and "add --use-flagged" in err and "leave out --keep-classes" not in err


def test_awkward_clouds_are_handled(tmp_path, fwclass):
    for name, xyz in (
        ("one", [[5, 5, 5]]),
        ("two", [[5, 5, 5], [6, 6, 6]]),
        ("same", [[5, 5, 5]] * 50),
        ("wall", [[5, 5, z] for z in range(40)]),
        ("line", [[x, 5, 5] for x in range(40)]),
        ("sparse", [[10 * x, 10 * y, 0] for x in range(9) for y in range(9)]),
        ("far", [[x, y, 0] for x in range(9) for y in range(9)] + [[9e7, 9e7, 5]]),
    ):
        code, out, _ = fwclass(
            "ground", text(tmp_path / f"{name}.txt", np.array(xyz, float)), tmp_path / "o.txt", "--overwrite", "--json"
        )
        made = json.loads(out)
        assert code == 0 and made["points"] == len(xyz)
        assert any("same height" in note for note in made["notes"]) == (name in ("one", "same", "line", "sparse"))


def test_a_stray_point_is_told_and_spoils_nothing(tmp_path, fwclass):
    xyz = np.vstack([scene(2000)[0], [[1_500_000.0, 5_500_000.0, 100.0]]])
    source = las(tmp_path / "a.las", xyz)
    code, _, err = fwclass("ground", source, tmp_path / "o.laz", "--dtm", tmp_path / "d.tif")
    assert code == 1 and "too large" in err and "1 point lies far from all others, at x 1500000.00" in err
    assert "--set terrain.cell" in err and not (tmp_path / "o.laz").exists() and not (tmp_path / "d.tif").exists()
    code, out, err = fwclass("ground", source, tmp_path / "o.laz", "--json")
    assert code == 0 and json.loads(out)["stray"] == 1 and "far from all others" in err
    code, _, err = fwclass("normalize", source, tmp_path / "n.laz", "--method", "smrf")
    assert code == 1 and "far from all others" in err and not (tmp_path / "n.laz").exists()
    far = las(tmp_path / "two.las", np.vstack([scene(500)[0], scene(400)[0] + [5000.0, 0.0, 0.0]]))
    assert json.loads(fwclass("ground", far, tmp_path / "t.laz", "--json")[1])["stray"] == 0


def test_waveforms_that_are_not_whole_are_told(tmp_path, fwclass):
    xyz, _ = scene(300)
    waves = [np.full(20, 10 + i % 90) for i in range(len(xyz))]
    made = write_las(
        tmp_path / "a.las",
        xyz,
        point_format=9,
        scale=0.01,
        waveforms=waves,
        where="internal",
        descriptors={1: Descriptor(n_samples=20)},
    )
    code, out, _ = fwclass("ground", made, tmp_path / "whole.laz", "--json")
    notes = json.loads(out)["notes"]
    assert code == 0 and len(notes) == 1 and "they are in whole.wdp beside the output now" in notes[0]
    cut = tmp_path / "cut.las"
    cut.write_bytes(made.read_bytes()[: -20 * 100])
    code, out, _ = fwclass("ground", cut, tmp_path / "c.laz", "--json")
    assert code == 0 and any(note.startswith("100 of 300 waveform packets") for note in json.loads(out)["notes"])
    outside = write_las(
        tmp_path / "e.las",
        xyz,
        point_format=9,
        scale=0.01,
        waveforms=waves,
        where="external",
        descriptors={1: Descriptor(n_samples=20)},
    )
    outside.with_suffix(".wdp").unlink()
    code, out, _ = fwclass("ground", outside, tmp_path / "n.laz", "--json")
    assert code == 0 and sum("missing" in note for note in json.loads(out)["notes"]) == 1


def test_rasters_of_the_terrain(tmp_path, fwclass):
    xyz, _ = scene()
    xyz[1] = 500_060, 5_400_060, 103  # on both upper edges, which opens no cells
    source = las(tmp_path / "a.las", xyz)
    names = {n: tmp_path / f"{n}.tif" for n in ("dtm", "dsm", "ndsm", "hillshade", "slope", "roughness")}
    words = [w for n, p in names.items() for w in (f"--{n}", p)]
    assert fwclass("ground", source, tmp_path / "b.laz", *words)[0] == 0
    with rasterio.open(names["dtm"]) as file:
        dtm, box = file.read(1), file.bounds
        assert file.crs.to_epsg() == 32633 and box == (500_000, 5_400_000, 500_060, 5_400_060)
    middle = np.arange(dtm.shape[1]) + 0.5 + box.left - 500_000
    plane = np.broadcast_to(100 + 0.05 * middle, dtm.shape)
    inner = (slice(3, -3), slice(3, -3))
    np.testing.assert_allclose(dtm[inner], plane[inner], atol=0.05)
    with rasterio.open(names["dsm"]) as file:
        assert np.nanmax(file.read(1) - dtm) == pytest.approx(6.0, abs=0.2)
    with rasterio.open(names["dsm"]) as top, rasterio.open(names["ndsm"]) as file:
        np.testing.assert_allclose(file.read(1), top.read(1) - dtm, atol=1e-5)
    with rasterio.open(names["hillshade"]) as file:
        assert file.nodata == 0 and file.read(1).min() > 0
    with rasterio.open(names["slope"]) as file:
        assert np.median(file.read(1)[inner]) == pytest.approx(np.degrees(np.arctan(0.05)), abs=0.3)
    with rasterio.open(names["roughness"]) as file:
        assert 0 <= np.nanmedian(file.read(1)) < 0.1
    fine = tmp_path / "fine.tif"
    assert fwclass("ground", source, tmp_path / "b.laz", "--overwrite", "--dtm", fine, "--cell", "0.5")[0] == 0
    with rasterio.open(fine) as file:
        assert file.res == (0.5, 0.5)
    code, _, err = fwclass("ground", source, tmp_path / "b.laz", "--overwrite", "--cell", "0.5")
    assert code == 2 and "none is asked for" in err


def test_heights_replace_z_and_nothing_else(tmp_path, fwclass):
    xyz, ground = scene()
    xyz[0] = xyz[1]
    far = np.array([[500_500.0, 5_400_500.0, 180.0]])
    cloud = np.vstack([xyz, far])
    classes = np.r_[np.where(ground, 2, 6), 5]
    classes[0] = classes[1]
    intensity = np.arange(len(cloud)) % 60_000
    source = las(tmp_path / "a.las", cloud, classes, intensity=intensity)
    code, out, err = fwclass("normalize", source, tmp_path / "n.laz", "--json")
    assert code == 0 and json.loads(out)["without"] == 1 and "-9999" in err
    old, new = laspy.read(source), laspy.read(tmp_path / "n.laz")
    for name in old.point_format.dimension_names:
        if name != "Z":
            np.testing.assert_array_equal(new[name], old[name])
    z = np.asarray(new.z)
    truth = cloud[:, 2] - 100 - 0.05 * (cloud[:, 0] - 500_000)
    np.testing.assert_allclose(z[1:-1], truth[1:-1], atol=0.06)
    assert z[-1] == -9999.0
    assert new.header.mins[2] == pytest.approx(z.min()) and new.header.maxs[2] == pytest.approx(z.max())
    for way in ("nearest", "raster"):
        assert fwclass("normalize", source, tmp_path / f"{way}.las", "--height", way)[0] == 0
        np.testing.assert_allclose(np.asarray(laspy.read(tmp_path / f"{way}.las").z)[1:-1], truth[1:-1], atol=0.5)
    assert fwclass("normalize", source, tmp_path / "k.laz", "--keep-z")[0] == 0
    kept = laspy.read(tmp_path / "k.laz")
    np.testing.assert_array_equal(kept.Z, old.Z)
    np.testing.assert_allclose(np.asarray(kept["HeightAboveGround"])[:-1], z[:-1], atol=0.006)
    records = kept.header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs
    missing = next(r.no_data[0] for r in records if r.format_name() == "HeightAboveGround")
    assert kept.points.array["HeightAboveGround"][-1] == missing


def test_heights_need_a_ground(tmp_path, fwclass):
    xyz, _ = scene(2000)
    source = las(tmp_path / "a.las", xyz)
    code, _, err = fwclass("normalize", source, tmp_path / "n.laz")
    assert code == 1 and "fwclass ground" in err and "--method" in err and "classes 1" in err
    code, _out, err = fwclass("normalize", source, tmp_path / "n.laz", "--method", "smrf", "--json")
    assert code == 0 and "found by smrf" in err
    np.testing.assert_array_equal(laspy.read(tmp_path / "n.laz").classification, 1)
    plain = text(tmp_path / "a.txt", xyz)
    assert fwclass("normalize", plain, tmp_path / "n.txt", "--method", "smrf")[0] == 0
    assert np.loadtxt(tmp_path / "n.txt", skiprows=1).shape == (2000, 4)
    code, _, err = fwclass("normalize", plain, tmp_path / "m.txt", "--method", "smrf", "--keep-z")
    assert code == 2 and "no extra bytes" in err


def test_a_coarser_step_where_heights_do_not_fit(tmp_path, fwclass):
    xyz, ground = scene(1000)
    xyz[0] = xyz[1]
    xyz -= [500_000, 5_400_000, 0]
    source = write_las(
        tmp_path / "a.las",
        np.vstack([xyz, [[300, 300, 50]]]),
        point_format=6,
        scale=1e-6,
        classification=np.r_[np.where(ground, 2, 6), 1],
        keys=None,
    )
    assert fwclass("normalize", source, tmp_path / "n.laz")[0] == 0
    new = laspy.read(tmp_path / "n.laz")
    assert new.header.scales[2] == pytest.approx(1e-5) and new.z[-1] == -9999.0
    assert new.header.scales[0] == 1e-6


def test_ground_figures_of_two_clouds(tmp_path, fwclass):
    xyz, ground = scene(1000)
    r = np.random.default_rng(4)
    truth = np.where(ground, 2, r.choice([3, 6, 9], len(xyz)))
    truth[5:10] = 0
    answer = np.where(r.random(len(xyz)) < 0.1, np.where(ground, 0, 2), np.where(ground, 2, 4))
    a, b = las(tmp_path / "a.las", xyz, truth), text(tmp_path / "b.txt", xyz[::-1], answer[::-1])
    code, out, _ = fwclass("assess", a, b, "--ground", "--json")
    made = json.loads(out)
    known = truth > 0
    t, p = (truth == 2)[known], (answer == 2)[known]
    assert made["confusion"] == [[int((t & p).sum()), int((t & ~p).sum())], [int((~t & p).sum()), int((~t & ~p).sum())]]
    assert made["type_i"] == pytest.approx((t & ~p).sum() / t.sum())
    assert made["type_ii"] == pytest.approx((~t & p).sum() / (~t).sum())
    assert made["total_error"] == pytest.approx((t != p).mean())
    agreed, chance = (t == p).mean(), t.mean() * p.mean() + (1 - t.mean()) * (1 - p.mean())
    assert made["kappa"] == pytest.approx((agreed - chance) / (1 - chance))
    assert {"classes", "overall_accuracy", "producers_accuracy", "users_accuracy", "iou", "mean_iou"} <= set(made)
    code, _, err = fwclass("assess", a, text(tmp_path / "c.txt", xyz), "--ground")
    assert code == 1 and "no classes" in err
    code, _, err = fwclass("assess", a, b, "--ground", "--map", "ground=2")
    assert code == 2 and "its own classes" in err


def test_a_copc_file_comes_out_as_plain_laz(tmp_path, fwclass):
    xyz, _ = scene(500)
    source = las(tmp_path / "a.las", xyz)
    copc = tmp_path / "a.copc.laz"
    laspy.read(source).write(copc)
    data = bytearray(copc.read_bytes())
    head = laspy.open(copc).header
    assert head.vlrs  # a record of COPC's own marks the file; its octree is not looked at
    at = data.index(b"LASF_Projection")
    data[at : at + 16] = b"copc".ljust(16, b"\0")
    data[at + 16 : at + 18] = (1).to_bytes(2, "little")
    copc.write_bytes(data)
    code, _out, err = fwclass("ground", copc, tmp_path / "b.laz", "--json")
    assert code == 0 and "COPC written as plain LAZ" in err
    assert not any(v.user_id == "copc" for v in laspy.open(tmp_path / "b.laz").header.vlrs)


@pytest.mark.parametrize("name", ["isprs/samp21.txt", "ign_hd/urban_77050_627755.laz", "other/delft_ahn3_2.laz"])
def test_real_files(tmp_path, fwclass, shared_data, name):
    source = shared_data / name
    target = tmp_path / f"o{source.suffix}"
    assert fwclass("ground", source, target)[0] == 0
    code, out, _ = fwclass("assess", source, target, "--ground", "--json")
    assert code == 0 and json.loads(out)["kappa"] > 0.7
