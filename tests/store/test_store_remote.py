"""A run's store on object storage: whole parts or none, whoever is killed or comes in between."""

from __future__ import annotations

import itertools
import json
import shutil
from pathlib import Path

import obstore
import pytest
from objectstore import Server, Trouble, quick

from fwclass.errors import StoreError
from fwclass.store.bucket import Remote
from fwclass.store.failures import Failure
from fwclass.store.objects import Objects
from fwclass.store.refusals import LostRace
from fwclass.store.run_store import Store
from fwclass.store.scratch import Scratch
from fwclass.store.url import Url


@pytest.fixture
def remote(s3: Server) -> Remote:
    return Remote(s3.url(), quick())


def writing(text: str, name: str = "a.txt"):
    def work(directory: Path) -> dict[str, int]:
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_text(text)
        return {"rows": len(text)}

    return work


def commit(remote: Remote, key: str, text: str, part: str = "1_2", name: str = "a.txt", place: str = "store"):
    return Store(remote).commit("stage", part, key, {"f": "d"}, place, writing(text, name), 1, {"cell": 0.5})


def elsewhere(monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    """From now on this process keeps its copies like one of another host."""
    monkeypatch.setenv("FWCLASS_SCRATCH", str(path))


def test_a_committed_part_is_read_on_another_host(remote, monkeypatch, tmp_path):
    made = commit(remote, "k1", "abc", name="table.zarr/c/0")
    elsewhere(monkeypatch, tmp_path / "other")
    for lists in (False, True):
        store = Store(remote, lists=lists)
        assert store.done("stage", "1_2", "k1") == made == store.receipt("stage", "1_2")
        assert store.done("stage", "1_2", "k2") is None
        assert (store.path("stage", "1_2", "table.zarr") / "c/0").read_text() == "abc"
        assert store.provenance.params(made) == {"cell": 0.5}
        assert [r.part for r in store.receipts("stage")] == ["1_2"]
        assert store.parts() == [("stage", "1_2")]


def test_an_answered_question_costs_no_request_again(s3, remote):
    for part in ("a", "b", "c"):
        commit(remote, "k", "abc", part)
    store = Store(remote, lists=True)
    store.look_up([("stage", p) for p in "abc"])
    s3.faults.seen.clear()
    again = Store(remote, lists=True)
    assert all(again.done("stage", p, "k") for p in "abc")
    assert again.receipt("stage", "never") is None
    assert [method for method, _ in s3.faults.seen] == ["GET"]  # one list; the receipts are known by their marks


def test_a_new_version_replaces_the_old_one_and_its_objects(s3, remote):
    commit(remote, "k1", "abc")
    commit(remote, "k2", "abd")
    files = [k for k in s3.read(remote.url) if k.startswith("store/stage")]
    assert len(files) == 2
    assert Store(remote).path("stage", "1_2", "a.txt").read_text() == "abd"


def test_a_part_that_breaks_leaves_the_older_one(s3, remote):
    commit(remote, "k1", "abc")
    before = s3.read(remote.url)

    def work(directory: Path) -> dict[str, int]:
        (directory / "half").write_text("half")
        raise RuntimeError

    with pytest.raises(RuntimeError):
        Store(remote).commit("stage", "1_2", "k2", {}, "store", work)
    assert s3.read(remote.url) == before


@pytest.mark.faults
def test_an_upload_that_is_torn_is_no_part_and_is_swept(s3, remote):
    remote = Remote(remote.url, quick(patience=0.2))

    def two(directory: Path) -> dict[str, int]:
        writing("b", "b.txt")(directory)
        return writing("a")(directory)

    with (
        s3.trouble(Trouble("busy", 1000, lambda method, path: path.endswith("/b.txt"))),
        pytest.raises(StoreError, match="does not answer"),
    ):
        Store(remote).commit("stage", "p", "k", {}, "store", two)
    assert any(k.endswith("/a.txt") for k in s3.read(remote.url))
    store = Store(remote, lists=True)
    assert store.receipt("stage", "p") is None
    store.clear_staging()
    assert [k for k in s3.read(remote.url) if "stage" in k] == []


def test_the_sweep_keeps_what_a_receipt_names(s3, remote):
    receipt = commit(remote, "k1", "abc")
    s3.write(remote.url / "store/stage/1_2/other-0000/a.txt", b"left by a killed worker")
    s3.write(remote.url / "store/stage/never/k-1/a.txt", b"left by a killed worker")
    s3.write(remote.url / "generations/0007/laz/a.laz", b"never finished")
    before = set(s3.read(remote.url))
    store = Store(remote, lists=True)
    store.clear_staging()
    gone = before - set(s3.read(remote.url))
    assert gone == {"store/stage/1_2/other-0000/a.txt", "store/stage/never/k-1/a.txt"}
    assert Store(remote).done("stage", "1_2", "k1") == receipt


@pytest.mark.faults
def test_two_who_make_a_part_at_once_do_not_mix(remote):
    """The second finds another receipt than before its work: the same part made by a twin is taken, another refused."""
    slow = Store(remote)

    def late(key: str, mine: str, other: str):
        def work(directory: Path) -> dict[str, int]:
            commit(remote, key, other)
            return writing(mine)(directory)

        return slow.commit("stage", "1_2", key, {"f": "d"}, "store", work)

    assert late("k1", "abc", "abc").key == "k1"
    with pytest.raises(LostRace, match="another run wrote here"):
        late("k2", "abc", "another text")
    assert Store(remote).path("stage", "1_2", "a.txt").read_text() == "another text"


@pytest.mark.faults
def test_objects_that_are_gone_or_changed_are_no_part(s3, remote, monkeypatch, tmp_path):
    receipt = commit(remote, "k1", "abc")
    [key] = [k for k in s3.read(remote.url) if k.endswith("a.txt")]
    elsewhere(monkeypatch, tmp_path / "second")
    s3.write(remote.url / key, b"abX")
    with pytest.raises(StoreError, match="not what was written"):
        Store(remote).path("stage", "1_2", "a.txt")
    s3.write(remote.url / key, b"ab")
    assert Store(remote).done("stage", "1_2", "k1") is None
    s3.remove(remote.url / key)
    for lists in (True, False):
        store = Store(remote, lists=lists)
        assert store.receipt("stage", "1_2") == receipt
        assert store.done("stage", "1_2", "k1") is None
        assert store.size_of(receipt, "a.txt") is None
    with pytest.raises(StoreError, match="gone"):
        Store(remote).path("stage", "1_2", "a.txt")


def test_a_receipt_that_leads_out_of_its_part_is_refused(s3, remote):
    commit(remote, "k1", "abc")
    [key] = [k for k in s3.read(remote.url) if k.endswith("receipt.json")]
    facts = json.loads(s3.read(remote.url)[key])
    del facts["seal"]  # with it the receipt would only say nothing
    facts["outputs"] = {"../../x": {"bytes": 1, "digest": ""}}
    s3.write(remote.url / key, json.dumps(facts).encode())
    with pytest.raises(StoreError, match=r"not a receipt[\s\S]*output"):
        Store(remote).receipt("stage", "1_2")
    facts["outputs"], facts["part"] = {}, "other"
    s3.write(remote.url / key, json.dumps(facts).encode())
    with pytest.raises(StoreError, match="a receipt of another part"):
        Store(remote).receipt("stage", "1_2")


@pytest.mark.faults
def test_a_run_that_lost_its_lock_commits_nothing(s3, remote):
    s3.write(remote.url / "store/lock", json.dumps({"host": "other", "pid": 1, "token": "theirs"}).encode())
    with pytest.raises(LostRace, match="lost its lock"):
        commit(Remote(remote.url, remote.params, "mine"), "k1", "abc")
    assert Store(remote).receipt("stage", "1_2") is None


def test_failures_and_what_is_under_way_are_told(s3, remote):
    store = Store(remote)
    store.failures.record(Failure("stage", "1_2", "k", "disk full"))
    assert {n: f.message for n, (f, _) in store.failures.all().items()} == {("stage", "1_2"): "disk full"}
    seen = []

    def work(directory: Path) -> dict[str, int]:
        seen.extend(Store(remote).under_way())
        return {}

    store.commit("stage", "1_2", "k", {}, "store", work)
    assert seen == [("stage", "1_2")]
    assert not store.under_way()
    assert not store.failures.all()


def test_parts_that_the_plan_no_longer_has_go(s3, remote):
    for part in ("a", "b"):
        commit(remote, "k", part, part)
    assert Store(remote, lists=True).forget_others("stage", ["a"]) == ["b"]
    assert Store(remote).receipt("stage", "b") is None
    assert [k for k in s3.read(remote.url) if "/b/" in k] == []
    assert Store(remote).path("stage", "a", "a.txt").read_text() == "a"


def test_generations_appear_at_one_stroke_and_the_last_stay(s3, remote):
    store = Store(remote)

    def deliver(text: str, whole: bool = True):
        receipt = commit(remote, text, text, name="laz/a.laz", place="deliver")
        files = {n: (store.base(receipt) / n, str(f["digest"])) for n, f in receipt.outputs.items()}
        (store.generations.pending / "report.json").write_text(text)
        return store.generations.publish(files, whole, 2)

    def shown() -> str:
        there = s3.read(remote.url)
        below = json.loads(there["current.json"])["address"]
        assert there[f"{below}/laz/a.laz"] == there[f"{below}/report.json"]
        return there[f"{below}/laz/a.laz"].decode()

    s3.write(remote.url / "generations/0000-dead/laz/a.laz", b"never finished")
    assert str(deliver("one").where).startswith(f"{remote.url}/generations/0001-")
    assert not [k for k in s3.keys(remote.url) if "dead" in k]
    assert shown() == "one"
    assert deliver("one").number == 1
    sleeper = store.generations.files.pointer()[1]
    assert deliver("two").number == 2
    assert deliver("half", whole=False).number == 3
    assert shown() == "two"
    with pytest.raises(LostRace):  # who slept while another delivered
        store.generations._point(store.generations.all()[0], sleeper)
    assert store.generations.shown("report.json").read_text() == "two"
    deliver("three")
    assert shown() == "three"
    assert [g.number for g in store.generations.all()] == [2, 4]


def test_a_copy_that_the_server_cuts_short_is_not_delivered(s3, remote, monkeypatch):
    """It says that it copied, and lists other bytes: a run ended with 0."""
    store, receipt = Store(remote), commit(remote, "whole", "k", name="laz/a.laz", place="deliver")
    files = {n: (store.base(receipt) / n, str(f["digest"])) for n, f in receipt.outputs.items()}
    monkeypatch.setattr(Objects, "copy", lambda self, source, target: self.put(target, b"wh"))
    with pytest.raises(StoreError, match="of another size"):
        store.generations.publish(files, True, 2)
    assert "current.json" not in s3.keys(remote.url)


def test_copies_are_bounded_and_the_longest_unread_go_first(remote, monkeypatch, tmp_path):
    for part in "abcd":
        commit(remote, "k", part * 1000, part)
    elsewhere(monkeypatch, tmp_path / "small")
    monkeypatch.setattr("fwclass.store.scratch.KEPT", 1)
    small = Remote(remote.url, quick(scratch_gib=3500 / 2**30))
    store = Store(small)
    for part in "abcad":
        assert store.path("stage", part, "a.txt").read_text() == part * 1000
    kept = sorted(p.parents[1].name for p in store.root.rglob("a.txt"))
    assert kept == ["a", "c", "d"]
    fetched = small.scratch.fetched
    store.path("stage", "c", "a.txt")
    assert small.scratch.fetched == fetched
    assert store.path("stage", "b", "a.txt").read_text() == "b" * 1000
    assert small.scratch.fetched == fetched + 1000


def test_copies_outlive_their_process_but_not_the_host(tmp_path):
    first, second = Scratch(tmp_path, 1.0), Scratch(tmp_path, 1.0)
    assert first.root != second.root  # two processes at a time do not share
    (first.root / "run/unit").mkdir(parents=True)
    (first.root / "run/unit/a").write_text("abc")
    first.adopt("run/unit", 3)
    first.close()
    again = Scratch(tmp_path, 1.0)
    assert again.root == first.root
    assert (again.root / "run/unit/a").read_text() == "abc"
    again.close()
    (first.root / "boot").write_text("another")
    assert not (Scratch(tmp_path, 1.0).root / "run").exists()
    shutil.rmtree(tmp_path)


@pytest.mark.parametrize("text", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b'{"stage": "stage"}'])
def test_a_damaged_receipt_says_nothing_and_its_part_is_made_again(remote, monkeypatch, tmp_path, text):
    made, key = commit(remote, "k", "abc"), "store/stage/1_2/receipt.json"
    for lists in (False, True):
        remote.objects.put(key, text)
        elsewhere(monkeypatch, tmp_path / f"other-{lists}")
        store = Store(remote, lists=lists)
        assert store.done("stage", "1_2", "k") is None and list(store.receipts("stage")) == []
        assert commit(remote, "k", "abc").digest == made.digest
        assert Store(remote).done("stage", "1_2", "k").digest == made.digest


def test_a_receipt_whose_bytes_were_changed_says_nothing(remote):
    commit(remote, "k", "abc")
    key = "store/stage/1_2/receipt.json"
    remote.objects.put(key, remote.objects.get(key)[0].replace(b'"rows": 3', b'"rows": 4'))
    assert Store(remote).receipt("stage", "1_2") is None


def test_a_list_that_goes_round_ends(monkeypatch):
    """A server that always says that more is to come."""
    objects = Objects(Url("memory://round"), quick(patience=0.5))
    objects.put("a", b"a")
    (one,) = obstore.list(objects._store, chunk_size=1)
    monkeypatch.setattr(obstore, "list", lambda *_, **__: itertools.repeat(one))
    with pytest.raises(StoreError, match="the list has 'a' twice"):
        list(objects.list())
