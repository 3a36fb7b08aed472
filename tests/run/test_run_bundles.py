"""Short parts go to a worker together, and each comes back as if it had gone by itself."""

from __future__ import annotations

import os
import signal
from functools import partial
from pathlib import Path

import pytest

from fwclass.run import bundles
from fwclass.run.bundles import Bundles
from fwclass.run.cluster import Cluster
from fwclass.run.part import Outcome, Task
from fwclass.store.run_store import Store


def task(stage: str, part: int, *needs: tuple[str, str]) -> Task:
    return Task(stage, str(part), 1, {}, partial(quick), needs)


def quick(inputs: object, directory: Path) -> dict[str, object]:
    return {}


def sizes(known: Bundles, tasks: list[Task]) -> list[int]:
    parts = list(known.of(tasks))
    assert [t for bundle in parts for t in bundle] == tasks
    return [len(bundle) for bundle in parts]


def noted(workers: int, **seconds: float) -> Bundles:
    known = Bundles(workers, 2000)
    for stage, each in seconds.items():
        for part in range(bundles.ENOUGH):
            known.note(Outcome(stage, str(part), "computed", each, processor=each))
    return known


def test_nothing_goes_together_before_it_is_known_what_a_part_takes():
    assert sizes(Bundles(2, 2000), [task("a", k) for k in range(5)]) == [1] * 5


def test_what_a_part_takes_is_waited_for():
    known, under_way = Bundles(2, 2000), 0
    for bundle in known.of(task("a", k) for k in range(100)):
        assert len(bundle) == 1
        under_way += 1
        if known.waits:
            break
    assert under_way == 2 * bundles.UNKNOWN
    for _ in range(bundles.ENOUGH):
        known.note(Outcome("a", "0", "failed", 0.009, processor=0.009))
    assert not known.waits and sizes(known, [task("a", k) for k in range(44)]) == [22, 22]


def test_parts_that_are_not_made_tell_nothing_of_those_that_are():
    """Else some that are blocked would send 64 long ones to one worker."""
    known = Bundles(2, 2000)
    assert sizes(known, [task("a", k) for k in range(16)]) == [1] * 16 and known.waits
    for _ in range(8):
        known.note(Outcome("a", "0", "blocked"))
        known.note(Outcome("a", "0", "skipped"))
    assert not known.waits and sizes(known, [task("a", k) for k in range(5)]) == [1] * 5


@pytest.mark.parametrize(("each", "size"), [(0.0001, 64), (0.009, 22), (0.07, 2), (0.15, 1), (3.0, 1)])
def test_as_many_go_together_as_take_a_fifth_of_a_second(each: float, size: int):
    assert set(sizes(noted(2, a=each), [task("a", k) for k in range(640)])) <= {size, 640 % size or size}


def test_what_waits_goes_together_by_the_processor_that_it_takes():
    """Parts of 9 ms take 40 by the clock on a busy machine: they went by fours. No bundle takes a second there."""
    known = Bundles(2, 2000)
    for part in range(bundles.ENOUGH):
        known.note(Outcome("a", str(part), "computed", 0.04, processor=0.009))
        known.note(Outcome("b", str(part), "computed", 0.3, processor=0.009))
    assert sizes(known, [task("a", k) for k in range(44)]) == [22, 22]
    assert sizes(known, [task("b", k) for k in range(6)]) == [3, 3]


def test_first_parts_that_load_and_compile_are_soon_forgotten():
    known = Bundles(2, 2000)
    for part in range(2):
        known.note(Outcome("a", str(part), "computed", 2.0, processor=2.0))
    for part in range(60):
        known.note(Outcome("a", str(part), "computed", 0.01, processor=0.01))
    assert sizes(known, [task("a", k) for k in range(38)])[0] > 15


def test_a_large_cluster_gets_more_at_a_time():
    """And no worker gets all that a window holds."""
    assert sizes(noted(50, a=0.001), [task("a", k) for k in range(20)]) == [10, 10]
    assert sizes(noted(50, a=0.19), [task("a", k) for k in range(10)]) == [5, 5]


def test_a_stage_that_is_new_takes_what_those_that_it_needs_took():
    later = [task("b", k, ("a", str(k))) for k in range(40)]
    assert sizes(noted(2, a=0.009), later) == [22, 18]
    known = noted(2, a=0.01, c=1.0)
    assert sizes(known, [task("b", k, ("a", "0"), ("c", "0")) for k in range(4)]) == [1] * 4


def test_stages_do_not_mix_and_no_part_goes_with_one_that_it_needs():
    known = noted(2, a=0.001, b=0.001)
    assert sizes(known, [task("a", 0), task("a", 1), task("b", 0), task("a", 2)]) == [2, 1, 1]
    assert sizes(known, [task("a", 0), task("a", 1, ("a", "0")), task("a", 2)]) == [1, 2]


def once(inputs: object, directory: Path, name: str) -> dict[str, object]:
    """End the worker that comes here first."""
    mark = directory.parents[3] / name
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {}


def wrong(inputs: object, directory: Path) -> dict[str, object]:
    raise ValueError("no")


def test_of_a_bundle_whose_worker_is_killed_only_the_part_that_was_under_way_is_lost(tmp_path: Path):
    """As is one that fails, and what needs it."""
    first = [task("a", k) for k in range(100)]
    first[80] = Task("a", "80", 1, {}, partial(once, name="mark"))
    first[90] = Task("a", "90", 1, {}, partial(wrong))
    tasks = [*first, *(task("b", k, ("a", str(k))) for k in range(100))]
    sent = []

    class Counting(Cluster):
        def submit(self, location, tasks, upstream, alone):
            sent.append(len(tasks))
            return super().submit(location, tasks, upstream, alone)

    with Counting(None, 2, 1.0, 100) as cluster:
        ended = {(o.stage, o.part): o for o in cluster.run(tmp_path, tasks)}
    assert max(sent) > 5 and len(ended) == len(tasks)
    assert {n for n, o in ended.items() if o.lost} == {("a", "80")}
    assert {n: o.status for n, o in ended.items() if not o.ok} == {("a", "90"): "failed", ("b", "90"): "blocked"}
    store = Store(tmp_path)
    assert all(store.receipt(*name) for name, o in ended.items() if o.ok)
