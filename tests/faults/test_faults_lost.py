"""Workers that are lost: which part is to blame, what is tried, and what is told."""

from __future__ import annotations

import pytest
from faultparts import crashing, greedy, hopeless, simple

from fwclass.run.cluster import Cluster
from fwclass.run.lost import MEMORY
from fwclass.run.part import Task

pytestmark = [pytest.mark.faults, pytest.mark.slow]

MEMORY_GIB = 0.6


def task(stage, part, work, *needs):
    return Task(stage, part, 1, {}, work, needs=needs)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Parts of all kinds on two workers: (root, outcomes by name)."""
    root = tmp_path_factory.mktemp("lost")
    tasks = [task("simple", f"a{k}", simple) for k in range(6)]
    tasks += [task("held", "greedy", greedy), task("held", "hopeless", hopeless), task("held", "crash", crashing)]
    tasks += [task("after", n, simple, ("held", n)) for n in ("greedy", "hopeless", "crash")]
    tasks += [task("simple", f"b{k}", simple) for k in range(6)]
    with Cluster(None, 2, MEMORY_GIB, 1000, retries=1, split=2) as cluster:
        outcomes = {(o.stage, o.part): o for o in cluster.run(root, tasks)}
    assert set(outcomes) == {t.name for t in tasks}
    return root, outcomes


def test_parts_that_shared_a_worker_with_them_are_made(made):
    _, outcomes = made
    assert {o.status for name, o in outcomes.items() if name[0] == "simple"} <= {"computed", "skipped"}


def test_a_part_that_wants_too_much_memory_is_made_in_pieces(made):
    root, outcomes = made
    assert outcomes["held", "greedy"].status == outcomes["after", "greedy"].status == "computed"
    assert len(outcomes["held", "greedy"].lost) == 1 and MEMORY in outcomes["held", "greedy"].lost[0]
    log = (root / "logs" / "held" / "greedy.log").read_text()
    assert log.count("status=lost") == 1 and log.count("status=computed") == 1


def test_one_that_wants_too_much_in_pieces_too_is_reported(made):
    _, outcomes = made
    outcome = outcomes["held", "hopeless"]
    assert outcome.status == "failed" and len(outcome.lost) == 2
    assert "2 times" in outcome.message and MEMORY in outcome.message and "worker_memory_gib" in outcome.message
    assert outcomes["after", "hopeless"].status == "blocked"


def test_one_that_crashes_is_reported_by_its_signal(made):
    _, outcomes = made
    outcome = outcomes["held", "crash"]
    # twice alone, and up to twice among others before, which on a quiet machine have ended by then
    assert outcome.status == "failed" and 2 <= len(outcome.lost) <= 4
    assert "SIGSEGV" in outcome.message
    assert outcomes["after", "crash"].status == "blocked"


def test_nothing_of_a_lost_worker_is_left(made):
    root, _ = made
    assert not list((root / "store" / "staging").glob("*/*/*"))
