"""Damage between runs: nothing half-written is taken for whole, and no clock decides anything."""

from __future__ import annotations

import dataclasses
import json
import os
import random
import shutil
import threading
import time
from pathlib import Path

import pytest
from commandline import fwclass
from faultmaker import SMALL, words
from runmaker import SETTINGS, delivered, walk

from fwclass import conf
from fwclass.cli.runner import open_runner
from fwclass.errors import InputError, StoreError
from fwclass.run.inputs import PartInputs
from fwclass.run.local import Loop
from fwclass.run.part import Task, execute
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.store import remote_file
from fwclass.store.atomic import staged
from fwclass.store.lock import writer
from fwclass.store.run_location import lock_run
from fwclass.store.run_store import Store
from fwclass.survey.file_digests import Digests
from fwclass.workflows import WORKFLOWS

pytestmark = pytest.mark.faults


@pytest.fixture
def copy(finished, tmp_path):
    root = tmp_path / "copy"
    shutil.copytree(finished, root, symlinks=True)
    return root


def statuses(runner) -> dict[str, int]:
    found: dict[str, int] = {}
    for outcome in runner.outcomes.values():
        found[outcome.status] = found.get(outcome.status, 0) + 1
    return found


def hurt(path, how: str, rng: random.Random) -> None:
    """Truncate, empty, zero or remove a file."""
    size = path.stat().st_size
    path.chmod(0o644)
    if how == "gone":
        path.unlink()
    elif how == "cut":
        os.truncate(path, rng.randrange(size))
    elif how == "longer":
        with path.open("ab") as stream:
            stream.write(bytes(7))
    else:
        path.write_bytes(b"" if how == "empty" else bytes(size))


def test_a_damaged_store_is_mended(survey, copy, expected):
    """Receipts with any damage, files of parts with any that changes their size."""
    rng = random.Random(3)  # noqa: S311
    receipts = sorted((copy / "store").glob("*/*/receipt.json"))
    files = [p for p in sorted((copy / "store").rglob("*")) if p.is_file() and p.parent.parent.parent.name != "store"]
    files = [p for p in files if p.name != "receipt.json" and "params" not in p.parts and p.stat().st_size > 1]
    struck = set()
    for path in rng.sample(receipts, 8):
        hurt(path, rng.choice(("gone", "cut", "empty", "zero")), rng)
        struck.add(path.parent)
    one = rng.choice([p for p in receipts if p.exists() and p.parent not in struck])
    one.write_text(one.read_text().replace('"digest": "', '"digest": "0', 1))
    for path in rng.sample(files, 8):
        hurt(path, rng.choice(("gone", "cut", "empty", "longer")), rng)
    for name in ("inputs.json", "delivered.json", "lock"):
        (copy / "store" / name).write_text('{"torn')
    for path in (copy / "store" / "params").iterdir():
        path.write_bytes(b"")
    torn = copy / "store" / "staging" / "feed" / "features" / "1_1"
    torn.mkdir(parents=True)
    (torn / "table.parquet").write_bytes(b"PAR1")
    (copy / "generations" / ".pending" / "laz").mkdir(parents=True)
    (copy / "generations" / ".pending" / "laz" / "half.laz").write_bytes(b"LASF")
    assert fwclass(*words(survey, copy), "--workers", "0").returncode == 0
    assert delivered(copy) == expected
    assert not torn.exists() and not list((copy / "laz").rglob("half.laz"))


@pytest.mark.parametrize("text", ["", '{"number": 1}'])
def test_a_damaged_generation_is_made_again(survey, copy, expected, text):
    facts = copy / "current" / "generation.json"
    facts.chmod(0o644)
    facts.write_text(text)
    walk(survey, copy, *SMALL)
    assert json.loads((copy / "current" / "generation.json").read_text())["whole"]
    assert delivered(copy) == expected


