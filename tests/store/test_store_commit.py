"""The store: whole parts or none, receipts, the lock."""

import copy
import json
import os
import stat
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from fwclass.errors import DamagedError, StoreError
from fwclass.memory import peak_mib
from fwclass.store.generations import manifest_files
from fwclass.store.lock import writer
from fwclass.store.run_store import Store


def write(text):
    def work(directory):
        (directory / "a.txt").write_text(text)
        return {"rows": len(text)}

    return work


def test_a_committed_part_is_done_under_its_key_only(tmp_path):
    store = Store(tmp_path)
    made = store.commit("stage", "1_2", "k1", {"file": "d"}, "store", write("abc"))
    assert store.done("stage", "1_2", "k1") == made == store.receipt("stage", "1_2")
    assert store.done("stage", "1_2", "k2") is None
    assert store.path("stage", "1_2", "a.txt").read_text() == "abc"


def test_a_store_that_ends_with_its_process_is_not_flushed_and_tells_no_libraries(tmp_path, monkeypatch):
    """That of a command on one file waited for the disk, and read the program's own code for a digest of it."""
    flushed = []
    monkeypatch.setattr(os, "fsync", flushed.append)
    made = Store(tmp_path / "scratch", lasting=False).commit("stage", "1_2", "k1", {}, "store", write("abc"))
    assert not made.libraries and not flushed and not (tmp_path / "scratch" / "store" / "libraries").exists()
    again = Store(tmp_path / "run").commit("stage", "1_2", "k1", {}, "store", write("abc"))
    assert again.libraries and flushed and again.outputs == made.outputs


def test_the_digest_follows_content_not_time(tmp_path):
    digests = [
        Store(tmp_path / n).commit("s", "p", "k", {}, "store", write(t)).digest
        for n, t in (("a", "abc"), ("b", "abc"), ("c", "abd"))
    ]
    assert digests[0] == digests[1] != digests[2]


def test_a_part_that_breaks_leaves_no_receipt_and_no_litter(tmp_path):
    store = Store(tmp_path)

    def work(directory):
        (directory / "half.txt").write_text("half")
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError):
        store.commit("stage", "p", "k", {}, "store", work)
    assert store.receipt("stage", "p") is None
    assert [p.name for p in tmp_path.rglob("*.txt")] == []


def test_a_break_keeps_the_older_version(tmp_path):
    store = Store(tmp_path)
    store.commit("stage", "p", "old", {}, "store", write("old"))

    def work(directory):
        raise RuntimeError

    with pytest.raises(RuntimeError):
        store.commit("stage", "p", "new", {}, "store", work)
    assert store.path("stage", "p", "a.txt").read_text() == "old"


def test_a_truncated_output_is_not_done(tmp_path):
    store = Store(tmp_path)
    store.commit("stage", "p", "k", {}, "store", write("abc"))
    store.path("stage", "p", "a.txt").write_text("a")
    assert store.done("stage", "p", "k") is None


def test_a_new_version_removes_the_old_one(tmp_path):
    store = Store(tmp_path)
    store.commit("stage", "p", "k1", {}, "store", write("abc"))
    store.commit("stage", "p", "k2", {}, "store", write("abd"))
    assert sorted(p.name for p in (tmp_path / "store" / "stage" / "p").iterdir()) == ["k2", "receipt.json"]


def test_delivered_files_go_to_the_run_directory_and_vanish_with_their_part(tmp_path):
    store = Store(tmp_path)

    def work(name):
        def inner(directory):
            (directory / "laz").mkdir()
            (directory / "laz" / name).write_text(name)
            return {}

        return inner

    store.commit("publish", "p", "k1", {}, "run", work("one"))
    assert (tmp_path / "laz" / "one").read_text() == "one"
    store.commit("publish", "p", "k2", {}, "run", work("two"))
    assert [p.name for p in (tmp_path / "laz").iterdir()] == ["two"]


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o444), (0o027, 0o440), (0o077, 0o400)])
def test_who_may_read_what_is_delivered_is_the_umasks_to_say(tmp_path, umask, mode):
    store = Store(tmp_path)
    before = os.umask(umask)
    try:
        receipt = store.commit("publish", "p", "k", {}, "deliver", write("abc"))
    finally:
        os.umask(before)
    assert stat.S_IMODE((store.base(receipt) / "a.txt").stat().st_mode) == mode


