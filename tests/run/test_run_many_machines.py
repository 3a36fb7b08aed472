"""Runs whose survey, store and outputs lie on object storage: the same bytes as on a disk, whatever happens."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.dataset
import pyarrow.fs
import pytest
import rasterio
from commandline import fwclass
from objectstore import Server, Trouble, quick, serving, used
from runmaker import SETTINGS, delivered, walk

from fwclass.store.bucket import Remote
from fwclass.store.url import Url

QUICK = tuple(f"store.{n}={v}" for n, v in quick().model_dump().items() if v is not None)


@pytest.fixture(scope="module")
def s3(survey: Path) -> Iterator[Server]:
    with serving() as server:
        yield server


@pytest.fixture(scope="module")
def stored(s3: Server, survey: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Url, Url]:
    """The survey on object storage, and a run over it in the plain loop."""
    place, out = s3.url("delivery 7"), s3.url("run")
    s3.write_all(place, survey, "strips", "reference")
    s3.write(place / "trajectory.csv", (survey / "trajectory.csv").read_bytes())
    with pytest.MonkeyPatch.context() as patch:
        for name, value in used(s3, tmp_path_factory.mktemp("copies")).items():
            patch.setenv(name, value)
        road, _ = walk(place, Remote(out, quick()), *QUICK)
    assert not road.failures, road.failures
    assert all(o.status == "computed" for o in road.outcomes.values())
    return place, out


@pytest.fixture
def host(s3: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """This process as one of a host that has seen nothing yet."""
    for name, value in used(s3, tmp_path / "copies").items():
        monkeypatch.setenv(name, value)
    return tmp_path


def words(place: Url, out: Url) -> list[str]:
    """The command that makes the run."""
    settings = (*SETTINGS, *QUICK, f"survey.directory={place}")
    return ["demo", "--out", out, *(w for s in settings for w in ("--set", s))]


@pytest.mark.slow
def test_a_run_on_object_storage_delivers_the_bytes_of_one_on_a_disk(s3, stored, finished, host):
    """And another host makes nothing again, and programs read what is current as the manual says."""
    place, out = stored
    assert s3.delivered(out) == delivered(finished[0])
    before = s3.read(out)
    assert not [k for k in before if k.startswith(("store/staging", "store/failures", "generations/.pending"))]
    s3.faults.seen.clear()
    road, report = walk(place, Remote(out, quick()), *QUICK)
    assert {o.status for o in road.outcomes.values()} == {"skipped"}
    assert report["accuracy"] is not None
    after = s3.read(out)
    assert after.keys() == before.keys()
    assert {k for k in before if before[k] != after[k]} == {"store/probe"}
    assert not [path for method, path in s3.faults.seen if method == "PUT" and not path.endswith(("lock", "probe"))]
    _read_as_the_manual_says(s3, out)


@pytest.mark.slow
def test_seams_and_damage_are_seen_on_object_storage(s3, stored, survey, host):
    """What the storage holds is looked at, not the copies of this host."""
    place, out = stored
    assert fwclass("run", *words(place, out), "--workers", 0).returncode == 0  # it leaves what was asked for
    ended = fwclass("seams", out, "--share", "0.3", "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["equal"] and told["run"] == str(out)
    assert sum(stage["rows"] for stage in told["bounded"]) > 1000
    assert fwclass("status", out, "--verify").returncode == 0
    keys = sorted(k for k in s3.read(out) if k.startswith("store/classify/") and k.endswith("table.parquet"))
    whole = s3.read(out)[keys[0]]
    for broken in (whole[:-40] + bytes([whole[-40] ^ 1]) + whole[-39:], whole[:-1]):
        s3.write(out / keys[0], broken)
        ended = fwclass("status", out, "--verify")
        assert ended.returncode == 3, ended.stderr
        part = "/".join(keys[0].split("/")[1:3])
        if len(broken) == len(whole):
            assert f"damaged  {part}: table.parquet" in ended.stdout
            assert "class-block " in ended.stdout.partition("made from these: ")[2]
            assert ended.stdout.rstrip().endswith(" --verify") and f"--out {out}" in ended.stdout
    s3.write(out / keys[0], whole)
    assert fwclass("status", out, "--verify").returncode == 0


def _read_as_the_manual_says(s3: Server, out: Url) -> None:
    address = s3.address.removeprefix("http://")
    fs = pyarrow.fs.S3FileSystem(
        access_key="test",
        secret_key="test",  # noqa: S106
        endpoint_override=address,
        scheme="http",
    )
    run = out.removeprefix("s3://")
    with fs.open_input_stream(f"{run}/current.json") as stream:
        below = f"{run}/{json.load(stream)['address']}"
    assert pyarrow.dataset.dataset(f"{below}/parquet", filesystem=fs).count_rows() > 10_000
    with pytest.MonkeyPatch.context() as patch:  # for GDAL, whose words for another server than Amazon's are its own
        for name, value in (("AWS_S3_ENDPOINT", address), ("AWS_HTTPS", "NO"), ("AWS_VIRTUAL_HOSTING", "FALSE")):
            patch.setenv(name, value)
        with rasterio.open(f"/vsis3/{below}/rasters/dtm.tif") as raster:
            assert np.isfinite(raster.read(1)).any()


@pytest.mark.slow
def test_a_second_time_a_host_asks_for_lists_not_for_receipts(s3, stored, host):
    place, out = stored
    walk(place, Remote(out, quick()), *QUICK)
    s3.faults.seen.clear()
    walk(place, Remote(out, quick()), *QUICK)
    assert not [path for _, path in s3.faults.seen if path.endswith(("receipt.json", ".las", ".wdp"))]
    assert len([path for _, path in s3.faults.seen if not path.endswith("lock")]) < 40


@pytest.mark.slow
def test_status_tells_of_a_run_on_object_storage(s3, stored, host):
    ended = fwclass("status", stored[0].parent / "nothing-here")
    assert ended.returncode == 2
    assert "no such run directory" in ended.stderr
    ended = fwclass("status", *words(*stored), "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert (told["done"], told["running"], told["not_in_plan"]) == (True, None, {})
    ended = fwclass("status", *words(*stored), "--set", "train.trees=11")
    assert ended.returncode == 3
    assert "parameter trees" in ended.stdout
    shown = s3.read(stored[1])["current.json"]
    s3.write(stored[1] / "current.json", shown[:-9])
    ended = fwclass("status", *words(*stored))
    assert ended.returncode == 3 and "readers do not see them yet" in ended.stdout
    s3.write(stored[1] / "current.json", shown)


@pytest.mark.slow
def test_a_part_alone_and_what_is_read_of_a_part_that_lost_an_object(s3, stored, host):
    place, out = stored
    gone = next(k for k in s3.read(out) if k.startswith("store/class-block/") and not k.endswith("receipt.json"))
    part = gone.split("/")[2]
    s3.remove(out / gone)
    ended = fwclass("status", *words(place, out))
    assert ended.returncode == 3
    assert "is gone" in ended.stdout
    ended = fwclass("run", *words(place, out), "--only", f"class-block/{part}")
    assert ended.returncode == 0, ended.stderr
    assert fwclass("status", *words(place, out)).returncode == 0


def test_commands_that_take_files_of_this_host_say_so(tmp_path):
    ended = fwclass("info", "s3://bucket/a.las")
    assert ended.returncode == 2
    assert "on object storage, and this command takes files of this host" in ended.stderr
    ended = fwclass("run", "demo", "--out", "s3://bucket/run/../other")
    assert ended.returncode == 2
    assert "no place on object storage" in ended.stderr


def test_a_simulated_survey_is_refused_there(s3, host):
    ended = fwclass("run", "demo", "--out", s3.url(), "--workers", "0", *(w for s in QUICK for w in ("--set", s)))
    assert ended.returncode == 2
    assert "simulated survey cannot lie on object storage" in ended.stderr


@pytest.mark.faults
@pytest.mark.slow
def test_a_run_in_trouble_all_the_way_delivers_the_same_bytes(s3, stored, finished, host):
    out = s3.url()
    count = [0]

    def every(n: int, of: int):
        def meant(method: str, path: str) -> bool:
            count[0] += n == 0
            return count[0] % of == n

        return meant

    troubles = [
        Trouble("busy", 100, every(0, 17)),
        Trouble("torn", 100, every(3, 17)),
        Trouble("deaf", 60, every(5, 17)),
        Trouble("slow", 60, every(7, 17), seconds=0.2),
    ]
    with s3.trouble(*troubles):
        road, _ = walk(stored[0], Remote(out, quick(dead=5.0)), *QUICK)
    assert not road.failures, road.failures
    assert sum(t.times for t in troubles) < 150  # they were met
    assert s3.delivered(out) == delivered(finished[0])


@pytest.mark.faults
@pytest.mark.slow
def test_a_store_that_stops_answering_ends_in_words(s3, stored, host):
    out, patient = s3.url(), quick(patience=0.5)
    uploads = Trouble("busy", 10**6, lambda method, path: method == "PUT" and "/ground-filter/" in path)
    with s3.trouble(uploads):
        road, _ = walk(stored[0], Remote(out, patient), *QUICK)
    failed = [o for o in road.outcomes.values() if o.status == "failed"]
    assert {o.stage for o in failed} == {"ground-filter"}
    assert "does not answer as it should" in failed[0].message
    assert "ground-filter" in failed[0].message
    assert os.environ["AWS_ENDPOINT_URL"] == s3.address


@pytest.mark.slow
def test_a_survey_larger_than_the_copies_that_a_host_may_keep(s3, stored, finished, host, monkeypatch):
    monkeypatch.setattr("fwclass.store.scratch.KEPT", 6)
    small = quick(scratch_gib=3e6 / 2**30)
    out = Remote(s3.url(), small)
    road, _ = walk(stored[0], out, *QUICK, f"store.scratch_gib={small.scratch_gib}")
    assert not road.failures, road.failures
    assert s3.delivered(out.url) == delivered(finished[0])
    assert out.scratch.fetched > 30e6  # copies went and came again
