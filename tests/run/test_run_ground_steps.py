"""What a ground command tells while it works, and what it knows of stray points."""

from __future__ import annotations

import io
import os
import time

import numpy as np
import pytest
from rich.console import Console

from fwclass import compiling
from fwclass.errors import InputError
from fwclass.read.cloud import read_point_cloud
from fwclass.single_file.ground.file import GroundJob, ground_file
from fwclass.single_file.ground.steps import StepDisplay
from fwclass.single_file.ground.stray import describe_stray, stray_points


def test_lines_come_now_and_then_and_say_what_is_done():
    file = io.StringIO()
    with StepDisplay(Console(file=file, soft_wrap=True), every=0.05) as steps:
        steps.tell("filter smrf: block 3 of [16]")
        time.sleep(0.3)
        steps.say("kept")
    lines = file.getvalue().splitlines()
    assert 2 <= len(lines) <= 8 and "filter smrf: block 3 of [16]" in lines[0] and lines[-1] == "kept"


def test_a_short_command_says_nothing():
    file = io.StringIO()
    with StepDisplay(Console(file=file)) as steps:
        steps.tell("reading")
    assert file.getvalue() == ""


def test_a_person_sees_the_step():
    file = io.StringIO()
    with StepDisplay(Console(file=file, force_terminal=True, width=80)) as steps:
        steps.tell("filter smrf: block 3 of 16")
        time.sleep(0.3)
    assert "block 3 of 16" in file.getvalue()


@pytest.mark.parametrize("terminal", [False, True])
def test_compiling_is_named_and_timed(monkeypatch, terminal):
    monkeypatch.setattr(compiling, "NOTIFY_AFTER", 0.2)
    monkeypatch.setattr(compiling, "_spent", 0.0)
    file = io.StringIO()
    with StepDisplay(Console(file=file, force_terminal=terminal, width=80)) as steps:
        steps.tell("filter smrf")
        with compiling._timed("a"):
            time.sleep(0.5)
            assert steps.line == f"filter smrf ({compiling.ONCE})"
        assert steps.line == "filter smrf"
    shown = file.getvalue()
    assert compiling.ONCE in shown if terminal else shown == f"filter smrf ({compiling.ONCE})\n"
    assert compiling.compile_seconds() >= 0.5


def test_a_file_tells_its_steps(tmp_path):
    path = tmp_path / "a.txt"
    np.savetxt(path, np.random.default_rng(0).uniform(0, 50, (500, 3)) * [1, 1, 0.01], fmt="%.2f")
    heard = []
    made = ground_file(GroundJob(path, tmp_path / "o.txt", rasters={"dtm": tmp_path / "d.tif"}), heard.append)
    assert heard == ["reading", "filter smrf: block 1 of 1", "terrain", "writing"]
    assert made["seconds"]["filter"] + made["seconds"]["compiling"] <= made["seconds"]["all"]


@pytest.mark.parametrize("kind", ["replaced", "written over", "gone"])
def test_a_file_that_changes_between_reading_and_writing_is_told(tmp_path, kind):
    """Points of another file got the classes of the first one's, exit code 0."""
    path, other = tmp_path / "a.txt", tmp_path / "b.txt"
    for k, name in enumerate((path, other)):
        np.savetxt(name, np.random.default_rng(k).uniform(0, 50, (500, 3)) * [1, 1, 0.01], fmt="%05.2f")
    facts = path.stat()

    def change(step):
        if step != "writing":
            return
        if kind == "replaced":
            other.replace(path)
        elif kind == "written over":
            path.write_bytes(other.read_bytes())
        else:
            path.unlink()
        if path.exists():
            assert path.stat().st_size == facts.st_size
            os.utime(path, ns=(facts.st_atime_ns, facts.st_mtime_ns))

    with pytest.raises(InputError):
        ground_file(GroundJob(path, tmp_path / "o.txt"), change)


@pytest.mark.parametrize("east, stray", [(0.0, 0), (200.0, 0), (3000.0, 1), (-3000.0, 1), (9e7, 1)])
def test_a_point_is_stray_far_from_all_others(tmp_path, east, stray):
    path = tmp_path / "a.txt"
    xyz = np.vstack([np.random.default_rng(0).uniform(0, 200, (500, 3)), [[east + 20.0, 20.0, 5.0]]])
    np.savetxt(path, xyz, fmt="%.2f")
    cloud = read_point_cloud(path)
    rows = stray_points(cloud, cloud.usable)
    assert rows.tolist() == [500][:stray]
    assert describe_stray(cloud, rows) == (
        f"1 point lies far from all others, at x {east + 20:.2f}, y 20.00" if stray else ""
    )


def test_places_of_equally_few_points_are_no_strays(tmp_path):
    path = tmp_path / "a.txt"
    np.savetxt(path, [[1000.0 * k, 0.0, 0.0] for k in range(20)], fmt="%.2f")
    cloud = read_point_cloud(path)
    assert len(stray_points(cloud, cloud.usable)) == 0