@pytest.mark.parametrize("place", ["store", "deliver", "run"])
def test_bytes_that_changed_are_damage_wherever_a_part_lies(tmp_path, place):
    store = Store(tmp_path)
    receipt = store.commit("stage", "p", "k", {}, place, write("abc"))
    assert store.done("stage", "p", "k") == receipt and store.damaged(receipt) == []
    assert store.path("stage", "p", "a.txt").read_text() == "abc" and store.size_of(receipt, "a.txt") == 3
    path = store.base(receipt) / "a.txt"
    path.chmod(0o644)
    path.write_text("abd")
    assert store.damaged(receipt) == ["a.txt"]
    path.unlink()
    assert store.damaged(receipt) == ["a.txt"] and store.done("stage", "p", "k") is None
    store.remove("stage", "p")
    assert store.receipt("stage", "p") is None and not list(tmp_path.rglob("a.txt"))


def test_a_damaged_receipt_says_nothing(tmp_path):
    store = Store(tmp_path)
    whole = store.commit("stage", "p", "k", {}, "store", write("abc"))
    path = tmp_path / "store" / "stage" / "p" / "receipt.json"
    text = path.read_text()
    assert store.receipt("stage", "p") == whole
    changed = text.replace('"seconds": ', '"seconds": 1')
    for damaged in (text[:20], "", "\0" * len(text), "[]", "7", json.dumps({"stage": "s"}), changed):
        assert damaged != text
        path.write_text(damaged)
        assert store.receipt("stage", "p") is None, damaged
        assert store.done("stage", "p", "k") is None
    path.write_text(text.replace('"format": 1', '"format": 99'))
    assert store.receipt("stage", "p") is None


@pytest.mark.parametrize("settled", [0.0, 0.2])
def test_a_receipt_that_another_writes_anew_is_noticed_at_once(tmp_path, settled):
    """Also within a tick of the file system's clock, where size and times stay the same."""
    store, other = Store(tmp_path), tmp_path / "receipt"
    made = store.commit("stage", "p", "k", {}, "store", write("abc"))
    path = tmp_path / "store" / "stage" / "p" / "receipt.json"
    for k in range(20):
        time.sleep(settled if k < 2 else 0)
        assert store.receipt("stage", "p") == made == store.receipt("stage", "p")
        made = replace(made, seconds=float(k % 10))
        other.write_text(made.to_text())
        os.utime(other, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns))
        other.replace(path)
    path.unlink()
    assert store.receipt("stage", "p") is None


def test_a_second_writer_is_told_who_the_first_is(tmp_path):
    with writer(tmp_path), pytest.raises(StoreError, match=r"another run[\s\S]*pid"), writer(tmp_path):
        pass
    with writer(tmp_path):
        pass


def test_a_small_process_does_not_inherit_the_peak_of_a_large_one():
    large = np.ones(400 << 17)  # 400 MiB, touched
    script = "from fwclass.memory import peak_mib; print(peak_mib())"
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert 5 < float(ended.stdout) < 200 and peak_mib() > large.nbytes / 2**20


@pytest.mark.parametrize(
    "files",
    [
        None,
        [],
        {"a": None},
        {"a": {"bytes": 1}},
        {"a": {"digest": "0"}},
        {"a": {"bytes": 1e999, "digest": "0"}},
        {"../a": {"bytes": 1, "digest": "0"}},
        {"/a": {"bytes": 1, "digest": "0"}},
        {"": {"bytes": 1, "digest": "0"}},
    ],
)
def test_a_manifest_that_no_writer_wrote_is_none(files: object) -> None:
    with pytest.raises(ValueError):
        manifest_files(json.dumps({"files": files}).encode())


def test_a_manifest_is_what_was_written() -> None:
    files = {"laz/tiles/1_2.laz": {"bytes": 7, "digest": "ab", "e_tag": "c"}}
    assert manifest_files(json.dumps({"files": files}).encode()) == files


def test_what_a_receipt_lacks_is_said_with_its_name(tmp_path):
    """Whoever can write the file can seal it anew."""
    store = Store(tmp_path)
    store.commit("stage", "1_2", "k1", {}, "store", write("abc"))
    meta = Store(tmp_path).receipt("stage", "1_2").meta
    assert meta["rows"] == 3 and "faults" not in meta and meta.get("faults", 0) == 0
    with pytest.raises(DamagedError, match="faults") as fault:
        copy.deepcopy(meta)["faults"]
    assert "1_2" in str(fault.value)
