"""The command line as a user meets it: exit codes, what goes where, and messages instead of tracebacks."""

import json
import shutil
import struct

import laspy
import numpy as np
import pytest
from commandline import fwclass, process
from lasmaker import write_las

from fwclass.errors import InputError
from fwclass.graph import training_rows


def cloud(path, xyz, classes, point_format=6):
    las = laspy.LasData(laspy.LasHeader(point_format=point_format, version="1.4"))
    las.header.scales, las.header.offsets = [0.001] * 3, [0.0] * 3
    las.x, las.y, las.z = np.asarray(xyz, float).T
    las.classification = classes
    las.write(path)
    return path


def config(path, **survey):
    lines = [
        "survey:",
        "  name: t",
        f"  directory: {survey.get('directory', path.parent)}",
        f"  sources: [{survey.get('sources', 'a.las')}]",
        "  reference: {kind: source}",
        f"  crs: {survey.get('crs', 'null')}",
        "  classes: [{name: a, code: 2, codes: [2]}, {name: b, code: 6, codes: [6]}]",
        "areas: {train: [[0, 0, 5, 10]]}",
        "plausibility: {accept: true}",  # labels by chance are learned as they are
        *survey.get("extra", ()),
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def small(tmp_path):
    r = np.random.default_rng(0)
    return cloud(tmp_path / "a.las", r.uniform(0, 10, (400, 3)), r.choice([2, 6], 400))


def told(result, code, *texts):
    """The command ended with `code`, said all `texts` on standard error, and showed no traceback."""
    assert result.returncode == code, result.stderr
    assert "Traceback" not in result.stderr + result.stdout
    for text in texts:
        assert text in result.stderr, result.stderr
    return True


def test_usage_errors_end_with_two():
    assert told(process("nonsense"), 2, "No such command")
    assert told(fwclass("run"), 2, "Missing argument")
    assert told(fwclass("run", "nowhere.yaml"), 2, "no such configuration", "riegl-sample")


def test_an_unknown_key_names_the_nearest(tmp_path, small):
    path = config(tmp_path / "c.yaml", extra=["ground:", "  slop: 0.2"])
    assert told(fwclass("run", path, "--out", tmp_path / "r"), 2, "ground.slop", "did you mean 'slope'")
    assert told(fwclass("run", path, "--set", "grund.slope=1"), 2, "did you mean 'ground'")
    assert told(fwclass("run", path, "--set", "nonsense"), 2, "section.key=value")
    assert not (tmp_path / "r").exists()


def test_a_missing_or_geographic_crs_is_told(tmp_path, small):
    path = config(tmp_path / "c.yaml")
    args = ("run", path, "--workers", 0, "--out", tmp_path / "r")
    assert told(fwclass(*args), 1, "coordinate system is unknown", "a.las", "survey.crs=EPSG")
    assert told(fwclass(*args, "--set", "survey.crs=EPSG:4326"), 1, "in degrees", "reproject")
    assert told(fwclass(*args, "--set", "survey.crs=EPSG:nonsense"), 2, "not a coordinate system")


def test_sources_that_do_not_exist_and_areas_elsewhere(tmp_path, small):
    path = config(tmp_path / "c.yaml", sources="b*.las", crs="none")
    assert told(fwclass("run", path, "--out", tmp_path / "r"), 1, "no file matches", "b*.las")
    path = config(tmp_path / "c.yaml", crs="none")
    away = ("--set", "areas.train=[[1000,0,1100,10]]", "--workers", 0, "--out", tmp_path / "r")
    assert told(fwclass("run", path, *away), 2, "no training area lies on the survey", "[0.")


def test_an_empty_and_a_foreign_file(tmp_path):
    (tmp_path / "a.las").write_bytes(b"")
    path = config(tmp_path / "c.yaml", crs="none")
    assert told(fwclass("run", path, "--workers", 0, "--out", tmp_path / "r"), 1, "a.las")
    (tmp_path / "a.las").write_text("x y z\n1 2 3\n" * 200)
    assert told(fwclass("run", path, "--workers", 0, "--out", tmp_path / "r"), 1, "a.las")
    assert told(fwclass("info", tmp_path / "a.las", "--json"), 1, "a.las")


def test_info_json_is_alone_on_standard_output(small):
    facts = json.loads(process("info", small, "--json").stdout)
    assert facts["points"] == 400
    result = fwclass("info", small)
    assert result.returncode == 0 and "400" in result.stdout


def test_assess_counts_what_is_there(tmp_path):
    r = np.random.default_rng(1)
    xyz = r.uniform(0, 50, (1000, 3))
    truth = r.choice([2, 6], 1000)
    answer = np.where(r.random(1000) < 0.2, 8 - truth, truth)
    a, b = cloud(tmp_path / "a.las", xyz, truth), cloud(tmp_path / "b.las", xyz, answer)
    made = json.loads(fwclass("assess", a, b, "--json").stdout)
    assert made["classes"] == ["2", "6"]
    assert made["overall_accuracy"] == pytest.approx((truth == answer).mean())
    assert made["confusion"][0][1] == ((truth == 2) & (answer == 6)).sum()
    assert made["type_i"] == pytest.approx(((truth == 2) & (answer == 6)).sum() / (truth == 2).sum())
    named = json.loads(fwclass("assess", a, b, "--map", "ground=2;building=6", "--json").stdout)
    assert named["classes"] == ["ground", "building"] and named["confusion"] == made["confusion"]
    shuffled = cloud(tmp_path / "c.las", xyz[::-1], answer[::-1])
    assert json.loads(fwclass("assess", a, shuffled, "--json").stdout)["confusion"] == made["confusion"]
    far = cloud(tmp_path / "d.las", xyz + 1000, answer)
    assert told(fwclass("assess", a, far), 1, "no point in common")
    assert told(fwclass("assess", a, b, "--map", "ground"), 2, "ground=2;vegetation=3,4,5")


def test_an_output_is_not_overwritten(tmp_path, small):
    out = tmp_path / "out.laz"
    assert fwclass("decompose", small, out).returncode == 0
    before = out.read_bytes()
    assert told(fwclass("decompose", small, out), 2, "the output exists", "--overwrite")
    assert out.read_bytes() == before
    assert fwclass("decompose", small, out, "--overwrite").returncode == 0


def test_a_class_without_labels_is_a_fault_before_anything_is_computed(tmp_path, small):
    path = config(tmp_path / "c.yaml", crs="none")
    classes = "survey.classes=[{name: a, code: 2, codes: [2]}, {name: water, code: 9, codes: [9]}]"
    settings = ("--set", classes, "--set", "areas.gap=0.5", "--set", "survey.features=[zc]")
    result = fwclass("run", path, "--workers", 0, "--out", tmp_path / "r", *settings)
    assert told(result, 2, "No labelled echo of 'water'", "areas.train", "survey.classes")
    assert not (tmp_path / "r" / "store" / "features").exists() and not (tmp_path / "r" / "report.html").exists()


def test_a_feature_that_no_stage_writes(tmp_path, small):
    path = config(tmp_path / "c.yaml", crs="none")
    args = ("run", path, "--workers", 0, "--out", tmp_path / "r")
    assert told(fwclass(*args, "--set", "survey.features=[echo_ration_r10]"), 2, "echo_ratio", "features --list")
    assert told(fwclass(*args, "--set", "survey.features=[echo_ratio_r20000]"), 2, "reaches too far", "200 m")
    for answer in ("source_class", "reference", "confidence", "x"):
        assert told(fwclass(*args, "--set", f"survey.features=[{answer},zc]"), 2, f"'{answer}' is not a feature")
    assert not (tmp_path / "r" / "store" / "index").exists()


def test_without_waveforms_the_template_s_width_is_refused_with_what_to_set(tmp_path, small):
    path = config(tmp_path / "c.yaml", crs="none")
    result = fwclass("run", path, "--workers", 0, "--out", tmp_path / "r", "--set", "survey.features=default-waveform")
    assert told(result, 2, "no echo of this survey has one", "--set survey.features=default\n")
    result = fwclass("run", path, "--workers", 0, "--out", tmp_path / "r", "--set", "survey.features=[zc, width]")
    assert told(result, 2, "no echo of this survey has one", '--set "survey.features=[zc]"')


def test_a_failed_run_does_not_show_an_older_run_s_figures(tmp_path, small, monkeypatch):
    path = config(tmp_path / "c.yaml", crs="none")
    settings = ["--set", "survey.features=[zc, echo_ratio_r100]", "--set", "areas.gap=0.5", "--set", "train.trees=3"]
    args = ("run", path, "--workers", 0, "--out", tmp_path / "r", *settings)
    assert told(fwclass(*args), 0, "accuracy")

    def refuse(*_):
        raise InputError("nothing to learn here")

    monkeypatch.setattr(training_rows, "review", refuse)
    result = fwclass(*args, "--set", "train.samples_per_class=999")
    assert told(result, 3, "nothing to learn here", "train.samples_per_class=999")
    assert "accuracy" not in result.stderr and "tiles  (" not in result.stderr
    assert "generation  0002 is not whole and lies aside" in result.stderr
    report = json.loads((tmp_path / "r" / "generations" / "0002" / "report.json").read_text())
    assert report["accuracy"] is None and not report["outputs"]["laz"] and report["failed"]
    assert json.loads((tmp_path / "r" / "report.json").read_text())["accuracy"], "readers keep the whole delivery"


@pytest.mark.parametrize("place", ["file", "file/below", "/proc/nope/x"])
def test_an_impossible_place_for_the_outputs(tmp_path, small, place):
    (tmp_path / "file").write_text("")
    path = config(tmp_path / "c.yaml", crs="none")
    target = place if place.startswith("/") else tmp_path / place
    assert told(fwclass("run", path, "--workers", 0, "--out", target), 1, "where:", "what to do:")
    assert told(fwclass("decompose", small, f"{target}/o.laz"), 2, "does not exist")
    assert told(fwclass("decompose", small, tmp_path / "o.las"), 2, "ends in .laz")


def test_feet_and_the_same_file_twice(tmp_path, small):
    path = config(tmp_path / "c.yaml", crs="EPSG:2263")
    args = ("run", path, "--workers", 0, "--out", tmp_path / "r")
    assert told(fwclass(*args), 1, "not in metres", "foot")
    high = write_las(
        tmp_path / "z.las", np.arange(30).reshape(10, 3), point_format=1, keys={3072: 25832, 4096: 7837, 4099: 9002}
    )
    only = ("--set", f"survey.sources=['{high.name}']", "--set", "survey.crs=null")
    assert told(fwclass(*args, *only), 1, "not in metres", "DHHN2016 height (foot)", "survey.crs=EPSG")
    high.unlink()
    (tmp_path / "ab.las").write_bytes(small.read_bytes())
    both = ("--set", "survey.sources=['*.las']", "--set", "survey.crs=none")
    assert told(fwclass(*args, *both), 1, "the same file", "ab.las")


@pytest.mark.parametrize(("other", "words"), [({4096: 5783}, "heights are not"), ({3072: 25833}, "into one system")])
def test_files_of_two_systems_are_told_what_differs(tmp_path, other, words):
    for name, keys in (("a", {3072: 25832, 4096: 7837}), ("ab", {3072: 25832, 4096: 7837} | other)):
        write_las(tmp_path / f"{name}.las", np.arange(30).reshape(10, 3), point_format=1, keys=keys)
    path = config(tmp_path / "c.yaml", sources="'*.las'")
    refused = fwclass("run", path, "--workers", 0, "--out", tmp_path / "r")
    assert told(refused, 1, "different coordinate systems", words, "--set survey.crs=EPSG")


def test_settings_out_of_range(tmp_path, small):
    path = config(tmp_path / "c.yaml", crs="none")
    for setting in ("survey.sources=[]", "areas.gap=-1", "tile.size=0.5", "survey.name=../../x"):
        result = fwclass("run", path, "--set", setting)
        assert told(result, 2, setting.split("=")[0], f"--set {setting}")
    assert told(fwclass("run", path, "--set", "survey.features=zc"), 2, "no such feature set", "a list of columns [zc")
    assert told(process("run", path, "--out", tmp_path / "r", "--scheduler", "rubbish"), 1, "no Dask scheduler")


def test_a_wrong_header_does_not_hide_the_points(tmp_path, small):
    data = bytearray(small.read_bytes())
    struct.pack_into("<6d", data, 179, *[9e5] * 6)
    small.write_bytes(data)
    path = config(tmp_path / "c.yaml", crs="none")
    settings = ["--set", "survey.features=[zc]", "--set", "areas.gap=0.5", "--set", "train.trees=3"]
    assert told(fwclass("run", path, "--workers", 0, "--out", tmp_path / "r", *settings), 0, "accuracy")


def test_a_run_on_echoes_without_waveforms_and_its_threshold(tmp_path, small):
    path = config(tmp_path / "c.yaml", crs="none", extra=["train: {trees: 5}", "publish: {figure_pixels: 200}"])
    settings = ["--set", "survey.features=[zc, echo_ratio_r100]", "--set", "areas.gap=0.5"]
    args = ("run", path, "--workers", 0, "--out", tmp_path / "r", *settings)
    assert told(fwclass(*args), 0, "400", "accuracy", "report.html")
    assert told(fwclass(*args, "--set", "assess.min_kappa=0.99"), 4, "kappa misses its threshold")
    strip = laspy.read(tmp_path / "r" / "laz" / "strips" / "a.laz")
    source = laspy.read(small)
    np.testing.assert_array_equal(strip.X, source.X)
    assert set(np.unique(strip.classification)) <= {2, 6}


def test_info_of_a_directory_is_that_of_its_files(small, tmp_path):
    folder = tmp_path / "strips"
    folder.mkdir()
    ended = fwclass("info", folder)
    assert ended.returncode == 1 and "without files of points" in ended.stderr and "Traceback" not in ended.stderr
    for name in ("b.las", "a.LAS"):
        shutil.copy(small, folder / name)
    (folder / "notes.txt").write_text("x")
    (folder / "report.json").write_text("{}")
    (folder / "below.las").mkdir()
    ended = fwclass("info", folder, "--json")
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout) == [
        json.loads(fwclass("info", folder / n, "--json").stdout) for n in ("a.LAS", "b.las")
    ]
    one = json.loads(ended.stdout)[0]
    told = fwclass("info", folder).stdout.split("\n\n")
    assert len(told) == 3 and f"together     2 files, {2 * one['points']:,} points or pulses\n" in told[2]
    assert all(f"{code}: {2 * n:,}" in told[2] for code, n in one["classes"].items())
    assert told[2].count("  ! ") == len(one["faults"]) == told[2].count("(alike in 1 other file)")
    assert "together" not in fwclass("info", folder / "b.las").stdout
