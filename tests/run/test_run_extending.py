"""docs/extending.md, followed to the letter: every file on the page runs as the page says."""

import contextlib
import importlib.util
import math
import os
import py_compile
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import laspy
import numpy as np
import pytest
import smallgraph
from runmaker import SETTINGS, walk

from fwclass import conf
from fwclass.classes import ClassDef
from fwclass.columns import COLUMNS
from fwclass.errors import ConfigError, FwclassError, InputError, StoreError
from fwclass.graph.own_stage import OfChunk, OfDelivery, OfRows
from fwclass.operate.request import Request
from fwclass.operate.seams.walk import SeamRequest, seams
from fwclass.operate.status.verify import verify
from fwclass.operate.status.walk import Silent
from fwclass.report.summary import summary
from fwclass.run.cluster import Cluster
from fwclass.run.part import Task
from fwclass.schema import Table
from fwclass.store.run_location import open_store
from fwclass.store.tables import read_table
from fwclass.workflows import workflow_of

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
FEATURES = "survey.features=[zc, echo_number, amplitude, unevenness]"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The Python files of the page, by name."""
    root = tmp_path_factory.mktemp("page")
    blocks = re.findall(r"```python\n# (\w+\.py)\n(.*?)```", PAGE.read_text(), re.DOTALL)
    for name, text in blocks:
        (root / name).write_text(text)
    assert {name for name, _ in blocks} == {"uneven.py", "lowest.py", "rules.py", "csv_tiles.py"}
    return {name: str(root / name) for name, _ in blocks}


def delivered(root, *columns):
    """Columns of all delivered echoes, in the order of their identity."""
    names = ("strip", "pulse", "echo_number", *columns)
    tables = [read_table(p, names) for p in sorted((root / "parquet").glob("*.parquet"))]
    found = {n: np.concatenate([t[n] for t in tables]) for n in names}
    order = np.lexsort((found["echo_number"], found["pulse"], found["strip"]))
    return {n: v[order] for n, v in found.items()}


@pytest.fixture(scope="module")
def uneven(survey, files, begun):
    root = begun("uneven")
    runner, report = walk(survey, root, FEATURES, workflow=files["uneven.py"])
    assert not runner.failures, runner.failures
    return root, report


def test_a_stage_of_one_s_own_is_a_feature_and_is_delivered(uneven):
    root, report = uneven
    assert "unevenness" in report["model"]["features"] and report["accuracy"]
    assert "unevenness" in {s["name"] for s in report["stages"]}
    tile = next((root / "laz" / "tiles").glob("*.laz"))
    values = np.asarray(laspy.read(tile)["unevenness"])
    assert np.isfinite(values).all() and values.max() > 0.5


def test_the_last_words_of_a_run_tell_of_a_new_kind_of_output(uneven):
    root, report = uneven
    with mock.patch.dict("fwclass.report.summary.KINDS", csv=("csv/",)):
        said = summary({**report, "outputs": {**report["outputs"], "csv": ["csv/1_1.csv"]}}, root).splitlines()
    assert f"csv         {root / 'csv'}  (1 file)" in said


@pytest.mark.slow
def test_it_does_not_depend_on_tiles_or_workers(uneven, survey, files, tmp_path):
    cluster = Cluster(None, 2, 4.0, 1000)
    runner, _ = walk(survey, tmp_path, FEATURES, "tile.size=35", executor=cluster, workflow=files["uneven.py"])
    assert not runner.failures, runner.failures
    one, other = (delivered(root, "unevenness", "classification") for root in (uneven[0], tmp_path))
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_seams_compare_it(uneven, survey, files):
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", FEATURES))
    found = seams(config, uneven[0], SeamRequest((50.0, 50.0), 1.0, None, None, files["uneven.py"]), Silent())
    assert found.equal and "unevenness" in {s.stage for s in found.bounded}


@pytest.mark.slow
def test_a_halo_too_small_is_found(survey, files, tmp_path):
    text = Path(files["uneven.py"]).read_text()
    near = tmp_path / "near.py"
    near.write_text(text.replace("halo=1.0", "halo=0.2"))
    runner, _ = walk(survey, tmp_path / "run", FEATURES, workflow=str(near))
    assert not runner.failures
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", FEATURES))
    found = seams(config, tmp_path / "run", SeamRequest((50.0, 50.0), 1.0, None, None, str(near)), Silent())
    assert "unevenness" in {s.stage for s in found.bounded if s.differ}


def test_an_edited_file_makes_its_parts_anew_and_no_others(uneven, survey, files, tmp_path):
    shutil.copytree(uneven[0], tmp_path / "run", symlinks=True)
    mine = tmp_path / "uneven.py"
    mine.write_text(Path(files["uneven.py"]).read_text() + "\n# edited\n")
    runner, _ = walk(survey, tmp_path / "run", FEATURES, workflow=str(mine))
    made = {name[0] for name, outcome in runner.outcomes.items() if outcome.status == "computed"}
    assert made == {"unevenness"}  # it gives the same values, so that nothing behind it is made


@pytest.mark.slow
def test_a_ground_filter(survey, files, tmp_path):
    runner, report = walk(survey, tmp_path, "survey.features=[zc, amplitude]", workflow=files["lowest.py"])
    assert not runner.failures, runner.failures
    found = delivered(tmp_path, "x", "y", "z", "ground", "noise")
    column, row = np.floor(found["x"] / 8.0), np.floor(found["y"] / 8.0)
    _, square = np.unique(np.c_[column, row], axis=0, return_inverse=True)
    low = np.full(square.max() + 1, np.inf)
    np.minimum.at(low, square.ravel(), found["z"])
    np.testing.assert_array_equal(found["ground"], found["z"] <= low[square.ravel()] + 0.5)
    assert not found["noise"].any() and report["ground"]


@pytest.mark.slow
def test_a_classifier(survey, files, tmp_path):
    runner, report = walk(survey, tmp_path, "survey.features=[zc]", workflow=files["rules.py"])
    assert not runner.failures, runner.failures
    assert not {"train", "trees", "sample"} & {s["name"] for s in report["stages"]}
    found = delivered(tmp_path, "ground", "height_above_ground", "number_of_echoes", "classification")
    low = found["ground"] | (found["height_above_ground"] < 2.0)
    expected = np.where(low, 2, np.where(found["number_of_echoes"] > 1, 5, 6))
    np.testing.assert_array_equal(found["classification"], expected)
    assert report["accuracy"]["overall_accuracy"] > 0.5


@pytest.mark.slow
def test_an_output_format(survey, files, tmp_path):
    runner, _ = walk(survey, tmp_path, "survey.features=[zc, amplitude]", workflow=files["csv_tiles.py"])
    assert not runner.failures, runner.failures
    rows = np.concatenate([np.loadtxt(p, delimiter=",", skiprows=1) for p in sorted((tmp_path / "csv").glob("*.csv"))])
    assert len(rows) == len(delivered(tmp_path)["pulse"])
    some = next((tmp_path / "csv").glob("*.csv")).resolve()
    some.chmod(0o644)
    some.write_text("x")
    assert not verify(open_store(tmp_path, lists=True)).sound


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import nothing_of_that_name", "cannot be imported"),
        ("def f(:", "cannot be imported"),
        ("x = 1", "has no workflow"),
        ("workflow = 3", "has no workflow"),
        (
            "from fwclass.workflows.classification import classification\n"
            "workflow = classification.with_stage(classification.stages[0], after='nowhere')",
            "no stage of this name",
        ),
        (
            "from dataclasses import replace\nfrom fwclass.workflows.classification import classification as c\n"
            "workflow = replace(c, stages=c.stages[::-1])",
            "comes before what it reads",
        ),
    ],
)
def test_a_bad_file_is_refused_in_words(tmp_path, text, words):
    path = tmp_path / "bad.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        workflow_of(str(path))


def test_the_code_of_a_file_is_that_file_s(tmp_path):
    """Python's own cache beside it was run in its place, and written there: an unpacked delivery brings one."""
    path, planted = tmp_path / "mine.py", tmp_path / "planted.py"
    told = (
        "from fwclass.workflows.classification import classification as workflow\nimport os\nos.environ['WHO'] = '{}'\n"
    )
    path.write_text(told.format("mine"))
    planted.write_text(told.format("evil"))
    os.utime(planted, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns))
    py_compile.compile(str(planted), importlib.util.cache_from_source(str(path)), dfile=str(path))
    planted.unlink()
    with mock.patch.dict(os.environ):
        assert workflow_of(str(path)).name
        assert os.environ["WHO"] == "mine"
        shutil.rmtree(tmp_path / "__pycache__")
        path.write_text(told.format("else"))
        assert workflow_of(str(path)).name and os.environ["WHO"] == "else"
    assert [p.name for p in tmp_path.iterdir()] == ["mine.py"]


