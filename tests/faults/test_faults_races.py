"""Two writers on one place of object storage, whose requests are served at the same time, late, or unanswered."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections import Counter
from pathlib import Path

import pytest
from objectstore import KEYS, quick
from racingserver import Bucket, racing
from smallgraph import delivered, made, run

from fwclass.errors import FwclassError
from fwclass.operate.status.verify import verify
from fwclass.store.bucket import Remote, unit_of
from fwclass.store.lookup import receipt_key
from fwclass.store.receipts import Receipt
from fwclass.store.run_location import open_store
from fwclass.store.run_store import Store
from fwclass.store.url import Url

pytestmark = pytest.mark.faults


def whole(there: dict[str, bytes], below: str) -> str:
    """The text of the generation `below`, which has every file of its manifest, all of one run."""
    files = json.loads(there[f"{below}/manifest.json"])["files"]
    assert f"{below}/generation.json" in there
    for name, facts in files.items():
        assert hashlib.blake2b(there[f"{below}/{name}"], digest_size=16).hexdigest() == facts["digest"], name
    text = str(json.loads(there[f"{below}/report.json"])["text"])
    assert all(there[f"{below}/{n}"].startswith(text.encode()) for n in files if n.startswith(("laz/", "rasters/")))
    return text


@pytest.fixture
def place() -> str:
    """A bucket and a path: clients of a place are kept for as long as the process lasts."""
    return f"b/{uuid.uuid4().hex}"


def shown(bucket: Bucket, place: str) -> list[str]:
    """Texts of the generations that readers were led to, one after the other, each whole for as long as they were."""
    there: dict[str, bytes] = {}
    texts, below = [], ""
    for change in list(bucket.log):
        key = change.key.removeprefix(f"{place}/")
        if change.data is None:
            del there[key]
        else:
            there[key] = change.data
        if key == "current.json":
            below = json.loads(there[key])["address"]
            texts.append(whole(there, below))
        elif below and key.startswith(f"{below}/"):
            assert whole(there, below) == texts[-1]
    return texts


def receipts(bucket: Bucket, place: str, stage: str, part: str) -> list[Receipt]:
    """Every receipt that the part ever had, in order."""
    key = f"{place}/{receipt_key(stage, part)}"
    return [Receipt.from_json(json.loads(c.data), c.key) for c in bucket.log if c.key == key and c.data]


@pytest.mark.parametrize("lost", [0.0, pytest.param(0.15, marks=pytest.mark.slow)])
def test_of_writers_without_a_lock_each_commit_that_is_told_was_done_once(tmp_path, monkeypatch, place, lost):
    """As of a host that slept, and has not noticed that its lock is gone."""
    for name, value in {**KEYS, "FWCLASS_SCRATCH": str(tmp_path / "copies")}.items():
        monkeypatch.setenv(name, value)
    with racing(lost, 5) as (address, bucket):
        monkeypatch.setenv("AWS_ENDPOINT_URL", address)
        location = Remote(Url(f"s3://{place}"), quick(parallel=4))
        told: dict[str, str] = {}

        def write(who: str) -> None:
            for k in range(12):
                part, text = "ab"[k % 2], f"{who}{k}"

                def work(directory: Path, text: str = text) -> dict:
                    (directory / "one").write_text(text)
                    (directory / "two").write_text(text * 2)
                    return {"text": text}

                try:
                    Store(location).commit("stage", part, text, {}, "store", work)
                    told[text] = "acknowledged"
                except FwclassError as fault:
                    told[text] = fault.what

        threads = [threading.Thread(target=write, args=(who,)) for who in "xyz"]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        done = Counter(str(r.meta["text"]) for part in "ab" for r in receipts(bucket, place, "stage", part))
        assert bucket.most > 2, "no two requests were served at a time"
        assert set(told.values()) == {"acknowledged", "another run wrote here at the same time"}, Counter(told.values())
        for text, word in told.items():  # who was told that another was first may have been first, and written over
            assert done[text] == 1 or (word != "acknowledged" and done[text] == 0), (text, word)
            assert lost or done[text] == (word == "acknowledged"), (text, word)
        for part in "ab":
            last = receipts(bucket, place, "stage", part)[-1]
            files = {k: d for k, d in bucket.held().items() if k.startswith(f"{place}/{unit_of(last)}/")}
            assert {d.decode() for d in files.values()} == {last.meta["text"], last.meta["text"] * 2}


def victim(bucket: Bucket, place: str, writers: list[subprocess.Popen], rng: random.Random) -> subprocess.Popen:
    """Who is to sleep now: any of the writers, or the one that is in the middle of a delivery."""
    until, begun = time.monotonic() + rng.uniform(0.3, 2.0), rng.random() < 0.3
    while time.monotonic() < until or begun:
        last = bucket.log[-1] if bucket.log else None
        if last is not None and last.data and last.key.startswith(f"{place}/generations/") and rng.random() < 0.2:
            holder = json.loads(bucket.held().get(f"{place}/store/lock", b"{}")).get("pid")
            found = [p for p in writers if p.pid == holder]
            if found:
                return found[0]
        begun = begun and any(p.poll() is None for p in writers)
        time.sleep(0.005)
    return rng.choice(writers)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_runs_that_take_over_from_each_other_never_mix(tmp_path, monkeypatch, place, seed):
    """Each is put to sleep for longer than its lock lives, at any moment, and goes on when the other has taken over."""
    rng = random.Random(seed)  # noqa: S311
    source = tmp_path / "a.las"
    source.write_bytes(b"x" * 100)
    given = {**os.environ, **KEYS, "PYTHONPATH": ":".join(sys.path), "AWS_EC2_METADATA_DISABLED": "true"}
    with racing(0.02, seed) as (address, bucket):
        given["AWS_ENDPOINT_URL"] = address
        notes = {who: tmp_path / f"notes-{who}" for who in "xy"}
        racer = str(Path(__file__).parents[1] / "racer.py")
        with contextlib.ExitStack() as stack:
            writers = []
            for who, path in notes.items():
                words = [sys.executable, racer, who, f"s3://{place}", str(source), str(path), "40"]
                env = {**given, "FWCLASS_SCRATCH": str(tmp_path / who)}
                told = stack.enter_context((tmp_path / f"told-{who}").open("wb"))
                writers.append(subprocess.Popen(words, env=env, stdout=told, stderr=told))
            for process in writers:
                stack.callback(process.kill)
            while any(process.poll() is None for process in writers):
                process = victim(bucket, place, writers, rng)
                process.send_signal(signal.SIGSTOP)
                time.sleep(rng.uniform(0.2, 2.0))
                process.send_signal(signal.SIGCONT)
        assert [p.returncode for p in writers] == [0, 0]
        lines = [json.loads(line) for path in notes.values() for line in path.read_text().splitlines()]
        words = Counter(line["told"] for line in lines)
        seen = Counter(shown(bucket, place))
        for line in lines:
            assert seen[line["text"]] == 1 or (line["told"] != "acknowledged" and seen[line["text"]] == 0), line
        assert words["acknowledged"] > 3 and len(words) > 1, words
        for name, value in {**KEYS, "AWS_ENDPOINT_URL": address, "FWCLASS_SCRATCH": str(tmp_path / "last")}.items():
            monkeypatch.setenv(name, value)
        bucket.lost = 0.0
        location = Remote(Url(f"s3://{place}"), quick(dead=0.6))
        for _ in range(3):  # the first may meet what a sleeper has removed: in words, and made anew
            with contextlib.suppress(FwclassError):
                if not run(location, source, "ab", "last"):
                    break
        assert run(location, source, "ab", "last") == []
        assert shown(bucket, place)[-1] == "last"
        clean = tmp_path / "clean"
        run(clean, source, "ab", "last")
        store = open_store(location, lists=True)
        assert made(store) == made(Store(clean)) and verify(store).sound
        below = json.loads(bucket.held()[f"{place}/current.json"])["address"]
        own = {
            k.removeprefix(f"{place}/{below}/"): hashlib.sha256(d).hexdigest()
            for k, d in bucket.held().items()
            if k.startswith(f"{place}/{below}/")
        }
        assert {n: d for n, d in own.items() if n not in ("generation.json", "manifest.json")} == delivered(clean)
