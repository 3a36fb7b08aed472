"""How parts stand: done, stale and why, missing, running, failed; looked at without making anything."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import time

import laspy
import pytest
from runmaker import SETTINGS, walk

from fwclass import conf
from fwclass.errors import ConfigError, InputError, LockedError, PartialError, StoreError
from fwclass.operate.request import Request
from fwclass.operate.seams.walk import check_idle
from fwclass.operate.status.replay import task_alone
from fwclass.operate.status.summary import as_data, as_text
from fwclass.operate.status.walk import look_at
from fwclass.operate.status.why import differences
from fwclass.run.cluster import Cluster
from fwclass.run.local import Loop
from fwclass.run.part import Task
from fwclass.run.progress import Display
from fwclass.run.runner import Runner, require_all
from fwclass.store.atomic import write_text
from fwclass.store.external_file import ExternalFile
from fwclass.store.lock import holder, holder_text, writer
from fwclass.workflows import WORKFLOWS


def written(text):
    def work(inputs, directory):
        (directory / "a").write_text(text)
        return {}

    return work


def broken(inputs, directory):
    raise InputError("no oil", where="tank", do="fill it")


def flow(*tasks):
    """A workflow of one batch."""

    def run(runner):
        runner.do(tasks)
        runner.finish(whole=False)

    return run


def made(root, *tasks, **settings):
    runner = Runner(root, Loop(), Display(), **settings)
    flow(*tasks)(runner)
    return runner


def seen(root, *tasks):
    """(standing, reasons) of every part."""
    looked = look_at(root, flow(*tasks))
    return {"/".join(n): (s.standing, [r.text for r in s.reasons]) for n, s in looked.states.items()}


def pair(text="x", version=1, params=None, file="d1"):
    """A part that reads a file, and one that reads it."""
    first = Task("one", "a", version, params or {"cell": 0.5}, written(text), external=(ExternalFile("a.las", file),))
    return first, Task("two", "a", 1, {}, written("y"), needs=(("one", "a"),))


def everything_below(root):
    return {p: (p.stat().st_mtime_ns, p.stat().st_size) for p in [root, *root.rglob("*")]}


def test_nothing_made_all_made_and_lost(tmp_path):
    nothing = ("missing", ["nothing of input a.las is there"])
    assert seen(tmp_path, *pair()) == {"one/a": nothing, "two/a": ("missing", ["needs one/a, missing"])}
    assert list(tmp_path.iterdir()) == []
    made(tmp_path, *pair())
    assert {s for s, _ in seen(tmp_path, *pair()).values()} == {"done"}
    shutil.rmtree(tmp_path / "store" / "one")
    assert seen(tmp_path, *pair()) == {"one/a": nothing, "two/a": ("stale", ["needs one/a, missing"])}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"params": {"cell": 1.0}}, "parameter cell: 0.5 to 1.0"),
        ({"version": 2}, "the code of one changed: version 1 to 2"),
        ({"file": "d2"}, "input a.las changed"),
    ],
)
def test_a_change_is_named_and_what_follows_waits(tmp_path, change, reason):
    made(tmp_path, *pair())
    assert seen(tmp_path, *pair(**change)) == {"one/a": ("stale", [reason]), "two/a": ("stale", ["needs one/a, stale"])}


def test_a_part_made_anew_a_new_one_and_one_that_is_gone(tmp_path):
    first, follow = pair()
    made(tmp_path, first, follow)
    made(tmp_path, pair("z", version=2)[0])
    assert seen(tmp_path, pair(version=2)[0], follow)["two/a"] == ("stale", ["one/a was made anew"])
    other = Task("one", "b", 1, {}, written("b"))
    made(tmp_path, other)
    read = Task("two", "a", 1, {}, written("y"), needs=(("one", "b"),))
    assert seen(tmp_path, other, read)["two/a"] == ("stale", ["one/b is read now", "one/a is no longer read (a.las)"])


def test_a_lost_and_a_cut_file(tmp_path):
    made(tmp_path, *pair())
    found = next((tmp_path / "store" / "one" / "a").glob("*/a"))
    found.write_text("more")
    assert seen(tmp_path, *pair())["one/a"] == ("stale", ["its file a has 4 bytes, not 1"])
    found.unlink()
    assert seen(tmp_path, *pair())["one/a"] == ("stale", ["its file a is gone"])


def test_a_receipt_that_tells_no_parameters(tmp_path):
    made(tmp_path, *pair())
    path = tmp_path / "store" / "one" / "a" / "receipt.json"
    receipt = json.loads(path.read_text())
    del receipt["version"], receipt["params"], receipt["seal"]
    path.write_text(json.dumps(receipt))
    assert seen(tmp_path, *pair())["one/a"][0] == "done"
    standing, why = seen(tmp_path, *pair(params={"cell": 2.0}))["one/a"]
    assert standing == "stale" and "earlier version" in why[0]
    assert seen(tmp_path, *pair(file="d2"))["one/a"] == ("stale", ["input a.las changed"])


def test_a_failed_part_keeps_its_words_until_it_is_made(tmp_path):
    bad = Task("one", "a", 1, {}, broken)
    follow = Task("two", "a", 1, {}, written("y"), needs=(("one", "a"),))
    made(tmp_path, bad, follow)
    looked = look_at(tmp_path, flow(bad, follow))
    assert looked.states["one", "a"].standing == "failed" and "fill it" in looked.states["one", "a"].message
    assert looked.states["two", "a"].standing == "missing"
    changed = Task("one", "a", 1, {"cell": 1.0}, broken)
    assert seen(tmp_path, changed)["one/a"] == ("missing", ["it failed before, from other inputs or parameters"])
    assert seen(tmp_path, bad)["one/a"][0] == "failed"
    mended = Task("one", "a", 1, {}, written("x"))
    made(tmp_path, mended, follow)
    assert {s for s, _ in seen(tmp_path, mended, follow).values()} == {"done"}
    assert not list((tmp_path / "store" / "failures").rglob("*.json"))


def test_a_part_under_way_is_running_only_while_its_run_lives(tmp_path):
    found = []

    def looks(inputs, directory):
        found.append(seen(tmp_path, task)["one/a"][0])
        found.append(holder(tmp_path))
        return {}

    task = Task("one", "a", 1, {}, looks)
    with writer(tmp_path):
        made(tmp_path, task)
    assert found[0] == "running" and found[1]["pid"] > 0
    assert holder(tmp_path) is None
    (tmp_path / "store" / "staging" / "left" / "one" / "b").mkdir(parents=True)
    left = Task("one", "b", 1, {}, written("b"))
    assert seen(tmp_path, left)["one/b"][0] == "missing"
    (tmp_path / "store" / "lock").write_text(json.dumps({"host": "elsewhere", "pid": 1}))
    assert seen(tmp_path, left)["one/b"][0] == "running"


def test_a_name_left_by_a_killed_run_is_not_believed(tmp_path):
    with writer(tmp_path):
        text = (tmp_path / "store" / "lock").read_text()
    (tmp_path / "store" / "lock").write_text(text)
    assert holder(tmp_path) is None
    with writer(tmp_path):
        assert holder(tmp_path) is not None


@contextlib.contextmanager
def full_disk():
    """No file may grow, not by a byte."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_writer_without_room_for_its_name_is_told_and_keeps_others_out(tmp_path):
    """The lock held, and `status`, `seams` and schedules said that nobody was there."""
    task = Task("one", "a", 1, {}, written("a"))
    with contextlib.ExitStack() as first:
        with full_disk():
            first.enter_context(writer(tmp_path))
        assert not (tmp_path / "store" / "lock").read_bytes()
        assert holder(tmp_path) and "did not leave its name" in holder_text(holder(tmp_path))
        (tmp_path / "store" / "staging" / "left" / "one" / "a").mkdir(parents=True)
        assert seen(tmp_path, task)["one/a"][0] == "running"
        with pytest.raises(StoreError, match="a run is writing"):
            check_idle(tmp_path)
        with pytest.raises(LockedError, match="another run is writing"), writer(tmp_path):
            pass
    assert holder(tmp_path) is None and not (tmp_path / "store" / "lock").read_bytes()
    with writer(tmp_path):
        assert holder(tmp_path)["pid"] == os.getpid()


