"""A command on one file gives the bytes that a run of that file gives: both walk the same stages."""

import laspy
import numpy as np
import pytest
from commandline import fwclass
from runmaker import SETTINGS, walk

from fwclass import conf
from fwclass.decompose.stage import DECOMPOSE
from fwclass.errors import FwclassError
from fwclass.graph.classify import CLASSIFY_ECHOES
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.graph.ground import FILTER_GROUND, GATHER_GROUND, GATHER_HEIGHT
from fwclass.graph.loaded_models import load_given
from fwclass.radiometry.stage import RADIOMETRY
from fwclass.read.source import open_source
from fwclass.run.inputs import PartInputs
from fwclass.schema import Table, canonical_key
from fwclass.single_file.decompose import add_radiometry, decompose_file, read_flight
from fwclass.single_file.strip import strip_of
from fwclass.single_file.tiles import MAKE_HEIGHTS, FileConfig, FileTiles
from fwclass.store.run_store import Store
from fwclass.store.tables import read_table

DEMO = ("decompose.register_within=0.0", "decompose.tail_share=0.0")
"""What the demo's configuration sets for its ideal receiver."""
TRAIN = "[[512000, 5403000, 512060, 5403120]]"
WORDS = [w for s in ("ground.block=64", "ground.max_building_size=50") for w in ("--set", s)]
SAMPLED = "pulse.sample=3000"
"""Far fewer than the strip has: what is drawn depends on the strip's number."""


@pytest.fixture(scope="module")
def strip(survey):
    return sorted((survey / "strips").glob("*.las"))[1]


@pytest.fixture(scope="module")
def whole(survey, strip, tmp_path_factory):
    """A run of that one strip, without a reference."""
    root = tmp_path_factory.mktemp("one")
    runner, _ = walk(survey, root, f"survey.sources=[strips/{strip.name}]", SAMPLED)
    assert not runner.failures, runner.failures
    return root


def of_run(root, columns):
    """Columns of all echoes of a run by their stage, in canonical order."""
    inputs = PartInputs(Store(root))
    keys = [p.name for p in sorted((root / "store" / "tile").iterdir())]
    wanted = {**dict.fromkeys(("strip", "pulse", "echo_number"), "tile"), **columns}
    table = Table.concat([inputs.rows(k, wanted).select(wanted) for k in keys])
    return table.take(np.argsort(canonical_key(table)))


@pytest.mark.slow
def test_the_pulse_of_a_large_strip_and_its_echoes_are_the_run_s(whole, strip):
    run = PartInputs(Store(whole))
    with strip_of(open_source(strip), (SAMPLED, *SETTINGS, *DEMO)) as one:
        assert one.pulses > 3000 and list(one.echoes())
        ours = PartInputs(one.store)
        files = [("pulse", f"{one.number:05d}", "pulse.json")]
        files += [("decompose", s.key, name) for s in one.spans for name in ("table.parquet", "links.parquet")]
        for name in files:
            assert ours.path(*name).read_bytes() == run.path(*name).read_bytes(), name


def test_decompose_writes_the_run_s_echoes(whole, strip, tmp_path):
    settings = tuple(s for s in (SAMPLED, *SETTINGS) if s.split(".")[0] in ("read", "pulse", "decompose"))
    decompose_file(strip, tmp_path / "echoes.laz", (*settings, *DEMO), False)
    las = laspy.read(tmp_path / "echoes.laz")
    run = of_run(whole, dict.fromkeys((*"xyz", "amplitude", "fit_flags"), "tile"))
    assert len(las.x) == run.rows
    ours, theirs = (np.lexsort((np.asarray(t["z"]), np.asarray(t["y"]), np.asarray(t["x"]))) for t in (las, run))
    for axis in "xyz":
        np.testing.assert_allclose(np.asarray(las[axis])[ours], run[axis][theirs], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(np.asarray(las["fit flags"])[ours], run["fit_flags"][theirs])


def test_radiometry_of_one_file_is_the_run_s_bytes(whole, survey):
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}"))
    echoes = of_run(whole, dict.fromkeys(DECOMPOSE.writes, "tile"))
    (path,) = (survey / name for name in config.survey.trajectory.files)
    flown = read_flight(echoes, path, None, config.survey.trajectory.undulation)
    params = {"features": config.features, "radiometry": config.radiometry}
    ours, _, _ = add_radiometry(echoes, flown, params, path)
    theirs = of_run(whole, dict.fromkeys(RADIOMETRY.writes, "radiometry"))
    for name in RADIOMETRY.writes:
        assert ours[name].tobytes() == theirs[name].tobytes(), name


@pytest.fixture(scope="module")
def returns(survey, strip, tmp_path_factory):
    """The strip's returns alone, as a discrete-return file, and a run of it: (file, run)."""
    root = tmp_path_factory.mktemp("returns")
    las = laspy.read(strip)
    made = laspy.convert(las, point_format_id=6)
    made.header.vlrs = [v for v in made.header.vlrs if v.record_id == 2112]
    (root / "in").mkdir()
    (root / "in" / "reference").symlink_to(survey / "reference")
    made.write(root / "in" / strip.name)
    settings = (f"survey.sources=[{strip.name}]", "survey.trajectory.files=[]", "survey.crs=EPSG:25832")
    own = ("survey.features=[zc, echo_number, height_above_ground, height_std_c100, echo_ratio_r100]",)
    runner, _ = walk(root / "in", root / "run", *settings, *own, f"areas.train={TRAIN}")
    assert not runner.failures, runner.failures
    return root / "in" / strip.name, root / "run"


