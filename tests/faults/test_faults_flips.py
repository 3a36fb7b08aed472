"""Bits that flip on a disk: no part is made of them unnoticed, and a repair leads to what a clean run delivers."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from commandline import fwclass
from faultmaker import SMALL
from objectstore import quick, serving, used
from runmaker import delivered, walk

from fwclass.errors import DamagedError, StoreError
from fwclass.operate.request import Request
from fwclass.operate.status.verify import remove, verify
from fwclass.store.bucket import Remote
from fwclass.store.run_location import open_store
from fwclass.store.run_store import Store
from fwclass.survey.file_digests import Digests

pytestmark = pytest.mark.faults

CHANGED = (*SMALL, "train.trees=6", "classify.probabilities=true")
"""Makes all that is delivered anew, from features, heights and terrain that stand."""

LATER = ("tile", "ground", "features")


def stages(first: str, *later: str) -> pytest.MarkDecorator:
    """Every stage, `later` ones in the slow suite."""
    return pytest.mark.parametrize("stage", [first, *(pytest.param(s, marks=pytest.mark.slow) for s in later)])


@pytest.fixture
def copy(finished, tmp_path):
    root = tmp_path / "copy"
    shutil.copytree(finished, root, symlinks=True)
    return root


@pytest.fixture(scope="module")
def clean(survey, finished, tmp_path_factory) -> dict[str, str]:
    """What the changed run delivers where nothing is damaged."""
    root = tmp_path_factory.mktemp("clean") / "run"
    shutil.copytree(finished, root, symlinks=True)
    walk(survey, root, *CHANGED)
    return delivered(root)


def flip(path: Path, at: int | None = None) -> None:
    """Turn one bit of a file, in its middle or at a byte; its size and times stay."""
    facts, held = path.stat(), bytearray(path.read_bytes())
    held[len(held) // 2 if at is None else at] ^= 1
    path.chmod(0o644)
    path.write_bytes(bytes(held))
    os.utime(path, ns=(facts.st_atime_ns, facts.st_mtime_ns))


def flip_a_value(path: Path) -> None:
    """Turn one bit such that the Parquet file can be read still, and holds something else: which bits do depends on
    how it was compressed."""
    before, size = pq.read_table(path), path.stat().st_size
    for at in (*range(size // 2, size), *range(size // 2)):
        flip(path, at)
        with contextlib.suppress(OSError, pa.ArrowException):
            if pq.read_table(path) != before:
                return
        flip(path, at)
    raise AssertionError(f"no bit of {path} does")


def a_file_of(root: Path, stage: str) -> Path:
    """The largest file of one of the stage's parts, of those that are read for what is delivered."""
    files = (root / "store" / stage).rglob("rasters.parquet" if stage == "terrain" else "table.parquet")
    return max(files, key=lambda p: (p.stat().st_size, str(p)))


def repaired(root: Path) -> None:
    store = open_store(root, lists=True)
    remove(verify(store), store)


@stages("height", "terrain", *LATER)
def test_nothing_is_made_of_a_flipped_bit(survey, copy, clean, stage):
    path = a_file_of(copy, stage)
    part = path.relative_to(copy / "store" / stage).parts[0]
    flip(path)
    before = (copy / "current").readlink()
    try:
        told = [o.message for o in walk(survey, copy, *CHANGED)[0].failures]
    except DamagedError as fault:  # the report draws the terrain
        told = [str(fault)]
    assert told and all("is not what was written" in m and "--verify" in m and str(path) in m for m in told)
    assert (copy / "current").readlink() == before
    verified = verify(Store(copy, read_only=True))
    assert [d.name for d in verified.parts] == [(stage, part)]
    repaired(copy)
    runner, _ = walk(survey, copy, *CHANGED)
    assert not runner.failures and delivered(copy) == clean


@stages("terrain", "height", *LATER)
def test_what_was_made_of_a_flipped_bit_goes_with_it(survey, copy, clean, monkeypatch, stage):
    """As of before files were held to their digests: the receipts of all that follows look sound."""
    flip_a_value(a_file_of(copy, stage))
    with monkeypatch.context() as patch:
        patch.setattr("fwclass.store.directory.check_file", lambda path, digest: None)
        runner, _ = walk(survey, copy, *CHANGED)
    assert not runner.failures
    verified = verify(Store(copy, read_only=True))
    after = {s for s, _ in verified.descendants}
    assert {"publish-tile" if stage != "terrain" else "publish-rasters"} <= after and "index" not in after
    repaired(copy)
    walk(survey, copy, *CHANGED)
    assert delivered(copy) == clean and verify(Store(copy)).sound