def test_a_full_disk_is_told_with_its_place(tmp_path):
    """Small files of the store, such as the words of a run, were written without saying where."""
    with full_disk(), pytest.raises(OSError) as fault:
        write_text(tmp_path / "run.json", "{}")
    assert fault.value.filename == str(tmp_path / "run.json") and not list(tmp_path.iterdir())


def test_the_plan_ends_where_what_follows_is_not_known(tmp_path):
    first, follow = pair()

    def run(runner):
        require_all(runner, [first])
        runner.do([follow])
        runner.finish(whole=True)

    looked = look_at(tmp_path, run)
    assert looked.ends == "one/a is missing" and set(looked.states) == {("one", "a")} and not looked.all_done
    made(tmp_path, first, follow)
    assert look_at(tmp_path, run).all_done


def test_fail_fast_stops_and_keep_going_does_not(tmp_path):
    bad, good = Task("one", "a", 1, {}, broken), Task("one", "b", 1, {}, written("b"))
    with pytest.raises(PartialError, match="first part that failed"):
        made(tmp_path / "fast", bad, good, fail_fast=True)
    assert seen(tmp_path / "fast", bad, good)["one/b"][0] == "missing"
    runner = made(tmp_path / "on", bad, good)
    assert [o.part for o in runner.failures] == ["a"]
    assert seen(tmp_path / "on", bad, good)["one/b"][0] == "done"


