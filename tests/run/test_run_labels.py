"""Labels of a run: from polygons whatever the tiles, counted in the report, and told what is wrong with them."""

import json
from pathlib import Path

import geopandas
import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely
from runmaker import SETTINGS, walk

from fwclass import conf
from fwclass.errors import ConfigError, FwclassError, InputError
from fwclass.graph.label import LABEL_BY_CLOUD, LABEL_BY_POLYGONS, LABEL_BY_SOURCE
from fwclass.report.summary import summary
from fwclass.run.inputs import PartInputs
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.store.lock import writer
from fwclass.study.training import training
from fwclass.study.training_text import describe
from fwclass.walk.steps import plan_with_features, tasks_of, until_tiles
from fwclass.waveforms import IMPLAUSIBLE

CLASSES = {2: "ground", 5: "vegetation", 6: "building", 64: "artificial"}
FAST = ("survey.features=[height_above_ground, amplitude]", "features.also=[]", "train.trees=4")


@pytest.fixture(scope="module")
def drawn(survey) -> geopandas.GeoDataFrame:
    """Squares of 4 m with the commonest class of the simulator's true echoes."""
    clouds = [laspy.read(p) for p in sorted((survey / "reference").glob("*.las"))]
    x, y, code = (np.concatenate([np.asarray(c[n]) for c in clouds]) for n in ("x", "y", "classification"))
    code = np.where(np.isin(code, [3, 4]), 5, code)
    cells = {}
    for place, own in zip(zip((x // 4).astype(int), (y // 4).astype(int), strict=True), code.tolist(), strict=True):
        cells.setdefault(place, []).append(own)
    rows = [(max(set(c), key=c.count), shapely.box(4 * i, 4 * j, 4 * i + 4, 4 * j + 4)) for (i, j), c in cells.items()]
    made = geopandas.GeoDataFrame({"code": [c for c, _ in rows]}, geometry=[s for _, s in rows], crs=25832)
    made["klass"] = made["code"].map(CLASSES)
    return made


def asked(path, **more):
    words = ", ".join(f"{k}: {v}" for k, v in {"field": "klass", **more}.items())
    return f"survey.reference={{kind: polygons, files: ['{path}'], {words}}}"


def labelled(survey: Path, root: Path, *settings: str):
    """Labels alone: the run, and (identity, x, y, reference) of all echoes."""
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", *FAST, *settings))
    root.mkdir(parents=True, exist_ok=True)
    with writer(root), Display() as display:
        runner = Runner(root, Loop(), display)
        plan = until_tiles(plan_with_features(config), runner)
        runner.do(tasks_of(plan, (LABEL_BY_SOURCE, LABEL_BY_CLOUD, LABEL_BY_POLYGONS)))
        assert not runner.failures, runner.failures
        inputs = PartInputs(runner.store)
        columns = {
            **dict.fromkeys(("strip", "pulse", "echo_number", "x", "y", "fit_flags"), "tile"),
            "reference": "label",
        }
        tables = [inputs.rows(t.key, columns) for t in plan.layout.tiles]
    found = {n: np.concatenate([t[n] for t in tables]) for n in columns}
    order = np.lexsort((found["echo_number"], found["pulse"], found["strip"]))
    return runner, {n: v[order] for n, v in found.items()}


@pytest.fixture(scope="module")
def squares(survey, drawn, begun):
    """Labels by the squares: (root, echoes)."""
    root = begun("squares").parent
    drawn.to_file(root / "labels.gpkg")
    return root, labelled(survey, root / "run", asked(root / "labels.gpkg"))[1]


def test_every_echo_has_the_class_of_its_square(squares, drawn):
    codes = {
        (int(s.bounds[0]) // 4, int(s.bounds[1]) // 4): c for c, s in zip(drawn["code"], drawn.geometry, strict=True)
    }
    first = {"ground": 2, "vegetation": 3, "building": 6, "artificial": 64}  # the first of the class's codes
    echoes = squares[1]
    expected = [
        first[CLASSES[codes[place]]] if (place := (int(x // 4), int(y // 4))) in codes and not no_echo else 0
        for x, y, no_echo in zip(
            echoes["x"].tolist(), echoes["y"].tolist(), echoes["fit_flags"] & IMPLAUSIBLE, strict=True
        )
    ]
    np.testing.assert_array_equal(echoes["reference"], expected)
    assert len(expected) > 10_000 and np.unique(expected).size >= 4


@pytest.mark.parametrize(
    "ending, crs, setting, field",
    [
        ("parquet", 25832, "tile.size=37.5", "klass"),
        ("geojson", 4326, "tile.size=1000", "klass"),
        pytest.param("shp", 3857, "tile.size=100", "code", marks=pytest.mark.slow),
    ],
)
def test_the_format_the_system_and_the_tiles_change_no_label(
    ending, crs, setting, field, survey, drawn, squares, begun, tmp_path
):
    """Reprojected corners are back within a millimetre, so that only echoes at an edge may change sides."""
    path = tmp_path / f"labels.{ending}"
    made = drawn.to_crs(crs)
    made.to_parquet(path) if ending == "parquet" else made.to_file(path, **_digits(ending))
    _, echoes = labelled(survey, begun("format"), asked(path, field=field), setting)
    np.testing.assert_array_equal(echoes["x"], squares[1]["x"])
    before = squares[1]["reference"]
    after = np.where(echoes["reference"] == 5, 3, echoes["reference"])
    at_edge = np.minimum(echoes["x"] % 4, echoes["y"] % 4) < 0.01
    at_edge |= np.maximum(echoes["x"] % 4, echoes["y"] % 4) > 3.99
    np.testing.assert_array_equal(after[~at_edge], before[~at_edge])
    assert at_edge.mean() < 0.05
    if crs == 25832:
        np.testing.assert_array_equal(after, before)


def _digits(ending):
    return {"engine": "pyogrio", "COORDINATE_PRECISION": 12} if ending == "geojson" else {}


def test_what_is_done_is_skipped_and_a_changed_file_or_meaning_is_not(survey, drawn, squares):
    root, _ = squares
    again, _ = labelled(survey, root / "run", asked(root / "labels.gpkg"))
    assert again.tallies["polygons"].skipped == 1 and again.tallies["label"].computed == 0
    changed, echoes = labelled(survey, root / "run", asked(root / "labels.gpkg", values="{artificial: null}"))
    assert changed.tallies["polygons"].computed == 1 and changed.tallies["tile"].computed == 0
    assert 64 not in echoes["reference"] and 6 in echoes["reference"]


@pytest.fixture(scope="module")
def reported(survey, drawn, begun):
    """A whole run on overlapping and unsound polygons: (root, report)."""
    root = begun("reported")
    extra = geopandas.GeoDataFrame(
        {"klass": ["building", "nothing"], "code": [6, 0]},
        crs=25832,
        geometry=[shapely.box(512000, 5403000, 512030, 5403008), None],
    )
    both = geopandas.GeoDataFrame(geopandas.pd.concat([drawn, extra], ignore_index=True), crs=25832)
    both.to_parquet(root.parent / "labels.parquet")
    runner, report = walk(
        survey,
        root,
        asked(root.parent / "labels.parquet", values="{nothing: null}"),
        *FAST,
        "areas.train=[[512000, 5403000, 512060, 5403120]]",
    )
    assert not runner.failures, runner.failures
    return root, report


def test_the_report_counts_the_labels(reported):
    root, report = reported
    made = report["sampling"]
    tables = [pq.read_table(p, columns=["x", "y"]) for p in sorted((root / "parquet").glob("*.parquet"))]
    x = np.concatenate([t["x"].to_numpy() for t in tables])
    assert made["echoes"] == len(x)
    by_class = {c["name"]: c for c in made["classes"]}
    assert [sum(b["labelled"][k] for b in made["boxes"]) for k in range(4)] == [c["train"] for c in made["classes"]]
    assert [sum(t["taken"][k] for t in made["tiles"]) for k in range(4)] == [c["taken"] for c in made["classes"]]
    assert [sum(t["test"][k] for t in made["tiles"]) for k in range(4)] == [c["test"] for c in made["classes"]]
    assert {n: c["taken"] for n, c in by_class.items()} == report["training"]["samples"]
    assert all(c["taken"] == min(c["train"], 3000) for c in made["classes"])
    judged = np.array(report["accuracy"]["confusion"]).sum(axis=1)
    assert [c["test"] for c in made["classes"]] == judged.tolist()
    assert made["labelled"] + made["unlabelled"] + sum(made["other_codes"].values()) == made["echoes"]
    assert made["gap"]["found"] >= made["gap"]["asked"] == 5.0
    assert made["gap"]["found"] < 6.0


def test_the_report_tells_what_is_odd(reported):
    root, report = reported
    told = " ".join(report["sampling"]["remarks"])
    assert report["sampling"]["ambiguous"] > 100
    assert f"{report['sampling']['ambiguous']} echoes lie in polygons of different classes" in told
    assert f"{report['sampling']['ambiguous']} echoes lie in polygons" in summary(report, root)
    assert "1 features without a geometry" in told and "1 features label nothing" in told
    page = (root / "report.html").read_text()
    assert 'id="sampling"' in page and "Labels and sample" in page and "label nothing" in page
    assert json.loads((root / "report.json").read_text())["sampling"]["remarks"] == report["sampling"]["remarks"]


def test_a_training_tells_how_many_echoes_are_ambiguous(reported, survey):
    """In the run's own directory, so that all is made: every tile is looked at."""
    root, report = reported
    settings = (
        asked(root.parent / "labels.parquet", values="{nothing: null}"),
        *FAST,
        "areas.train=[[512000, 5403000, 512060, 5403120]]",
    )
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", *settings))
    with writer(root), Display() as display:
        made = training(config, Runner(root, Loop(), display), True)
    assert made["ambiguous"] == report["sampling"]["ambiguous"]
    assert f"{made['ambiguous']} echoes lie in polygons of different classes" in describe(made)
    assert "polygons" not in describe({**made, "ambiguous": 0})
    assert "1 echo lies in polygons" in describe({**made, "ambiguous": 1})


def broken(survey, root, *settings) -> FwclassError:
    with pytest.raises(FwclassError) as fault:
        labelled(survey, root, *settings)
    return fault.value


def test_faults_of_polygons_end_the_run_before_anything_is_read(survey, drawn, tmp_path):
    path = tmp_path / "labels.gpkg"
    drawn.to_file(path)
    for settings, kind, words in (
        (asked(path, field="klas"), ConfigError, "did you mean 'klass'"),
        (asked(path, layer="roofs"), ConfigError, "no such layer"),
        (asked(path, values="{building: roof}"), ConfigError, "neither a code nor a class"),
        (asked(path, crs="EPSG:nonsense"), ConfigError, "not a coordinate system"),
        (asked(tmp_path / "nowhere.gpkg"), InputError, "no file matches"),
        (asked(path, colour="red"), ConfigError, "unknown key survey.reference.colour"),
        (f"survey.reference={{kind: polygons, files: ['{path}']}}", ConfigError, "needs `field`"),
        ("survey.reference={kind: polygons, files: [], field: klass}", ConfigError, "needs `files`"),
        ("survey.reference={kind: source, field: klass}", ConfigError, "belongs to kind polygons"),
    ):
        fault = broken(survey, tmp_path / "run", settings)
        assert isinstance(fault, kind) and words in str(fault), fault
        assert fault.exit_code == (2 if kind is ConfigError else 1)
    assert not (tmp_path / "run" / "store" / "index").exists()


def test_polygons_that_mean_nothing_are_told(survey, drawn, tmp_path):
    unknown = drawn.assign(klass=drawn["klass"].str.upper())
    unknown.to_file(tmp_path / "unknown.gpkg")
    fault = broken(survey, tmp_path / "run", asked(tmp_path / "unknown.gpkg"))
    assert isinstance(fault, ConfigError) and "'BUILDING' (" in str(fault) and "values={" in str(fault)
    drawn.assign(code=99).to_file(tmp_path / "none.gpkg")
    fault = broken(survey, tmp_path / "run", asked(tmp_path / "none.gpkg", field="code"))
    assert "no polygon belongs to any class" in str(fault) and "99: " in str(fault)
    drawn.iloc[:0].to_file(tmp_path / "empty.gpkg")
    assert "empty" in str(broken(survey, tmp_path / "run", asked(tmp_path / "empty.gpkg")))


def test_polygons_elsewhere_without_a_system_or_of_another_kind_are_told(survey, drawn, begun, tmp_path, capsys):
    root = begun("elsewhere")
    drawn.translate(50_000).to_frame("geometry").assign(klass="ground").to_parquet(tmp_path / "away.parquet")
    fault = broken(survey, root, asked(tmp_path / "away.parquet"))
    assert isinstance(fault, InputError) and "another place" in str(fault) and "[562000.0, 5403000.0" in str(fault)
    drawn.set_crs(None, allow_override=True).to_parquet(tmp_path / "bare.parquet")
    fault = broken(survey, root, asked(tmp_path / "bare.parquet"))
    assert "survey.reference.crs=EPSG" in str(fault)
    lines = drawn.assign(geometry=drawn.boundary)
    lines.to_parquet(tmp_path / "lines.parquet")
    fault = broken(survey, root, asked(tmp_path / "lines.parquet"))
    told = " ".join(capsys.readouterr().err.split())  # the display has the whole message, the fault its first line
    assert isinstance(fault, InputError) and "is no polygon" in str(fault)
    assert "feature 1" in told and "LineString" in told


def test_a_system_that_is_given_stands_for_the_file_s_own(survey, drawn, squares, begun, tmp_path):
    drawn.set_crs(None, allow_override=True).to_parquet(tmp_path / "bare.parquet")
    _, echoes = labelled(survey, begun("given"), asked(tmp_path / "bare.parquet", crs="EPSG:25832"))
    np.testing.assert_array_equal(echoes["reference"], squares[1]["reference"])


@pytest.mark.slow
def test_a_class_that_no_polygon_has_is_told_with_the_codes_that_are_there(survey, drawn, tmp_path):
    drawn[drawn["code"] != 64].to_parquet(tmp_path / "three.parquet")
    with pytest.raises(ConfigError) as fault:
        walk(survey, tmp_path / "run", asked(tmp_path / "three.parquet"), *FAST)
    assert "No labelled echo of 'artificial' lies in a training area" in str(fault.value)
    assert "No echo is labelled 'artificial' (codes 64)" in str(fault.value)
    assert not (tmp_path / "run" / "store" / "features").exists()


@pytest.mark.slow
def test_a_cloud_whose_codes_no_class_counts_is_told(survey, tmp_path):
    classes = "survey.classes=[{name: water, code: 9, codes: [9]}, {name: runner, code: 11, codes: [11]}]"
    with pytest.raises(ConfigError) as fault:
        walk(survey, tmp_path, classes, *FAST)
    told = str(fault.value)
    assert "No echo is labelled 'water' (codes 9), 'runner' (codes 11)" in told
    assert "the reference also has the codes 2 (" in told and "there are: none" in told


def test_a_test_area_in_a_training_area_leaves_nothing_to_test(survey, tmp_path):
    fault = broken(survey, tmp_path / "run", "areas.test=[[512010, 5403010, 512064, 5403100]]")
    assert isinstance(fault, ConfigError) and "nothing is left to test on" in str(fault) and "5 m" in str(fault)


@pytest.mark.slow
def test_one_training_row_of_a_class_works_and_is_told(survey, drawn, squares, tmp_path):
    echoes = squares[1]
    inside = (echoes["x"] < 512055) & (echoes["reference"] == 2)
    k = np.flatnonzero(inside)[0]
    x, y = echoes["x"][k], echoes["y"][k]
    tiny = shapely.box(x - 0.0004, y - 0.0004, x + 0.0006, y + 0.0006)
    one = geopandas.GeoDataFrame({"klass": ["artificial"], "code": [64]}, geometry=[tiny], crs=25832)
    others = drawn[(drawn["code"] != 64) & ~drawn.intersects(tiny)]
    geopandas.GeoDataFrame(geopandas.pd.concat([others, one]), crs=25832).to_parquet(tmp_path / "one.parquet")
    runner, report = walk(survey, tmp_path / "run", asked(tmp_path / "one.parquet"), *FAST)
    assert not runner.failures, runner.failures
    assert report["training"]["samples"]["artificial"] == 1
    told = " ".join(report["sampling"]["remarks"])
    assert "Class 'artificial' has 1 training row: fewer than 100" in told
    assert "more than 100 to 1" in told
    assert "All training rows of class 'artificial' come from one tile" in told
    assert "Class 'artificial' does not occur in the test areas" in told