def test_the_advice_of_status_leads_back(survey, copy, expected):
    path = a_file_of(copy, "features")
    flip(path)
    flip(next((copy / "current" / "laz" / "tiles").iterdir()).resolve())
    assert fwclass("status", copy).returncode == 0
    found = json.loads(fwclass("status", copy, "--verify", "--json").stdout)
    part = path.parents[1].name
    assert {"stage": "features", "part": part, "files": ["table.parquet"]} in found["damaged"]
    assert {"stage": "classify", "part": part} in found["made_from_damaged"]
    assert [n.split("/")[1:3] for n in found["damaged_delivered"]] == [["laz", "tiles"]]
    told = fwclass("status", copy, "--verify")
    assert told.returncode == 3
    command = shlex.split(told.stdout.splitlines()[-1].partition(": ")[2])
    assert command[:2] == ["fwclass", "run"] and command[-1] == "--verify"
    ended = fwclass(*command[1:], "--workers", "0")
    assert ended.returncode == 0 and "is not what was delivered" in ended.stderr, ended.stderr
    assert delivered(copy) == expected and (copy / "current").readlink().name == "0002"
    assert fwclass("status", copy, "--verify").returncode == 0


@pytest.mark.parametrize("how", ["gone", "shorter", "report", "counts"])
def test_a_run_restores_what_its_delivery_has_lost(survey, copy, expected, how):
    """Copies, as on file systems without hard links."""
    beside = {"report": "report.html", "counts": "assess.parquet"}
    lost = (copy / "current" / beside[how] if how in beside else next((copy / "parquet").iterdir())).resolve()
    held = lost.read_bytes()
    lost.unlink()
    if how == "shorter":
        lost.write_bytes(held[:-1])
    changed = held.replace(b"a", b"b")
    if how == "report":
        lost.write_bytes(changed)
    walk(survey, copy, *SMALL)
    assert (copy / "current").readlink().name == "0002" and delivered(copy) == expected
    assert how != "report" or (copy / "current" / "report.html").read_bytes() != changed
    assert how != "counts" or (copy / "current" / "assess.parquet").read_bytes() == held
    assert not (copy / "generations" / "0001").exists()
    walk(survey, copy, *SMALL)
    assert (copy / "current").readlink().name == "0002"
    assert verify(Store(copy)).sound


def test_the_manifest_names_every_file(copy):
    current = (copy / "current").resolve()
    files = json.loads((current / "manifest.json").read_text())["files"]
    assert set(files) == {p.relative_to(current).as_posix() for p in current.rglob("*") if p.is_file()} - {
        "generation.json",
        "manifest.json",
    }
    assert not (copy / "manifest.json").is_symlink()
    flip(current / "manifest.json")
    assert verify(Store(copy)).delivered == {"0001": ("manifest.json",)}
    flip(current / "generation.json")
    assert verify(Store(copy)).delivered == {"0001": ("generation.json",)}


def test_earlier_deliveries_and_copies_elsewhere_are_verified(survey, copy, tmp_path):
    """What was delivered before stays as it was written, or is told; what was copied is held to its own manifest."""
    walk(survey, copy, *CHANGED)
    first = copy / "generations" / "0001"
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(first, elsewhere)
    sound = fwclass("status", elsewhere, "--verify")
    assert sound.returncode == 0 and "this delivery have the bytes" in sound.stdout
    flip(first / "report.html")
    told = fwclass("status", copy, "--verify")
    assert told.returncode == 3 and "damaged  generations/0001/report.html" in told.stdout
    assert told.stdout.splitlines()[-1].endswith(f"fwclass clean {copy} --keep latest")
    walk(survey, copy, *CHANGED)  # a run makes none of it, and removes none of it
    assert (copy / "current").readlink().name == "0002" and first.is_dir()
    assert fwclass("clean", copy, "--keep", "latest").returncode == 0
    assert verify(Store(copy)).sound and not first.exists()
    flip(elsewhere / "laz" / "tiles" / min(p.name for p in (elsewhere / "laz" / "tiles").iterdir()))
    (elsewhere / "report.json").unlink()
    told = fwclass("status", elsewhere, "--verify", "--json")
    assert told.returncode == 3
    assert {n.split("/")[0] for n in json.loads(told.stdout)["damaged_delivered"]} == {"laz", "report.json"}
    (elsewhere / "generation.json").write_text("{}")
    assert fwclass("status", elsewhere, "--verify").returncode == 1