def test_fail_fast_begins_nothing_more_on_a_cluster(tmp_path):
    def slow(inputs, directory):
        time.sleep(0.3)
        return {}

    def fails(inputs, directory):
        raise RuntimeError("no oil")

    tasks = [Task("one", "a", 1, {}, fails), *(Task("one", f"b{k}", 1, {}, slow) for k in range(12))]
    with Cluster(None, 1, 1.0, 1000) as cluster:
        runner = Runner(tmp_path, cluster, Display(), fail_fast=True)
        with pytest.raises(PartialError):
            runner.do(tasks)
    standings = [s for s, _ in seen(tmp_path, *tasks).values()]
    assert standings[0] == "failed" and standings.count("done") < 6


def test_one_part_alone_needs_what_it_reads(tmp_path):
    request = Request("c.yaml", str(tmp_path), ("a.b=1 2",))
    first, follow = pair()
    looked = look_at(tmp_path, flow(first, follow))
    assert task_alone(looked, "one/a", request) is first
    with pytest.raises(InputError, match=r"--set 'a\.b=1 2' --only one/a"):
        task_alone(looked, "two/a", request)
    for text, said in (("tow/a", "did you mean 'two'"), ("one/z", "for example a")):
        with pytest.raises(ConfigError, match=said):
            task_alone(looked, text, request)