def test_clocks_that_jump_make_nothing_stale(survey, copy, tmp_path):
    """Times of everything in the store in the past and in the future, in no order; sources are looked at again."""
    own, rng = tmp_path / "survey", random.Random(5)  # noqa: S311
    shutil.copytree(survey, own)
    runner, _ = walk(own, copy, *SMALL)
    assert set(statuses(runner)) == {"skipped"}
    for path in (*sorted((copy / "store").rglob("*")), *sorted(own.rglob("*"))):
        when = time.time() + rng.uniform(-3e8, 3e8)
        os.utime(path, (when, when), follow_symlinks=False)
    runner, _ = walk(own, copy, *SMALL)
    assert set(statuses(runner)) == {"skipped"}


def test_features_and_classes_of_pieces_are_those_of_the_tile(survey, copy, finished):
    """What a part does whose worker wanted too much memory."""
    wanted = {p.name for p in (copy / "store" / "features").iterdir()}
    held = {}
    for stage in ("features", "classify"):
        for part in wanted:
            receipt = Store(finished).receipt(stage, part)
            held[stage, part] = {n: o["digest"] for n, o in receipt.outputs.items()}
            shutil.rmtree(copy / "store" / stage / part)
    done = []

    class Pieces:
        address = ""

        def run(self, root, tasks):
            for task in tasks:
                outcome = execute(root, task, split=3)
                done.append(outcome.stage)
                yield outcome

    walk(survey, copy, *SMALL, executor=_nothing(Pieces()))
    assert {"features", "classify"} <= set(done)
    for (stage, part), digests in held.items():
        receipt = Store(copy).receipt(stage, part)
        assert {n: o["digest"] for n, o in receipt.outputs.items()} == digests, (stage, part)
    assert PartInputs(Store(copy)).split == 1


@pytest.mark.parametrize("when", ["before", "meanwhile"])
def test_a_part_has_no_receipt_for_bytes_that_a_file_has_lost(tmp_path, when):
    """A source that is truncated after its digest was taken."""
    source = tmp_path / "a.las"
    source.write_bytes(b"x" * 100)
    digests = Digests(Store(tmp_path)).of([source])

    def work(inputs, directory):
        (directory / "made").write_bytes(source.read_bytes())
        if when == "meanwhile":
            os.truncate(source, 50)
        return {}

    if when == "before":
        os.truncate(source, 50)
    outcome = execute(tmp_path, Task("one", "a", 1, {}, work, external=digests))
    assert outcome.status == "failed" and str(source) in outcome.message and "50 bytes" in outcome.message
    assert Store(tmp_path).receipt("one", "a") is None
    assert Digests(Store(tmp_path)).of([source])[0].digest != digests[0].digest


def test_a_source_with_other_bytes_of_its_old_size_and_time_is_another_one(tmp_path):
    """As `touch -r`, `cp -p` and `rsync -t` leave it; a second name, which a backup gives, changes nothing."""
    source = tmp_path / "a.las"
    source.write_bytes(b"x" * 100)
    facts = source.stat()
    digests = Digests(Store(tmp_path))
    before = digests.of([source])
    (tmp_path / "backup.las").hardlink_to(source)
    before[0].check()
    digests.save()
    assert Digests(Store(tmp_path)).of([source])[0].digest == before[0].digest
    source.write_bytes(b"y" * 100)
    os.utime(source, ns=(facts.st_atime_ns, facts.st_mtime_ns))
    with pytest.raises(InputError, match="was changed while"):
        before[0].check()
    assert Digests(Store(tmp_path)).of([source])[0].digest != before[0].digest


def test_sources_of_one_look_that_change_places_are_other_ones(tmp_path, monkeypatch):
    """Written within one tick of the file system's clock, so that size and times are equal."""
    monkeypatch.setattr(remote_file, "looks", lambda path: (100, 1, 1))
    first, second = tmp_path / "a.las", tmp_path / "b.las"
    first.write_bytes(b"x" * 100)
    second.write_bytes(b"y" * 100)
    digests = Digests(Store(tmp_path))
    before = digests.of([first])[0].digest
    first.rename(tmp_path / "aside")
    second.rename(first)
    assert digests.of([first])[0].digest != before