@pytest.mark.slow
def test_object_storage_is_watched_too(survey, expected, tmp_path, monkeypatch):
    """A part's object and delivered ones: flipped, written over, removed."""
    with serving() as s3:
        for name, value in used(s3, tmp_path / "copies").items():
            monkeypatch.setenv(name, value)
        place, out = s3.url("survey"), s3.url()
        s3.write_all(place, survey, "strips", "reference")
        s3.write(place / "trajectory.csv", (survey / "trajectory.csv").read_bytes())
        location = Remote(out, quick())
        walk(place, location, *SMALL)
        assert s3.delivered(out) == expected
        keys = s3.keys(out)

        def lose(kind: str, written_over: bool) -> None:
            below = json.loads(s3.read(out)["current.json"])["address"]
            key = next(k for k in s3.keys(out) if k.startswith(f"{below}/{kind}"))
            if not written_over:
                s3.remove(out / key)
            else:
                s3.write(out / key, bytes(len(s3.read(out)[key])))

        lose("laz", False)
        walk(place, location, *SMALL)
        assert open_store(location).generations.current().number == 2 and s3.delivered(out) == expected
        lose("parquet", True)
        walk(place, location, *SMALL)
        assert open_store(location).generations.current().number == 3 and s3.delivered(out) == expected
        part = next(k for k in keys if k.startswith("store/features/") and k.endswith("table.parquet"))
        held = bytearray(s3.read(out)[part])
        held[len(held) // 2] ^= 1
        s3.write(out / part, bytes(held))
        monkeypatch.setenv("FWCLASS_SCRATCH", str(tmp_path / "other"))
        runner, _ = walk(place, location, *CHANGED)
        assert runner.failures and all("not what was written" in o.message for o in runner.failures)
        store = open_store(location, lists=True)
        verified = verify(store)
        assert [d.stage for d in verified.parts] == ["features"] and not verified.delivered
        remove(verified, store)
        walk(place, location, *SMALL)
        assert s3.delivered(out) == expected
        assert verify(open_store(location, lists=True)).sound


def test_a_copy_on_this_host_that_rots_is_fetched_again(tmp_path, monkeypatch):
    with serving() as s3:
        for name, value in used(s3, tmp_path / "copies").items():
            monkeypatch.setenv(name, value)
        store = open_store(Remote(s3.url(), quick()))

        def work(directory: Path) -> dict:
            (directory / "made").write_bytes(b"sound" * 100)
            return {}

        store.commit("one", "a", "k", {}, "store", work)
        path = store.path("one", "a", "made")
        flip(path)
        assert store.path("one", "a", "made").read_bytes() == b"sound" * 100


def test_a_run_that_lost_its_words_is_verified_all_the_same(copy):
    """`run.json` says what was asked for; what was made is held to its digests without it."""
    (copy / "store" / "run.json").write_text('{"conf": ')
    ended = fwclass("status", copy, "--verify")
    assert ended.returncode == 3 and "run.json" in ended.stderr and "have the bytes that were written" in ended.stdout
    part = next((copy / "store" / "height").glob("*/*/table.parquet"))
    part.chmod(0o644)
    flip(part)
    ended = fwclass("status", copy, "--verify", "--json")
    assert ended.returncode == 3 and json.loads(ended.stdout)["damaged"][0]["stage"] == "height"
    assert fwclass("status", copy).returncode == 1


def test_no_flipped_bit_of_what_a_run_remembers_is_believed(tmp_path):
    """`run.json` and `inputs.json`: most flips leave sound JSON, of another configuration or of other digests."""
    store = Store(tmp_path)
    kept = Request("a.yaml", str(tmp_path), ("tile.size=50",), tiles=("1_1",))
    kept.keep(store)
    source = tmp_path / "a.las"
    source.write_bytes(b"points")
    digests = Digests(store)
    known = digests.of([source])
    digests.save()
    for name in ("run.json", "inputs.json"):
        path = tmp_path / "store" / name
        whole = path.read_bytes()
        for bit in range(8 * len(whole)):
            data = bytearray(whole)
            data[bit // 8] ^= 1 << bit % 8
            path.write_bytes(data)
            with contextlib.suppress(StoreError):
                assert Request.kept(store) == kept
            assert Digests(store).of([source]) == known
        path.write_bytes(whole)