def by_place(table, names):
    order = np.lexsort(tuple(np.asarray(table[n]) for n in ("echo_number", "pulse")))
    return {n: np.asarray(table[n])[order] for n in names}


def test_ground_and_heights_of_one_file_are_the_run_s(returns, tmp_path):
    file, root = returns
    done = fwclass(
        "ground", file, tmp_path / "g.laz", "--set", "ground.block=64", "--set", "ground.max_building_size=50"
    )
    assert done.returncode == 0, done.stderr
    classes = np.asarray(laspy.read(tmp_path / "g.laz").classification)
    run = of_run(root, {"ground": "ground", "noise": "ground"})
    np.testing.assert_array_equal(classes == 2, run["ground"])


def test_features_of_one_file_are_the_run_s(returns, tmp_path):
    file, root = returns
    names = ("zc", "height_std_c100", "echo_ratio_r100")
    done = fwclass("features", file, tmp_path / "f.parquet", "--features", ",".join(names))
    assert done.returncode == 0, done.stderr
    ours = read_table(tmp_path / "f.parquet", ("pulse", "echo_number", *names))
    run = of_run(root, dict.fromkeys(names, "features"))
    for name in names:
        np.testing.assert_array_equal(by_place(ours, names)[name], by_place(run, names)[name], err_msg=name)


def test_classes_of_one_file_are_the_run_s(returns, tmp_path):
    file, root = returns
    done = fwclass("classify", file, tmp_path / "c.laz", "--model", root / "model", "--method", "smrf", *WORDS)
    assert done.returncode == 0, done.stderr
    classes = np.asarray(laspy.read(tmp_path / "c.laz").classification)
    run = of_run(root, {"classification": "classify"})
    np.testing.assert_array_equal(classes, run["classification"])


def test_what_stages_make_of_one_file_in_memory_are_the_run_s_bytes(returns):
    """Ground, heights, features and answers of all echoes, by tiles of another size."""
    _, root = returns
    names = ("zc", "echo_number", "height_above_ground", "height_std_c100", "echo_ratio_r100")
    echoes = of_run(root, dict.fromkeys(DECOMPOSE.writes, "tile"))
    model, digest = load_given(root / "model")
    config = FileConfig((*(s for s in SETTINGS if ".block=" in s), *WORDS[1::2], "tile.size=37"), classes=model.classes)
    stages = (FILTER_GROUND, GATHER_GROUND, MAKE_HEIGHTS, GATHER_HEIGHT, COMPUTE_FEATURES, CLASSIFY_ECHOES)
    said = []
    tiles = FileTiles(
        echoes,
        config,
        stages,
        said.append,
        {FILTER_GROUND.name: "block", CLASSIFY_ECHOES.name: "tile"},
        held=0,
        names=names,
        computed=names,
        model=(root / "model", digest),
    )
    for stage in (CLASSIFY_ECHOES, COMPUTE_FEATURES, GATHER_HEIGHT, GATHER_GROUND):
        columns = stage.columns(tiles.plan)
        ours, theirs = tiles.columns(stage, columns), of_run(root, dict.fromkeys(columns, stage.name))
        for name in columns:
            assert ours[name].tobytes() == theirs[name].tobytes(), name
    assert [s for s in said if "tile" in s] == [f"tile {k + 1} of {len(tiles.keys)}" for k in range(len(tiles.keys))]
    assert [s for s in said if "block" in s] == [f"block {k} of 6" for k in range(1, 7)] and len(tiles.keys) > 4
    with pytest.raises(FwclassError, match="no files"):
        tiles.inputs().path(CLASSIFY_ECHOES.name, tiles.keys[0], "table.parquet")


def test_heights_of_one_file_are_the_run_s(returns, tmp_path):
    file, root = returns
    assert fwclass("ground", file, tmp_path / "g.laz", *WORDS).returncode == 0
    done = fwclass("normalize", tmp_path / "g.laz", tmp_path / "n.laz", "--set", "terrain.block=64", "--keep-z")
    assert done.returncode == 0, done.stderr
    ours = np.asarray(laspy.read(tmp_path / "n.laz")["HeightAboveGround"])
    run = of_run(root, {"height_above_ground": "height"})["height_above_ground"]
    assert np.array_equal(np.isnan(ours), np.isnan(run))
    np.testing.assert_allclose(ours, run, rtol=0, atol=0.0055)  # centimetres in the file, 2^-12 in Parquet


def test_echoes_lie_where_the_scene_sent_them_back(survey, tmp_path):
    """Millimetres: a row pulled onto its return, whose place is rounded, would be a centimetre and more off."""
    for strip in sorted((survey / "strips").glob("*.las")):
        assert fwclass("decompose", strip, tmp_path / "o.laz", "--overwrite").returncode == 0
        fitted, true = laspy.read(tmp_path / "o.laz"), laspy.read(survey / "reference" / strip.name)
        places = []
        for cloud in (fitted, true):
            time, first, count = np.unique(np.asarray(cloud.gps_time), return_index=True, return_counts=True)
            places.append((time[count == 1], np.column_stack([cloud.x, cloud.y, cloud.z])[first[count == 1]]))
        _, a, b = np.intersect1d(places[0][0], places[1][0], return_indices=True)
        off = np.linalg.norm(places[0][1][a] - places[1][1][b], axis=1)
        assert len(off) > 1000 and np.median(off) < 0.004 and np.quantile(off, 0.9) < 0.012
