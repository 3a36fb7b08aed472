"""Damage between runs: nothing half-written is taken for whole, and no clock decides anything."""

from __future__ import annotations

import json
import os
import random
import shutil
import time

import pytest
from commandline import fwclass
from faultmaker import SMALL, words
from runmaker import delivered, walk

from fwclass.errors import StoreError
from fwclass.run.desk import Desk
from fwclass.run.part import Task, execute
from fwclass.run.work.sources import Digests
from fwclass.store.lock import writer
from fwclass.store.run_store import Store

pytestmark = pytest.mark.faults


@pytest.fixture
def copy(finished, tmp_path):
    root = tmp_path / "copy"
    shutil.copytree(finished, root, symlinks=True)
    return root


def statuses(road) -> dict[str, int]:
    found: dict[str, int] = {}
    for outcome in road.outcomes.values():
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
    for name in ("inputs.json", "lock"):
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


def test_a_flipped_byte_is_found_by_verify(survey, copy):
    path = next((copy / "store" / "features").rglob("table.parquet"))
    held = bytearray(path.read_bytes())
    held[len(held) // 2] ^= 1
    path.write_bytes(bytes(held))
    assert fwclass("status", copy).returncode == 0
    told = fwclass("status", copy, "--verify")
    assert told.returncode == 3 and f"features/{path.parent.parent.name}: table.parquet" in told.stdout
    found = json.loads(fwclass("status", copy, "--verify", "--json").stdout)["damaged"]
    assert found == [{"stage": "features", "part": path.parent.parent.name, "files": ["table.parquet"]}]
    shutil.rmtree(path.parent.parent)
    walk(survey, copy, *SMALL)
    assert fwclass("status", copy, "--verify").returncode == 0


def test_clocks_that_jump_make_nothing_stale(survey, copy, tmp_path):
    """Times of everything in the store in the past and in the future, in no order; sources are looked at again."""
    own, rng = tmp_path / "survey", random.Random(5)  # noqa: S311
    shutil.copytree(survey, own)
    road, _ = walk(own, copy, *SMALL)
    assert set(statuses(road)) == {"skipped"}
    for path in (*sorted((copy / "store").rglob("*")), *sorted(own.rglob("*"))):
        when = time.time() + rng.uniform(-3e8, 3e8)
        os.utime(path, (when, when), follow_symlinks=False)
    road, _ = walk(own, copy, *SMALL)
    assert set(statuses(road)) == {"skipped"}


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
    assert Desk(Store(copy)).split == 1


@pytest.mark.parametrize("when", ["before", "meanwhile"])
def test_a_part_has_no_receipt_for_bytes_that_a_file_has_lost(tmp_path, when):
    """A source that is truncated after its digest was taken."""
    source = tmp_path / "a.las"
    source.write_bytes(b"x" * 100)
    digests = Digests(Store(tmp_path)).of([source])

    def work(desk, directory):
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


def test_a_removed_store_is_told_as_that(tmp_path):
    with pytest.raises(StoreError, match="was removed while"), writer(tmp_path) as check:
        check()
        shutil.rmtree(tmp_path / "store")
        raise KeyError("what follows of it")


def _nothing(executor):
    import contextlib

    return contextlib.nullcontext(executor)
