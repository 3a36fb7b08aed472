"""Parts whose files were removed to save room: done for who reads nothing of them, made anew before who does."""

from __future__ import annotations

import pytest

from fwclass.errors import InputError, StoreError
from fwclass.run.cluster import Cluster
from fwclass.run.local import Loop
from fwclass.run.part import Task
from fwclass.run.progress import Display
from fwclass.run.runner import Runner


def copying(inputs, directory, of, text):
    """The files of the parts `of`, one after the other, and a word more."""
    (directory / "a").write_text("".join(inputs.path(*name, "a").read_text() for name in of) + text)
    return {"rows": 1}


class Copying:
    def __init__(self, of, text):
        self.of, self.text = of, text

    def __call__(self, inputs, directory):
        return copying(inputs, directory, self.of, self.text)


def broken(inputs, directory):
    raise InputError("no oil", where="tank", do="fill it")


def chain(last=1, first=None):
    """Three parts, each of which reads the one before, and one that reads none."""
    one, two = ("one", "a"), ("two", "a")
    return (
        Task(*one, 1, {}, first or Copying((), "1")),
        Task(*two, 1, {}, Copying((one,), "2"), needs=(one,)),
        Task("three", "a", 1, {"last": last}, Copying((two,), f"3.{last}"), needs=(two,)),
        Task("other", "a", 1, {}, Copying((), "o")),
    )


def made(root, tasks, executor=None, **settings):
    runner = Runner(root, executor or Loop(), Display(), **settings)
    runner.do(tasks)
    return runner


def statuses(runner):
    return [runner.outcomes[t.name].status for t in chain()]


def text_of(runner, stage):
    return runner.store.path(stage, "a", "a").read_text()


@pytest.fixture
def emptied(tmp_path):
    """A run whose parts one and two were emptied."""
    runner = made(tmp_path, chain())
    assert runner.store.empty([("one", "a"), ("two", "a"), ("none", "a")]) == 2
    assert runner.store.empty([("one", "a")]) == 0
    assert not list((tmp_path / "store" / "one").rglob("a/*/a"))
    return tmp_path


def test_nothing_is_made_where_nothing_changed(emptied):
    assert statuses(made(emptied, chain(), lean=True)) == ["skipped"] * 4


def test_what_is_read_is_made_anew_and_no_more(emptied):
    runner = made(emptied, chain(last=2), lean=True)
    assert statuses(runner) == ["computed", "computed", "computed", "skipped"]
    assert text_of(runner, "three") == "123.2"
    assert [(t.parts, t.computed, t.skipped) for t in runner.tallies.values()] == [(1, 1, 0)] * 3 + [(1, 0, 1)]
    assert statuses(made(emptied, chain(last=2))) == ["skipped"] * 4


def test_workers_do_the_same_and_parts_of_an_earlier_batch_are_made_too(emptied):
    with Cluster(None, 2, 2.0, 100) as cluster:
        runner = Runner(emptied, cluster, Display(), lean=True)
        for task in chain(last=3):
            runner.do([task])
    assert statuses(runner) == ["computed", "computed", "computed", "skipped"]
    assert text_of(runner, "three") == "123.3"


def test_who_is_not_lean_has_all_of_them(emptied):
    assert statuses(made(emptied, chain())) == ["computed", "computed", "skipped", "skipped"]


def test_what_fails_the_second_time_stops_who_reads_it(emptied):
    runner = made(emptied, chain(last=2, first=broken), lean=True)
    assert statuses(runner) == ["failed", "blocked", "blocked", "skipped"]
    assert [(t.parts, t.failed) for t in runner.tallies.values()] == [(1, 1)] * 3 + [(1, 0)]


def test_who_reads_a_part_directly_is_told(emptied):
    store = made(emptied, chain()[3:]).store
    assert store.damaged(store.receipt("one", "a")) == []
    with pytest.raises(StoreError, match="removed to save room"):
        store.path("one", "a", "a")
