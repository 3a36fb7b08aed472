"""Re-runs: done parts are skipped, changed ones and what follows them are made again, broken ones are told."""

import json
import os
import re
import shutil
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from runmaker import SETTINGS, delivered, shifted_reference, walk

from fwclass import conf
from fwclass.errors import ConfigError, InputError, StoreError
from fwclass.run.local import Loop, WhenNeeded
from fwclass.run.part import Task
from fwclass.run.progress import Display
from fwclass.run.runner import Done, Runner, require_all


def statuses(runner):
    found = {}
    for outcome in runner.outcomes.values():
        found.setdefault(outcome.stage, set()).add(outcome.status)
    return found


@pytest.fixture
def copy(finished, tmp_path):
    root = tmp_path / "copy"
    shutil.copytree(finished[0], root, symlinks=True)
    return root


def test_a_second_run_makes_nothing(survey, copy):
    runner, _ = walk(survey, copy)
    assert {s for found in statuses(runner).values() for s in found} == {"skipped"}


@pytest.mark.slow
def test_a_changed_parameter_re_runs_its_stage_and_what_follows(survey, copy, tmp_path):
    runner, _ = walk(survey, copy, "train.trees=11")
    found = statuses(runner)
    for stage in ("read", "decompose", "tile", "ground-filter", "ground", "terrain", "height", "features", "label"):
        assert found[stage] == {"skipped"}, stage
    assert "computed" in found["trees"] and found["train"] == found["classify"] == {"computed"}
    fresh, _ = walk(survey, tmp_path / "fresh", "train.trees=11")
    assert not fresh.failures
    assert delivered(copy) == delivered(tmp_path / "fresh")


def test_lost_and_damaged_parts_are_made_again(survey, copy, finished):
    shutil.rmtree(next((copy / "store" / "features").iterdir()))
    victim = next((copy / "laz" / "tiles").iterdir())
    victim.write_bytes(b"")
    runner, _ = walk(survey, copy)
    assert not runner.failures
    assert "computed" in statuses(runner)["features"]
    assert delivered(copy) == delivered(finished[0])


@pytest.mark.slow
def test_a_model_of_another_run_classifies_without_labels(survey, finished, tmp_path):
    root = finished[0]
    given = (f"survey.model={root / 'model'}", "survey.reference={kind: none, files: []}", "areas.train=[]")
    runner, report = walk(survey, tmp_path, *given)
    assert not runner.failures and report["accuracy"] is None
    assert "sample" not in statuses(runner) and "trees" not in statuses(runner)
    before, after = delivered(root), delivered(tmp_path)
    both = {n: d for n, d in before.items() if not n.startswith("model/") and n != "tiles.gpkg"}  # areas, accuracy
    assert {n: d for n, d in after.items() if n != "tiles.gpkg"} == both
    (tmp_path / "bad").mkdir()
    with pytest.raises(InputError, match="not a model"):
        walk(survey, tmp_path / "run", f"survey.model={tmp_path / 'bad'}")


def test_chosen_tiles_of_a_finished_run_are_reported_alone(survey, finished, copy):
    key = sorted(n for n in delivered(finished[0]) if n.startswith("parquet/"))[0].split("/")[1].split(".")[0]
    runner, report = walk(survey, copy, tiles=frozenset({key}))
    assert statuses(runner)["publish-tile"] == {"skipped"} and not report["whole"]
    assert report["outputs"]["laz"] == [f"laz/tiles/{key}.copc.laz"] and not report["outputs"]["rasters"]
    assert delivered(copy) == delivered(finished[0])  # it lies aside


def test_chosen_tiles_come_out_as_in_a_whole_run(survey, finished, tmp_path):
    whole = delivered(finished[0])
    key = sorted(n for n in whole if n.startswith("parquet/"))[0].split("/")[1].split(".")[0]
    runner, _ = walk(survey, tmp_path, tiles=frozenset({key}))
    assert not runner.failures
    part = delivered(tmp_path)
    assert {n for n in part if "model" not in n} == {f"parquet/{key}.parquet", f"laz/tiles/{key}.copc.laz"}
    assert part == {n: whole[n] for n in part}
    with pytest.raises(ConfigError, match="no such tile"):
        walk(survey, tmp_path, tiles=frozenset({"1_1"}))