def test_a_missing_file_and_an_unknown_name(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        workflow_of(str(tmp_path / "nothing.py"))
    with pytest.raises(ConfigError, match="no such workflow"):
        workflow_of("nonsense")


def test_a_column_of_a_name_that_is_taken_is_refused(survey, files, tmp_path):
    path = tmp_path / "taken.py"
    path.write_text(Path(files["uneven.py"]).read_text().replace('"unevenness"', '"roughness"'))
    with pytest.raises(ConfigError, match="means something else"):
        walk(survey, tmp_path / "run", "survey.features=[zc]", workflow=str(path))


def test_a_run_directory_starts_no_code(uneven, files, tmp_path):
    store = open_store(uneven[0], lists=True)
    Request("demo", str(uneven[0]), workflow=files["uneven.py"]).keep(store)
    with pytest.raises(ConfigError, match="cannot have started"):
        Request.kept(store)
    assert Request.kept(store, files["uneven.py"]).workflow == files["uneven.py"]


HEAD = """
import numpy as np
from functools import partial
from fwclass.graph.own_stage import chunk_stage, classifier_stage, delivery_stage, ground_filter_stage
from fwclass.schema import Column
from fwclass.workflows.classification import classification
MY = Column("my", "f4", "m", "mine")
def f(chunk, **settings):
    return {"my": np.zeros(len(chunk.core))}
def stage(function=f, name="my-stage", reads=("z",), writes=(MY,), **more):
    return chunk_stage(name, function, reads, writes, **more)
"""
PUT = "workflow = classification.with_stage(stage({}), after='features')"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (PUT.format("lambda chunk: {}"), "a function of the file, by its name"),
        (PUT.format("partial(f, b=1.0)"), "a function of the file, by its name"),
        (PUT.format("name='My Stage/x'"), "cannot be the name of a stage"),
        (PUT.format("reads='ground'"), "are a list"),
        (PUT.format("halo=float('nan')"), "cannot be a halo"),
        (PUT.format("halo=-1.0"), "cannot be a halo"),
        (PUT.format("halo=10000.0"), "0 to 100 m"),
        (PUT.format("settings={'a': np.zeros(3)}"), "cannot be a setting"),
        (PUT.format("settings={'a': float('nan')}"), "cannot be a setting"),
        (PUT.format("settings={1: 2}"), "cannot be a setting"),
        (PUT.format("writes='my'"), "a stage writes columns"),
        (PUT.format("name='features'"), "two stages have one name"),
        (
            "a, b = stage(), stage(name='other')\n"
            "workflow = classification.with_stage(a, 'features').with_stage(b, 'features')",
            "two stages write one column",
        ),
        ("raise SystemExit(0)", "cannot be imported"),
        ("import nothing_beside", "no files beside it"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(tmp_path, text, words):
    path = tmp_path / "mine.py"
    path.write_text(HEAD + text)
    with pytest.raises(ConfigError, match=words):
        workflow_of(str(path))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (PUT.format("reads=('hieght_above_ground',)"), "height_above_ground"),
        ("workflow = classification.with_stage(stage(reads=('ground',)), after='tile')", "before the one that writes"),
        ("MY = Column('My Col', 'f4', 'm', 'x')\n" + PUT.format("writes=(MY,)"), "name of a column"),
        ("MY = Column('my', 'f4', 'm', 'x', las='intensity')\n" + PUT.format("writes=(MY,)"), "name of a column"),
        ("MY = Column('my', 'f4', 'm', 'x', las='a' * 40)\n" + PUT.format("writes=(MY,)"), "at most 32 bytes"),
    ],
)
def test_columns_that_cannot_be_are_refused_before_anything_runs(survey, tmp_path, text, words):
    path = tmp_path / "mine.py"
    path.write_text(HEAD + text)
    with pytest.raises(ConfigError, match=words):
        workflow_of(str(path)).begin(conf.load("demo", SETTINGS))


