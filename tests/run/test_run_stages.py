"""The one list of stages: what a run does, what `plan` tells, and what a record must say."""

import ast
import inspect
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from fwclass import conf
from fwclass.errors import FwclassError
from fwclass.graph import stages
from fwclass.graph.assess import ASSESS
from fwclass.graph.base_rows import CHOOSE_BASE_ROWS
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.graph.ground_classes import CLASSIFY_GROUND
from fwclass.graph.key_values import plain_values
from fwclass.graph.learn import TRY_MACHINES
from fwclass.graph.stage import Plan
from fwclass.graph.stage_work import StageInputs, Work
from fwclass.graph.stages import OF_NOISE, OF_STRIPS, STAGES, TO_TILES, graph_of, providers
from fwclass.graph.tiling import TILE_ECHOES
from fwclass.graph.training_rows import DRAW_SAMPLE, MERGE_SAMPLE
from fwclass.publish.stage_graph import drop_implied, stage_graph
from fwclass.schema import Table
from fwclass.train.params import TrainParams
from fwclass.walk import steps as walk
from fwclass.workflows import WORKFLOWS


def test_every_workflow_has_stages_of_the_list_in_its_order():
    place = {id(stage): k for k, stage in enumerate(STAGES)}
    for name in WORKFLOWS:
        if not WORKFLOWS[name].stages:  # of a street, which has no echoes
            continue
        mine = [place[id(stage)] for stage in WORKFLOWS[name].stages]
        every = [k for k, stage in enumerate(STAGES) if stage not in (CLASSIFY_GROUND, *OF_NOISE)]
        assert sorted(mine) == every or (name in ("backscatter", "ground", "quality") and len(set(mine)) == len(mine))


def test_every_stage_has_a_cost():
    """A stage that nobody told `plan` of cannot exist."""
    costs = conf.load("demo", ()).plan.stages
    planned = [workflow for workflow in WORKFLOWS.values() if workflow.stages]
    assert set(costs) == {stage.name for stage in (*STAGES, *(s for one in planned for s in one.study))}