def test_a_removed_store_is_told_as_that(tmp_path):
    with pytest.raises(StoreError, match="was removed while"), writer(tmp_path) as check:
        check()
        shutil.rmtree(tmp_path / "store")
        raise KeyError("what follows of it")


def test_a_second_run_finds_its_store_removed_at_the_next_part(tmp_path):
    """Removed and made again by others: the first may neither go on nor deliver."""
    with (
        pytest.raises(StoreError, match="another store in its place"),
        lock_run(tmp_path, lambda text: None) as (_, held),
    ):
        held()
        shutil.rmtree(tmp_path / "store")
        with writer(tmp_path):
            held()


@pytest.mark.parametrize("what", [pytest.param("store", marks=pytest.mark.slow), "store/publish-tile"])
def test_a_store_that_is_removed_at_the_very_end_is_not_delivered(survey, copy, what):
    """All parts are done, reports are written, and what was to be linked is gone."""
    before = (copy / "current").readlink()
    config = conf.load("demo", (*SETTINGS, *SMALL, f"survey.directory={survey}", "train.trees=6"))
    with (
        pytest.raises(StoreError, match=r"removed while|is gone"),
        Display() as display,
        lock_run(copy, display.say) as (own, held),
    ):
        runner = Runner(own, Loop(), display, held=held)
        WORKFLOWS["classification"](config, runner, None)
        shutil.rmtree(copy / what)
        runner.publish(3)
    assert (copy / "current").readlink() == before and not (copy / "generations" / "0002").exists()


def test_what_another_run_cleared_away_is_not_committed(tmp_path):
    """A worker that outlives its driver, and makes its directory again: half of its files are gone."""
    store = Store(tmp_path)

    def work(directory: Path) -> dict:
        (directory / "first").write_text("gone")
        Store(tmp_path).clear_staging()
        directory.mkdir(parents=True)
        (directory / "second").write_text("half")
        return {}

    with pytest.raises(StoreError, match="cleared away"):
        store.commit("one", "a", "k", {}, "store", work)
    assert store.receipt("one", "a") is None and not list((tmp_path / "store").glob("staging/*/*/*"))


def test_what_workers_left_that_were_killed_goes_at_the_end_of_the_run(tmp_path):
    """Killed when its part had been moved to its place: nothing tells whose directory it was."""

    def work(inputs: PartInputs, directory: Path) -> dict:
        (tmp_path / "store" / "staging" / "left" / "one").mkdir(parents=True)
        return {}

    with open_runner(tmp_path, 0, None, conf.load("demo", ()).run) as runner:
        runner.do([Task("one", "a", 1, {}, work)])
        assert list((tmp_path / "store").glob("staging/*"))
    assert not runner.failures and not list((tmp_path / "store").glob("staging/*"))


def test_what_is_under_way_is_told_while_it_comes_and_goes(tmp_path):
    store, over = Store(tmp_path), threading.Event()
    (store.directory / "staging").mkdir(parents=True)

    def come_and_go() -> None:
        while not over.is_set():
            with staged(store.directory / "staging", "one", "a"):
                pass

    thread = threading.Thread(target=come_and_go)
    thread.start()
    try:
        for _ in range(1000):
            assert set(store.under_way()) <= {("one", "a")}
    finally:
        over.set()
        thread.join()


def test_what_a_killed_writer_left_beside_goes(tmp_path):
    store = Store(tmp_path)
    task = Task("one", "a", 1, {"x": 1}, lambda inputs, directory: {})
    execute(tmp_path, task)
    left = [store.directory / "one" / "a" / ".receipt.json.1", store.directory / "params" / ".p.1"]
    for path in (*left, store.directory / ".inputs.json.1"):
        path.write_text("{")
    store.clear_staging()
    execute(tmp_path, dataclasses.replace(task, version=2))
    assert not list(tmp_path.rglob(".*"))


def _nothing(executor):
    import contextlib

    return contextlib.nullcontext(executor)