GIVES = "def g(chunk):\n    return {}\n" + PUT.format("g")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GIVES.format("{'my': np.zeros(chunk.table.rows + 1)}"), "wrong number of values of 'my'"),
        pytest.param(GIVES.format("{'my': 3.0}"), "one for every echo of the tile", marks=pytest.mark.slow),
        pytest.param(GIVES.format("None"), "gives columns", marks=pytest.mark.slow),
        pytest.param(
            GIVES.format("{'your': np.zeros(len(chunk.core))}"),
            "other columns than its stage writes",
            marks=pytest.mark.slow,
        ),
        (GIVES.format("{'my': chunk.table['intensity'][chunk.core]}"), "named in the stage's `reads`"),
        pytest.param(GIVES.format("{'my': 1 / 0}"), r"mine.py:\d+, stage my-stage", marks=pytest.mark.slow),
        (GIVES.format("exit(0)"), "SystemExit"),
        (
            "MY = Column('small', 'u1', '', 'x')\n"
            "def g(chunk):\n    return {'small': np.full(len(chunk.core), 300.7)}\n" + PUT.format("g, writes=(MY,)"),
            "does not fit its column",
        ),
        (
            "def g(table, directory, tile):\n    (directory / 'a.txt').write_text('x')\n"
            "workflow = classification.with_stage(delivery_stage('d', g, ('x',)), after='publish-tile')",
            "a name that another may have",
        ),
        (
            "import os\ndef g(table, directory, tile):\n    os.symlink(__file__, directory / f'{tile}.txt')\n"
            "workflow = classification.with_stage(delivery_stage('d', g, ('x',)), after='publish-tile')",
            "files of its own",
        ),
        (
            "def g(table):\n    n = table.rows\n"
            "    return {'classification': np.full(n, 99), 'confidence': np.ones(n), 'entropy': np.zeros(n)}\n"
            "workflow = classification.without_training().with_stage_instead(classifier_stage(g, ('z',)))",
            "a class that the survey has not",
        ),
        (
            "def g(table):\n    return np.full(table.rows, 7), np.zeros(table.rows, bool)\n"
            "workflow = classification.with_stage_instead(ground_filter_stage(g, 2.0))",
            "two flags for every row",
        ),
    ],
)
def test_a_function_that_gives_nonsense_fails_in_words(survey, finished, tmp_path, text, words):
    path, root = tmp_path / "mine.py", tmp_path / "run"
    path.write_text(HEAD + text)
    shutil.copytree(finished[0], root, symlinks=True)
    with contextlib.suppress(FwclassError):
        walk(survey, root, workflow=str(path))
    messages = [failure.message for failure, _ in open_store(root, lists=True).failures.all().values()]
    assert any(re.search(words, m) for m in messages), messages
    assert path.stat().st_mode & 0o200  # what a link leads to is not made read-only


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([0.0, np.nan, 1.0], "1 NaN"),
        (np.ma.array([0.0, 1.0, 2.0], mask=[True, False, True]), "2 masked"),
        ([0.0, np.inf, 1.0], "does not fit its column"),
        ([0.0, 1e300, 1.0], "does not fit its column"),
    ],
)
def test_a_value_that_is_none_is_refused(values, words):
    adapter = OfChunk("mine", len)
    narrow = [c for c in COLUMNS.values() if c.dtype == "f4" and not c.scales]
    names = [next(c.name for c in narrow if c.null is None), "confidence"]
    with pytest.raises(InputError, match=words):
        adapter.columns({names[0]: values}, 3, names[:1])
    if "fit" in words:
        with pytest.raises(InputError, match=words):
            adapter.columns({names[1]: values}, 3, names[1:])
    else:
        given = adapter.columns({names[1]: values}, 3, names[1:])[names[1]]
        assert np.isnan(given).sum() == int(words[0])