@pytest.mark.slow
def test_another_tiling_leaves_nothing_of_the_old_one(survey, copy, tmp_path):
    walk(survey, copy, "tile.size=1000")
    walk(survey, tmp_path / "fresh", "tile.size=1000")
    assert delivered(copy) == delivered(tmp_path / "fresh")
    assert {p.name for p in (copy / "store" / "tile").iterdir()} == {
        p.name for p in (tmp_path / "fresh" / "store" / "tile").iterdir()
    }


def test_a_part_that_fails_stops_only_what_needs_it(tmp_path):
    def work(inputs, directory):
        (directory / "a").write_text("a")
        return {}

    def broken(inputs, directory):
        raise RuntimeError("disk on fire")

    tasks = [
        Task("one", "a", 1, {}, work),
        Task("one", "b", 1, {}, broken),
        Task("two", "a", 1, {}, work, needs=(("one", "a"),)),
        Task("two", "b", 1, {}, work, needs=(("one", "b"),)),
    ]
    runner = Runner(tmp_path, Loop(), Display())
    done = runner.do(tasks)
    assert set(done) == {("one", "a"), ("two", "a")}
    assert {n: o.status for n, o in runner.outcomes.items() if not o.ok} == {
        ("one", "b"): "failed",
        ("two", "b"): "blocked",
    }
    assert "disk on fire" in runner.failures[0].message
    assert "disk on fire" in (tmp_path / "logs" / "one" / "b.log").read_text()


def test_a_failure_is_told_once(tmp_path, capsys):
    """Parts that fail alike, and the error that ends the run, do not repeat what stands above."""

    def broken(inputs, directory):
        raise InputError("no oil", where="tank", do="fill it")

    runner = Runner(tmp_path, Loop(), Display())
    with pytest.raises(InputError, match="no oil") as ended:
        require_all(runner, [Task("one", part, 1, {}, broken) for part in "abc"])
    shown = capsys.readouterr().err
    assert shown.count("fill it") == 1 and shown.count("as above") == 2
    assert "fill it" not in str(ended.value)


def test_a_failure_of_today_does_not_let_yesterdays_part_through(tmp_path):
    """If the source of a part breaks, a part that read its older version must not count as done."""

    def work(inputs, directory):
        (directory / "a").write_text("a")
        return {}

    def broken(inputs, directory):
        raise RuntimeError

    follow = Task("two", "a", 1, {}, work, needs=(("one", "a"),))
    assert len(Runner(tmp_path, Loop(), Display()).do([Task("one", "a", 1, {}, work), follow])) == 2
    runner = Runner(tmp_path, Loop(), Display())
    assert runner.do([Task("one", "a", 2, {}, broken), follow]) == {}


def test_reference_of_another_place_is_refused(survey, tmp_path):
    shifted_reference(survey, tmp_path / "far.las")
    with pytest.raises(InputError, match="another place"):
        walk(survey, tmp_path / "run", f"survey.reference.files=['{os.path.relpath(tmp_path / 'far.las', survey)}']")


def test_the_report_is_whole(finished):
    root, report = finished
    assert json.loads((root / "report.json").read_text())["accuracy"] == report["accuracy"]
    page = (root / "report.html").read_text()
    assert not re.search(r"(src|href)\s*=\s*[\"']?(https?:)?//", page)
    assert "vegetation" in page


def test_settings_that_cannot_be_are_refused():
    with pytest.raises(ConfigError, match="did you mean 'slope'"):
        conf.load("demo", (*SETTINGS, "ground.slopp=1"))


def test_workers_start_for_the_first_part_and_never_for_none(tmp_path):
    """And they end with the run."""
    states = []

    @contextmanager
    def workers():
        states.append("started")
        yield Loop()
        states.append("ended")

    def work(inputs, directory):
        (directory / "made.txt").write_text("x")
        return {}

    tasks = [Task("one", part, 1, {}, work) for part in "abc"]
    for expected in (["started", "ended"], ["started", "ended"]):  # the second time nothing is left to do
        with WhenNeeded(workers) as executor, Display() as display:
            runner = Runner(tmp_path, executor, display)
            assert len(runner.do(tasks[:2])) == 2 and len(runner.do(tasks)) == 3
        assert states == expected


def test_a_receipt_that_goes_while_a_run_is_under_way_is_told():
    """A server of objects may say that it has written, and not have: it ended with a KeyError."""
    done = Done(SimpleNamespace(receipt=lambda *_: None, where="s3://b/run"), [("tile", "1_2")])
    with pytest.raises(StoreError, match="receipt of a part that was finished is gone"):
        done["tile", "1_2"]
    with pytest.raises(KeyError):
        done["tile", "3_4"]