def test_one_place_makes_tasks():
    """Studies, and the batch of street recordings, made 26 by hand, which neither `plan` nor the graph saw."""
    here = Path(inspect.getfile(stages)).parents[1]
    makers = [
        str(path.relative_to(here))
        for path in sorted(here.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Task"
    ]
    assert makers == ["graph/stage.py"]


def test_the_stages_of_a_study_come_in_their_order():
    for workflow in WORKFLOWS.values():
        names: list[str] = []
        for stage in workflow.all_stages:
            late = {one.name for one in workflow.all_stages} & set(stage.after) - {*names, stage.name}
            assert not late, (workflow.name, stage.name)
            names.append(stage.name)


def test_records_of_one_name_agree_on_what_plan_and_store_ask():
    by_name = {}
    for stage in STAGES:
        by_name.setdefault(stage.name, []).append(stage)
    for name, some in by_name.items():
        assert len({(s.over, s.place) for s in some}) == 1, name


def test_a_new_setting_enters_the_keys_of_what_learns():
    """Settings that change no byte stand by name: whatever was none of three was left out of the sample's key, so that
    a new one that chooses rows would have kept the old rows."""
    for path in sorted(Path(inspect.getfile(stages)).parent.glob("*.py")):
        assert "model_fields) -" not in path.read_text(), path
    for stage in (DRAW_SAMPLE, MERGE_SAMPLE, CHOOSE_BASE_ROWS, TRY_MACHINES):
        assert not stage.silent - {*TrainParams.model_fields, "c", "gamma"}, stage.name


def test_what_a_column_comes_from_follows_from_the_records():
    config = conf.load("demo", ())
    found = providers(Plan(config, computed=("zc", "height_range_c100")))
    assert found["x"] == "tile" and found["ground"] == "ground" and found["height_above_ground"] == "height"
    assert found["zc"] == found["height_range_c100"] == "features" and found["range"] == "radiometry"
    assert found["reference"] == "label" and found["classification"] == "classify" and "sampled" not in found


def test_a_version_that_is_raised_makes_another_task(tmp_path):
    """Raising the record did nothing once: the task had a number of its own."""
    for stage in (COMPUTE_FEATURES, ASSESS):
        plan = Plan(conf.load("demo", ()))
        raised = replace(stage, version=stage.version + 1, parts=lambda plan: (), when=lambda plan: True)
        assert raised.version == stage.version + 1
        simple = replace(stage, reads=(), own=(), needs=lambda plan, part: (), arguments=lambda plan: {}, halo=None)
        assert simple.task(plan, "all").version == stage.version
        assert replace(simple, version=99).task(plan, "all").version == 99


def test_all_that_a_function_gets_enters_the_key():
    config = conf.load("demo", ())
    told = plain_values({"params": config.features, "names": ("zc",), "also": 1}, frozenset({"also"}))
    assert told["names"] == ["zc"] and "also" not in told
    assert told["normal_radius"] == config.features.normal_radius
    with pytest.raises(TypeError, match="enter its key as normal_radius"):
        plain_values({"params": config.features, "normal_radius": 3.0})
    with pytest.raises(TypeError, match="cannot enter a key"):
        plain_values({"path": object()})


def test_functions_use_all_that_they_are_given():
    """What decides what a part reads, and nothing else, is `keyed`."""
    for function in {stage.function for stage in STAGES}:
        (definition,) = ast.parse(inspect.getsource(function)).body
        used = {node.id for line in definition.body for node in ast.walk(line) if isinstance(node, ast.Name)}
        asked = {a.arg for a in (*definition.args.args, *definition.args.kwonlyargs)}
        assert asked <= used, definition.name


def test_what_is_keyed_enters_the_key_and_no_argument():
    plan = WORKFLOWS["classification"].begin(conf.load("demo", ()))
    keyed = replace(
        TILE_ECHOES, parts=None, over="survey", needs=lambda plan, part: (), keyed=lambda plan: {"least": 2}
    )
    task = keyed.task(plan, "all")
    assert task.params["least"] == 2 and "least" not in task.work.arguments
    assert keyed.task(plan, "all").params != replace(keyed, keyed=lambda plan: {"least": 3}).task(plan, "all").params
    with pytest.raises(TypeError, match="enter its key as blocks"):
        replace(keyed, keyed=lambda plan: {"blocks": 1}).task(plan, "all")


def test_columns_that_the_record_does_not_name_are_refused(tmp_path):
    def function(here: StageInputs):
        return Table.empty(("z",))

    work = Work(function, {}, partial(StageInputs, part="0_0", writes=("x", "y")))
    with pytest.raises(FwclassError, match="other columns than its record"):
        work(None, tmp_path)


def test_the_graph_names_what_every_stage_reads():
    stages = graph_of(WORKFLOWS["classification"].begin(conf.load("demo", ())))
    reads = {s["name"]: s["reads"] for s in stages}
    assert reads["classify"] == ["tile", "height", "features", "train"]
    assert reads["terrain"] == ["tile", "ground"] and reads["split"] == ["decompose"]
    assert "thin" not in reads and "importance" not in reads  # this survey has neither
    place = {name: k for k, name in enumerate(reads)}
    assert all(place[s] < place[name] for name, some in reads.items() for s in some)


def test_an_edge_that_follows_from_others_is_not_drawn():
    assert drop_implied({"a": [], "b": ["a"], "c": ["a", "b"]}) == {"a": [], "b": ["a"], "c": ["b"]}
    drawn = stage_graph([{"name": "a", "over": "tile", "reads": []}, {"name": "c", "over": "survey", "reads": ["a"]}])
    assert [arc["title"] for arc in drawn["arcs"]] == ["a to c"] and [r["name"] for r in drawn["rows"]] == ["a", "c"]
    assert stage_graph([]) is None


def test_a_need_that_the_record_does_not_name_is_refused():
    stage = replace(ASSESS, needs=lambda plan, part: (("classify", "0_0"),), arguments=lambda plan: {})
    with pytest.raises(FwclassError, match="does not name"):
        stage.task(Plan(conf.load("demo", ())), "all")


def test_every_stage_before_the_tiles_is_made():
    """`until_tiles` makes them one after another, each by what the ones before it gave: it has to name a new one."""
    before = {name for name, value in vars(stages).items() if any(value is s for s in TO_TILES)}
    tree = ast.parse(inspect.getsource(walk))
    functions = {f.name: f for f in tree.body if isinstance(f, ast.FunctionDef)}
    named = {
        n.id
        for f in ("until_tiles", "_of_strips", "_strip_alone")
        for n in ast.walk(functions[f])
        if isinstance(n, ast.Name)
    }
    of_strips = {name for name, value in vars(stages).items() if any(value is s for s in OF_STRIPS)}
    assert before - of_strips <= named and "OF_STRIPS" in named, before - of_strips - named