@pytest.mark.parametrize("name", ["confidence", "entropy"])
@pytest.mark.parametrize("value", [math.nan, -0.1, 1.5])
def test_shares_of_a_classifier_are_shares(name, value):
    given = {"classification": [2, 2], "confidence": [1.0, 1.0], "entropy": [0.0, 0.0], name: [0.5, value]}
    here = SimpleNamespace(rows=lambda: Table({"x": np.zeros(2)}))
    with pytest.raises(InputError, match=f"{name} is no share"):
        OfRows("classify", lambda table: given)(here, (ClassDef("ground", 2, (2,)),))


@pytest.mark.parametrize("kind", ["link", "link to a directory", "second name", "pipe"])
def test_a_delivery_takes_regular_files_alone(tmp_path, kind):
    """The file that a link led to was made read-only, and the delivery held the link."""
    (tmp_path / "mine").write_text("x")
    (tmp_path / "out").mkdir()

    def write(table, directory, tile):
        (directory / f"{tile}.txt").write_text("x")
        there = directory / f"{tile}.csv"
        {
            "link": lambda: there.symlink_to(tmp_path / "mine"),
            "link to a directory": lambda: there.symlink_to(tmp_path),
            "second name": lambda: there.hardlink_to(tmp_path / "mine"),
            "pipe": lambda: os.mkfifo(there),
        }[kind]()

    here = SimpleNamespace(directory=tmp_path / "out", part="1_2", rows=lambda: Table({"x": np.zeros(3)}))
    with pytest.raises(InputError, match="files of its own"):
        OfDelivery("d", write)(here)


