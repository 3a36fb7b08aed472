"""Plans that are not held: tasks are made when there is room for them."""

from __future__ import annotations

import weakref
from collections import Counter
from functools import partial

from fwclass.run import part
from fwclass.run.cluster import Cluster
from fwclass.run.local import Loop
from fwclass.run.part import Task
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.run.tasks import Tasks

WINDOW = 8


def nothing(fails, inputs, directory):
    (directory / "nothing.txt").write_text("x")
    if fails:
        raise ValueError("on purpose")
    return {}


class Made:
    """Counts the tasks that are alive."""

    def __init__(self, fails=()):
        self.alive = weakref.WeakSet()
        self.most = 0
        self.fails = frozenset(fails)

    def first(self, key):
        return self._kept(Task("first", f"{key}", 1, {}, partial(nothing, key in self.fails)))

    def second(self, key):
        return self._kept(Task("second", f"{key}", 1, {}, partial(nothing, False), needs=(("first", f"{key}"),)))

    def _kept(self, task):
        self.alive.add(task.work)
        self.most = max(self.most, len(self.alive))
        return task

    def plan(self, n):
        return Tasks.of("first", range(n), self.first) + Tasks.of("second", range(n), self.second)


def walked(root, executor, tasks):
    with Display() as display:
        runner = Runner(root, executor, display)
        return runner, runner.do(tasks)


def test_the_loop_holds_one_task(tmp_path):
    made = Made()
    runner, done = walked(tmp_path, Loop(), made.plan(200))
    assert len(done) == 400 and made.most <= 3
    assert Counter(o.status for o in runner.outcomes.values()) == {"computed": 400}
    again, _ = walked(tmp_path, Loop(), made.plan(200))
    assert Counter(o.status for o in again.outcomes.values()) == {"skipped": 400} and made.most <= 3


def test_what_a_part_needs_is_not_looked_at_before_it_was_ever_made(tmp_path, monkeypatch):
    """It was a third of what a run's driver does: each receipt was read and checked there once more."""
    looked, reckon = [], part.key_now
    monkeypatch.setattr(part, "key_now", lambda task, store: (looked.append(task.name), reckon(task, store))[1])
    _, done = walked(tmp_path, Loop(), Made().plan(5))
    assert len(done) == 10 and not looked
    again, _ = walked(tmp_path, Loop(), Made().plan(5))
    assert len(looked) == 10 and {o.status for o in again.outcomes.values()} == {"skipped"}


def test_the_cluster_knows_a_window_and_failures_block_what_follows(tmp_path):
    made = Made(fails={3, 57})
    with Cluster(None, 2, 2.0, WINDOW) as cluster:
        runner, done = walked(tmp_path, cluster, made.plan(60))
    assert made.most <= WINDOW + 2
    assert {n for n, o in runner.outcomes.items() if o.status == "failed"} == {("first", "3"), ("first", "57")}
    assert {n for n, o in runner.outcomes.items() if o.status == "blocked"} == {("second", "3"), ("second", "57")}
    assert len(done) == 116 and ("first", "3") not in done


def test_tasks_behave_as_a_sequence():
    made = Made()
    plan = made.plan(3) + Tasks.held([made.first(9)])
    assert len(plan) == 7 and plan.stages == {"first": 4, "second": 3}
    assert [t.name for t in plan][-2:] == [("second", "2"), ("first", "9")] == [plan[5].name, plan[-1].name]
    assert [t.name for t in plan[2:4]] == [("first", "2"), ("second", "0")]
