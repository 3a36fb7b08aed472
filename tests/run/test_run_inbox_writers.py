"""Files that somebody still writes: they are not taken, or the run that they owe is made when they are whole."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest
from plsmaker import survey as pulses
from schedulemaker import FAILS_AT_ONCE, NOWHERE, strip, under_way, until

from fwclass import conf
from fwclass.errors import InputError
from fwclass.operate.schedule import delivery, watch
from fwclass.operate.schedule.inbox import Inbox
from fwclass.operate.schedule.intake import Intake
from fwclass.operate.schedule.source_directories import SourceDirectories
from fwclass.operate.schedule.state import ScheduleState
from fwclass.operate.schedule.ticks import Now
from fwclass.read.cloud import read_point_cloud
from fwclass.read.pls_waves import read_records
from fwclass.read.points import ZEROS
from fwclass.read.source import PulseSource, open_source


@pytest.fixture
def intake(tmp_path: Path) -> Intake:
    """An inbox ``in`` of the survey ``data``, which takes what has not changed for 10 s."""
    for name in ("in", "data", "r"):
        (tmp_path / name).mkdir()
    params = conf.section("schedule", ("schedule.settle=10",))
    inbox = Inbox(tmp_path / "in", SourceDirectories((str(tmp_path / "data" / "*.las"),), None), params)
    said: list[str] = []
    state = ScheduleState(tmp_path / "r", {}, 30.0, 5.0, said.append)
    return Intake(inbox, tmp_path / "r", state, said.append)


def waits(intake: Intake, at: float) -> str:
    look = intake.inbox.look(Now(0.0, at))
    return look.waiting[0].why if look.waiting else ""


def test_a_file_that_a_process_has_open_for_writing_is_waited_for(intake: Intake) -> None:
    path = strip(intake.inbox.directory / "a.las")
    waits(intake, 0.0)
    code = "import sys; open(sys.argv[1], sys.argv[2]); print(flush=True); sys.stdin.read()"
    for mode, taken in (("r+b", False), ("rb", True)):
        line = [sys.executable, "-c", code.replace("open(", "f = open("), str(path), mode]
        with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
            assert other.stdout is not None and other.stdout.readline()
            assert (f"process {other.pid} has it open" in waits(intake, 100.0)) is not taken
            if not taken:
                (path.parent / "a.las.done").touch()  # who sends it says that it is whole
                assert not waits(intake, 100.0)
                (path.parent / "a.las.done").unlink()
            other.communicate(b"")
    assert not waits(intake, 100.0) and len(intake.deliveries(Now(0.0, 100.0))) == 1


def unwritten(path: Path, first: int, last: int) -> None:
    """Zeros instead of the points [first, last)."""
    with laspy.open(path) as las:
        start, length = las.header.offset_to_point_data, las.header.point_format.size
    with path.open("r+b") as stream:
        stream.seek(start + first * length)
        stream.write(bytes((last - first) * length))


def test_a_file_that_was_set_aside_in_full_and_not_written_to_its_end_is_waited_for(intake: Intake) -> None:
    path = strip(intake.inbox.directory / "a.las")
    unwritten(path, 130, 400)
    waits(intake, 0.0)
    assert "nothing but zeros" in waits(intake, 10.0) and "270, the first of them point 130" in waits(intake, 10.0)
    strip(path)
    waits(intake, 20.0)
    assert not waits(intake, 30.0)


def test_points_that_were_never_written_are_refused(tmp_path: Path) -> None:
    path = strip(tmp_path / "a.las")
    unwritten(path, 7, 7 + ZEROS)
    assert len(read_point_cloud(path).x) == 400
    unwritten(path, 7, 8 + ZEROS)
    with pytest.raises(InputError, match=f"{ZEROS + 1}, the first of them point 7"):
        read_point_cloud(path)


def test_pulses_that_were_never_written_are_refused(tmp_path: Path) -> None:
    pulses(tmp_path / "a.pls", pulses=100)
    source = open_source(tmp_path / "a.pls")
    assert isinstance(source, PulseSource) and len(read_records(source, 0, 100)) == 100
    with source.path.open("r+b") as stream:
        stream.seek(source.header.pulses_start + 5 * source.header.pulse_size)
        stream.write(bytes(20 * source.header.pulse_size))
    with pytest.raises(InputError, match="20, the first of them pulse 5"):
        read_records(source, 0, 100)


def test_points_at_one_place_are_points(tmp_path: Path) -> None:
    """On the offset, with values of their own: nothing was left out."""
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.x = las.y = las.z = np.zeros(100)
    las.return_number = las.number_of_returns = np.ones(100, np.uint8)
    las.write(tmp_path / "a.las")
    assert len(read_point_cloud(tmp_path / "a.las").x) == 100


def test_a_file_that_is_written_to_after_the_move_owes_a_run(intake: Intake) -> None:
    strip(intake.inbox.directory / "a.las")
    intake.deliveries(Now(0.0, 0.0))
    intake.deliver(intake.deliveries(Now(0.0, 10.0)))
    path = intake.inbox.directory.parent / "data" / "a.las"
    intake.state.owed = []  # it was run
    intake.look_again(Now(0.0, 20.0))
    assert not intake.state.owed
    facts = path.stat()
    unwritten(path, 0, 1)
    os.utime(path, ns=(facts.st_atime_ns, facts.st_mtime_ns))  # as `rsync -t`: the time of its entry tells
    intake.look_again(Now(0.0, 21.0))
    assert not intake.state.owed  # it may still change
    intake.look_again(Now(0.0, 31.0))
    assert intake.state.owed == ["a.las"]
    intake.state.owed = []
    intake.look_again(Now(0.0, 50.0))
    assert not intake.state.owed
    unwritten(path, 0, 2)
    intake.look_again(Now(0.0, 51.0), settled=False)  # the schedule ends
    assert intake.state.owed == ["a.las"]
    path.unlink()
    intake.look_again(Now(0.0, 90.0))


def test_a_copy_to_another_disk_is_of_a_file_at_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, copyfile = strip(tmp_path / "a.las"), shutil.copyfile

    def copy(a: Path, b: Path) -> None:
        copyfile(a, b)
        unwritten(a, 0, 1)

    monkeypatch.setattr(delivery.shutil, "copyfile", copy)
    with pytest.raises(OSError, match="written to while it was copied"):
        delivery._copy(source, tmp_path / "b.las")
    assert [p.name for p in tmp_path.iterdir()] == ["a.las"]


def test_who_writes_is_looked_for_where_something_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "a").open("w"):
        assert watch.writers([tmp_path / "a"]) == {tmp_path / "a": os.getpid()}
    assert watch.writers([tmp_path / "a", tmp_path / "none"]) == {}
    monkeypatch.setattr(watch.os, "scandir", lambda path: pytest.fail("nothing is asked for"))
    assert watch.writers([]) == {}


@pytest.mark.slow
def test_a_schedule_runs_again_what_was_written_to_after_the_move(tmp_path: Path) -> None:
    (tmp_path / "data" / "strips").mkdir(parents=True)
    (tmp_path / "in").mkdir()
    (tmp_path / "c.yaml").write_text(FAILS_AT_ONCE)
    line = [sys.executable, "-m", "fwclass", "schedule", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "r")]
    log = tmp_path / "log"
    with under_way([*line, "--inbox", str(tmp_path / "in"), "--set", NOWHERE], log):
        strip(tmp_path / "b.las").rename(tmp_path / "in" / "a.las")
        until(lambda: log.read_text().count("run ended") == 1)
        unwritten(tmp_path / "data" / "strips" / "a.las", 0, 1)
        until(lambda: log.read_text().count("run ended") == 2)
    assert "a.las: changed after the move into the survey: run again" in log.read_text()


@pytest.mark.parametrize(
    "note",
    ['{"owed": 5}', '{"owed": {"a": 1}}', '{"owed": [1, null, "a.las"]}', "[]", '{"last": 7}', "{"]
    + [f'{{"last_tick": {tick}}}' for tick in ("-1e300", "NaN", "Infinity", "-1e11", "1e12", '"x"', "true")],
)
def test_a_note_of_another_kind_ends_no_schedule(intake: Intake, tmp_path: Path, note: str) -> None:
    """`schedule.json` may be anybody's: each start ended with a traceback until it was removed."""
    (tmp_path / "r" / "schedule.json").write_text(note)
    intake.state.resume()
    assert intake.state.last_tick in (None, 1.0) and intake.state.owed in ([], ["a.las"])
    intake.state.write(Now(0.0, 0.0), always=True)


def test_a_delivery_that_cannot_be_moved_holds_up_no_other(intake: Intake, tmp_path: Path) -> None:
    """A directory of its name in the survey held up all that followed in the alphabet, for ever."""
    for name in ("a.las", "b.las", "c.las"):
        strip(tmp_path / "in" / name)
    (tmp_path / "data" / "b.las").mkdir()
    intake.deliveries(Now(0.0, 0.0))
    ready = intake.deliveries(Now(0.0, 20.0))
    assert [d.name for d in ready] == ["a.las", "b.las", "c.las"]
    assert [facts["name"] for facts in intake.deliver(ready)] == ["a.las", "c.las"]
    assert intake.state.owed == ["a.las", "c.las"]
    assert [w["name"] for w in intake.state.waiting] == ["b.las"] and "cannot be moved" in intake.state.waiting[0][
        "why"
    ]
    (tmp_path / "data" / "b.las").rmdir()
    again = intake.deliveries(Now(0.0, 40.0))
    assert [facts["name"] for facts in intake.deliver(again)] == ["b.las"] and intake.state.owed[-1] == "c.las"