@pytest.mark.parametrize("name", ["logs/1_2.txt", "store/1_2.csv", "vectors/1_2.parquet", "all.csv"])
def test_files_of_a_tile_lie_where_nothing_of_the_program_does(tmp_path, name):
    """The run ended by `IsADirectoryError` once all of it was made: the link to the delivery met the run's own logs."""

    def write(table, directory, tile):
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_text("x")

    here = SimpleNamespace(directory=tmp_path, part="1_2", rows=lambda: Table({"x": np.zeros(3)}))
    with pytest.raises(InputError, match="a name that another may have"):
        OfDelivery("d", write)(here)


def test_files_of_one_name_by_two_stages_are_refused(tmp_path, monkeypatch):
    """The later one's took the place of the other's, and nothing told."""

    def raster(inputs, directory):
        (directory / "rasters").mkdir()
        (directory / "rasters" / "all.tif").write_text("mine")
        return {}

    tasks = [*smallgraph.tasks("a", "text"), Task("mine", "all", 1, {}, raster, place="deliver")]
    monkeypatch.setattr(smallgraph, "tasks", lambda *words: tasks)
    (tmp_path / "source").write_text("x")
    with pytest.raises(StoreError, match="files of one name"):
        smallgraph.run(tmp_path / "run", tmp_path / "source", "a", "text")


def test_a_classifier_of_ones_own_refuses_neighbours_that_agree(survey, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        HEAD + "def g(table):\n    return np.full(table.rows, 7)\n"
        "workflow = classification.without_training().with_stage_instead(classifier_stage(g, ('z',)))"
    )
    with pytest.raises(ConfigError, match="knows no neighbours that agree"):
        walk(survey, tmp_path / "run", "classify.regularize.strength=0.1", workflow=str(path))


@pytest.mark.slow
def test_a_stage_may_read_a_feature_of_the_program(survey, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        HEAD
        + "def g(chunk):\n    return {'my': chunk.table['height_std_c150'][chunk.core] * 2}\n"
        + PUT.format("g, reads=('height_std_c150',)")
    )
    runner, _ = walk(survey, tmp_path / "run", "survey.features=[zc, my]", workflow=str(path))
    assert not runner.failures, runner.failures