def test_the_table_and_the_data_say_the_same(tmp_path):
    tasks = [Task("one", f"{k}", 1, {"cell": 1}, written("x")) for k in range(6)]
    made(tmp_path, *tasks, Task("old", "a", 1, {}, written("o")))
    now = [Task("one", t.part, 1, {"cell": 2}, broken) for t in tasks]
    looked, request = look_at(tmp_path, flow(*now)), Request("c.yaml", str(tmp_path))
    data = as_data(looked, request, None, every=False)
    assert data["stages"] == [
        {"stage": "one", "parts": 6, "done": 0, "stale": 6, "missing": 0, "running": 0, "failed": 0}
    ]
    assert {p["why"][0] for p in data["parts"]} == {"parameter cell: 1 to 2"} and len(data["parts"]) == 6
    assert data["not_in_plan"] == {"old": 1} and not data["done"]
    text = as_text(looked, request, None, every=False)
    assert "stale    one: 0, 1, 2, 3 and 2 more" in text and text.count("parameter cell: 1 to 2") == 1
    assert as_text(looked, request, None, every=True).count("parameter cell: 1 to 2") == 6
    made(tmp_path, *now)
    looked = look_at(tmp_path, flow(*now))
    text = as_text(looked, request, None, every=False)
    assert "fill it" in text and f"fwclass run c.yaml --out {tmp_path} --only one/5" in text


def test_differences_in_words():
    then = {"a": 1, "b": {"c": [1, 2], "d": None}, "names": ["x", "y"], "k": [{"code": 2}], "gone": 1}
    now = {"a": 1, "b": {"c": [2, 1], "d": 0.5}, "names": ["x", "z"], "k": [{"code": 3}], "new": "v" * 99}
    told = differences(then, now)
    assert told[:5] == [
        "b.c: in another order",
        "b.d: null to 0.5",
        "gone: 1 is gone",
        "k[0].code: 2 to 3",
        "names: now without y and with z",
    ]
    assert told[5].startswith("new: vvv") and len(told[5]) < 70
    assert differences(then, then) == []


def looked_at(survey, root, *settings):
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", *settings))
    return look_at(root, lambda runner: WORKFLOWS["classification"](config, runner, None))


def test_a_whole_run_is_done_and_looking_writes_nothing(survey, finished):
    before = everything_below(finished[0])
    assert looked_at(survey, finished[0]).all_done
    assert everything_below(finished[0]) == before


def test_a_run_makes_what_was_told_to_be_stale_and_no_more(survey, finished, tmp_path):
    """What waits for a stale part may come out as it was; what is stale of itself is made."""
    root = tmp_path / "copy"
    shutil.copytree(finished[0], root, symlinks=True)
    looked = looked_at(survey, root, "train.trees=11", "label.max_distance=0.4")
    left = {n: s for n, s in looked.states.items() if s.standing != "done"}
    own = {n for n, s in left.items() if not any(r.text.startswith("needs ") for r in s.reasons)}
    assert {"label", "trees"} <= {stage for stage, _ in left} and "features" not in {stage for stage, _ in left}
    assert {r.text for n in own if n[0] == "label" for r in left[n].reasons} == {
        f"parameter max_distance: {conf.load('demo').label.max_distance} to 0.4"
    }
    runner, _ = walk(survey, root, "train.trees=11", "label.max_distance=0.4")
    computed = {n for n, o in runner.outcomes.items() if o.status == "computed"}
    assert own <= computed <= left.keys()
    assert looked_at(survey, root, "train.trees=11", "label.max_distance=0.4").all_done


def test_a_changed_source_file_is_named(survey, finished, tmp_path):
    other = tmp_path / "survey"
    shutil.copytree(survey, other)
    first, second = sorted((other / "strips").glob("*.las"))
    assert looked_at(other, finished[0]).all_done  # the same bytes in another place, which have to be read
    with laspy.open(first) as source:
        at = source.header.offset_to_point_data + 12  # intensity of the first point
    content = bytearray(first.read_bytes())
    content[at] ^= 1
    first.write_bytes(content)
    states = looked_at(other, finished[0]).states
    touched = {"/".join(n) for n, s in states.items() if any(f"input {first.name}" in r.text for r in s.reasons)}
    assert "index/00001" in touched
    assert {t.split("/")[0] for t in touched} == {"index", "read", "publish-strip"}
    assert not any(f"input {second.name}" in r.text for s in states.values() for r in s.reasons)
    assert states["index", "00002"].standing == "done"
    assert "stale" in {s.standing for (stage, _), s in states.items() if stage == "tile"}
