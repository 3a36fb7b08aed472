"""Relabelling by the server: what is counted is what is written; undo, two pages, a new delivery, a full disk."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from drawn import box, drawn, drawn_classes, marked
from smallsurvey import deliver

from fwclass import conf
from fwclass.cli import cli
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_command import LastCommand
from fwclass.delivery.viewed_corrections import CorrectionRows
from fwclass.errors import InputError, StoreError
from fwclass.formats.echo_labels import TAKEN_BACK
from fwclass.store.corrections import CORRECTIONS, read_corrections
from fwclass.view.guard import DELIVERY, TOKEN
from fwclass.view.scene import Replaced
from fwclass.view.selection import Selection
from fwclass.view.server import Server

SPOT = box(500_040, 5_400_005, 500_060, 5_400_025)
"""Over two tiles of 25 m."""
COLUMNS = ("x", "y", "z", "strip", "pulse", "echo_number", "classification", "confidence", "height_above_ground")


def opened(root: Path, **settings: object) -> ViewedRun:
    named = {"block": 1000, "together": 1000} | settings
    return ViewedRun(open_run(root), conf.section("view", tuple(f"view.{n}={v}" for n, v in named.items())))


@pytest.fixture
def scene(small_run: Path) -> ViewedRun:
    return opened(small_run)


def delivered(scene: ViewedRun) -> dict[str, np.ndarray]:
    """Every echo, in the order of the tiles."""
    parts = [scene.open.columns(key, COLUMNS) for key in scene.tiles]
    return {n: np.concatenate([p[n] for p in parts]) for n in COLUMNS}


@pytest.mark.slow
def test_classes_that_are_given_are_those_that_a_run_learns(small_run: Path) -> None:
    """Unsure echoes have a code and a name, and are shown so; it is no class to give, as in `label collect`."""
    deliver(small_run.parent, "classify.leave=1", "classify.unsure=0.95")
    scene = opened(small_run)
    assert {c["code"] for c in scene.index()["classes"]} == {1, 2, 5}
    assert [c["code"] for c in scene.relabel.begin()["classes"]] == [2, 5]
    told = scene.relabel.select(Selection.of(drawn(SPOT)))
    with pytest.raises(InputError, match=r"expected: 2 \(ground\), 5 \(bush\), 0 for no class\n(.|\n)*got: 1"):
        scene.relabel.correct(told["selection"], 1)
    assert scene.relabel.correct(told["selection"], 0)["echoes"] == told["echoes"]


@pytest.mark.slow
def test_of_a_ground_filters_classes_none_is_given(small_run: Path) -> None:
    """A run that trains would refuse them: the survey's own classes are offered, and what learns from them is said."""
    words = ["run", str(small_run.parent / "s.yaml"), "--workflow", "ground", "--out", str(small_run.parent / "ground")]
    assert CliRunner().invoke(cli, [*words, "--workers", "0"]).exit_code == 0
    scene = opened(small_run.parent / "ground")
    assert {c["code"] for c in scene.index()["classes"]} >= {1, 2, 7, 18}
    begun = scene.relabel.begin()
    assert [c["code"] for c in begun["classes"]] == [2, 5] and "--workflow ground" in begun["says"]
    assert not opened(small_run).relabel.begin()["says"]


def test_what_is_counted_is_marked_and_written(scene: ViewedRun, small_run: Path) -> None:
    every = delivered(scene)
    told = scene.relabel.select(Selection.of(drawn(SPOT, classes=[2])))
    (x0, y0), (x1, y1) = SPOT[0], SPOT[2]
    inside = (every["x"] > x0) & (every["x"] < x1) & (every["y"] > y0) & (every["y"] < y1)
    expected = np.flatnonzero(inside & (every["classification"] == 2))
    assert told["echoes"] == len(expected) > 100 and told["tiles"] == 2 and told["classes"] == {"2": len(expected)}
    marks = marked(scene.relabel.marks(told["selection"]))
    assert sum(map(len, marks.values())) == len(expected)
    for node, rows in list(marks.items())[:5]:
        assert all(scene.echo(node, row)["values"]["classification"] == 2 for row in rows)

    before = drawn_classes(scene)
    written = scene.relabel.correct(told["selection"], 5)
    assert written["echoes"] == len(expected) and written["left"] == 0
    rows = pq.read_table(small_run / CORRECTIONS).to_pandas()
    identity = ["strip", "pulse", "echo_number", "x", "y", "z"]
    assert set(rows["class"]) == {5} and rows["who"].nunique() == 1 and rows["time"].nunique() == 1
    assert sorted(map(tuple, rows[identity].to_numpy().tolist())) == sorted(
        map(tuple, np.stack([every[n][expected].astype(float) for n in identity], axis=1).tolist())
    )
    after = drawn_classes(scene)
    for node, classes in before.items():
        changed = {k for k, (a, b) in enumerate(zip(classes, after[node], strict=True)) if a != b}
        assert changed == set(marks.get(node, {})) and all(after[node][k] == 5 for k in changed)
    node, row = next((n, next(iter(r))) for n, r in marks.items())
    told = scene.echo(node, row)
    assert told["corrected"] == 5 and told["values"]["classification"] == 2
    assert drawn_classes(opened(small_run)) == after  # as after a reload


def test_undo_and_redo_leave_what_others_wrote_since(scene: ViewedRun, small_run: Path) -> None:
    relabel, other = scene.relabel, opened(small_run).relabel
    number = relabel.select(Selection.of(drawn(SPOT)))["selection"]
    first = relabel.correct(number, 5)
    second = relabel.correct(number, 2)
    undone = relabel.revert(second["time"])
    assert undone["echoes"] == second["echoes"] and set(read_corrections(small_run).standing().code) == {5}
    again = relabel.revert(undone["time"])
    assert set(read_corrections(small_run).standing().code) == {2} and again["left"] == 0
    half = other.select(Selection.of(drawn(box(500_040, 5_400_005, 500_050, 5_400_025))))
    other.correct(half["selection"], 0)
    back = relabel.revert(again["time"])
    assert back["left"] == half["echoes"] and back["echoes"] == again["echoes"] - half["echoes"]
    start = relabel.revert(first["time"])  # the step before, where nobody else has given a class
    assert start["echoes"] == back["echoes"] and start["left"] == half["echoes"]
    assert set(read_corrections(small_run).standing().code) == {0, TAKEN_BACK}
    with pytest.raises(InputError, match="cannot be undone"):
        relabel.revert(12345)
    rows = read_corrections(small_run)
    assert rows.rows == sum(w["echoes"] for w in (first, second, undone, again, back, start)) + half["echoes"]
    assert (np.diff(rows.time) >= 0).all()


def test_every_step_is_undone_and_done_again(scene: ViewedRun, small_run: Path) -> None:
    """Three steps over the same echoes, one of another page that takes it back, all back and forth."""
    relabel, other = scene.relabel, opened(small_run).relabel
    number = relabel.select(Selection.of(drawn(SPOT)))["selection"]
    steps = [relabel.correct(number, code) for code in (5, 2, 0)]
    theirs = other.correct(other.select(Selection.of(drawn(SPOT)))["selection"], 5)
    assert relabel.revert(steps[-1]["time"])["echoes"] == 0
    other.revert(theirs["time"])
    undone = []
    for code, step in ((2, steps[2]), (5, steps[1]), (TAKEN_BACK, steps[0])):
        undone.append(relabel.revert(step["time"]))
        assert undone[-1]["echoes"] == step["echoes"] and set(read_corrections(small_run).standing().code) == {code}
    for code, step in ((5, undone[2]), (2, undone[1]), (0, undone[0])):
        assert relabel.revert(step["time"])["left"] == 0 and set(read_corrections(small_run).standing().code) == {code}


def test_taking_back_gives_the_delivered_class(scene: ViewedRun, small_run: Path) -> None:
    before = drawn_classes(scene)
    number = scene.relabel.select(Selection.of(drawn(SPOT)))["selection"]
    scene.relabel.correct(number, 0)
    assert drawn_classes(scene) != before
    taken = scene.relabel.correct(number, None)
    assert taken["standing"] == 0 and drawn_classes(scene) == before
    assert set(read_corrections(small_run).standing().code) == {TAKEN_BACK}
    assert scene.relabel.correct(number, None)["echoes"] == 0  # nothing is written twice


def test_another_page_learns_what_changed(scene: ViewedRun, small_run: Path) -> None:
    """Two servers of one run: what one writes, the other tells its page as marks."""
    other = opened(small_run)
    before, known = drawn_classes(other), other.index()["rows"]
    assert other.relabel.changes(known) == np.array([known, 0], "<u4").tobytes()
    scene.relabel.correct(scene.relabel.select(Selection.of(drawn(SPOT)))["selection"], 5)
    data = other.relabel.changes(known)
    rows, anew = np.frombuffer(data, "<u4", 2)
    assert anew == 0 and rows > known
    for node, changed in marked(data[8:]).items():
        for row, code in changed.items():
            before[node][row] = code
    assert before == drawn_classes(other)
    (small_run / CORRECTIONS).unlink()
    assert np.frombuffer(other.relabel.changes(int(rows)), "<u4").tolist()[1] != 0  # another file: all blocks anew


def test_two_pages_that_write_at_once_lose_nothing(small_run: Path) -> None:
    scenes = [opened(small_run) for _ in range(4)]
    told: list[int] = []

    def work(k: int) -> None:
        corners = box(500_000 + 20 * k, 5_400_000, 500_020 + 20 * k, 5_400_040)
        for code in (2, 5, 2):
            number = scenes[k].relabel.select(Selection.of(drawn(corners)))["selection"]
            told.append(scenes[k].relabel.correct(number, code)["echoes"])

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    rows = read_corrections(small_run)
    assert len(told) == 12 and rows.rows == sum(told) and set(rows.standing().code) == {2}
    assert all(drawn_classes(s) == drawn_classes(scenes[0]) for s in scenes)


def test_rows_of_tiles_are_those_near_them(scene: ViewedRun, small_run: Path) -> None:
    scene.relabel.correct(scene.relabel.select(Selection.of(drawn(SPOT)))["selection"], 5)
    rows = CorrectionRows(read_corrections(small_run), scene.pyramid.size, scene.relabel.corrections.reach)
    for key in scene.tiles:
        i, j = map(int, key.split("_"))
        x, y = rows.labels["x"] / scene.pyramid.size - i, rows.labels["y"] / scene.pyramid.size - j
        near = scene.relabel.corrections.reach / scene.pyramid.size
        mine = (x > -near) & (x < 1 + near) & (y > -near) & (y < 1 + near)
        assert rows.of(key).rows == mine.sum()
        assert (rows.version(key) >= 0) == bool(mine.any()) == (key in rows.since(0))


def test_too_much_at_once_is_refused_before_it_is_read(small_run: Path) -> None:
    whole = Selection.of(drawn(box(0, 0, 1e6, 1e7)))
    with pytest.raises(InputError, match="too many echoes would be searched"):
        opened(small_run, searched=1000).relabel.select(whole)
    with pytest.raises(InputError, match="too many echoes are selected"):
        opened(small_run, selected=100).relabel.select(whole)


def test_a_code_or_a_selection_that_is_none_is_refused(scene: ViewedRun, small_run: Path) -> None:
    number = scene.relabel.select(Selection.of(drawn(SPOT)))["selection"]
    with pytest.raises(InputError, match="no class that this run learns"):
        scene.relabel.correct(number, 200)
    with pytest.raises(InputError, match="not kept any more"):
        scene.relabel.correct(number + 1, 5)
    empty = scene.relabel.select(Selection.of(drawn(box(0, 0, 1, 1))))
    assert empty["echoes"] == empty["tiles"] == 0 and scene.relabel.marks(empty["selection"]) == b""
    with pytest.raises(InputError, match="nothing is selected"):
        scene.relabel.correct(empty["selection"], 5)
    for _ in range(8):
        scene.relabel.select(Selection.of(drawn(SPOT)))
    with pytest.raises(InputError, match="not kept any more"):
        scene.relabel.correct(number, 5)
    assert not (small_run / CORRECTIONS).exists()


def test_to_open_the_tool_writes_nothing(scene: ViewedRun, small_run: Path) -> None:
    before = sorted(p.name for p in small_run.iterdir())
    scene.relabel.begin()
    assert sorted(p.name for p in small_run.iterdir()) == before


def test_where_nothing_can_be_written_it_is_said_before_anything_is_drawn(scene: ViewedRun, small_run: Path) -> None:
    (small_run / "labels").write_text("")  # a file in the way: also root cannot write below it
    with pytest.raises(StoreError, match="cannot be written here"):
        scene.relabel.begin()


def test_a_new_delivery_under_an_open_page_is_said(scene: ViewedRun, small_run: Path) -> None:
    number = scene.relabel.select(Selection.of(drawn(SPOT)))["selection"]
    scene.relabel.correct(number, 5)
    deliver(small_run.parent)
    for call in (
        scene.relabel.begin,
        lambda: scene.relabel.select(Selection.of(drawn(SPOT))),
        lambda: scene.relabel.correct(number, 2),
        lambda: scene.relabel.revert(1),
    ):
        with pytest.raises(Replaced, match="delivered anew"):
            call()
    new = scene.reopened()
    assert new.name != scene.name and new.reopened() is new
    assert new.relabel.begin()["standing"] > 0


@pytest.mark.parametrize(("setting", "words"), [("false", "takes none of this"), ("mine.parquet", "mine.parquet")])
def test_who_corrects_for_nothing_is_told(small_run: Path, setting: str, words: str) -> None:
    scene = opened(small_run)
    assert scene.relabel.begin()["says"] == ""
    scene.delivery.report["config"]["survey"]["reference"]["corrections"] = False if setting == "false" else setting
    assert words in scene.relabel.begin()["says"]


# ---------------------------------------------------------------------- through the server


@pytest.fixture
def server(scene: ViewedRun) -> Iterator[Server]:
    with Server([scene], conf.section("view", ("view.request=2.0",))) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def posted(server: Server, path: str, body: Any, **headers: str | None) -> tuple[int, Any]:
    """Status and answer of what the page would send; headers that are None are left out."""
    origin = f"http://127.0.0.1:{server.server_port}"
    usual: dict[str, str | None] = {"Content-Type": "application/json", "Origin": origin, TOKEN: server.guard.token}
    usual |= {k.replace("_", "-"): v for k, v in headers.items()}
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    try:
        connection.request("POST", path, data, {k: v for k, v in usual.items() if v is not None})
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())
    finally:
        connection.close()


def test_the_page_relabels(server: Server, small_run: Path) -> None:
    begun = {DELIVERY: server.scenes[0].name}
    assert posted(server, "/data/0/relabel.json", {}, **begun)[1]["says"] == ""
    code, told = posted(server, "/data/0/select.json", drawn(SPOT), **begun)
    assert code == 200 and told["echoes"] > 0
    code, done = posted(server, "/data/0/correct.json", {"selection": told["selection"], "code": 5}, **begun)
    assert code == 200 and done["echoes"] == read_corrections(small_run).rows > 0
    assert posted(server, "/data/0/revert.json", {"time": done["time"]}, **begun)[1]["standing"] == 0


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({TOKEN: None}, 401),
        ({TOKEN: "x" * 32}, 401),
        ({"Origin": None}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Host": "evil.example"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Content-Type": "text/plain"}, 415),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 415),
        ({"Content-Type": None}, 415),
        ({DELIVERY: "0000"}, 409),
    ],
)
@pytest.mark.parametrize("name", ["0/correct", "run", "stop"])
def test_who_is_not_the_page_changes_nothing(
    server: Server, small_run: Path, headers: dict[str, str | None], status: int, name: str
) -> None:
    number = server.scenes[0].relabel.select(Selection.of(drawn(SPOT)))["selection"]
    got, told = posted(server, f"/data/{name}.json", {"selection": number, "code": 5}, **headers)
    if status == 409 and name != "0/correct":
        status = 400  # those are of the run, whatever it has delivered; nothing may be started here
    assert got == status and server.guard.token not in str(told)
    assert not (small_run / CORRECTIONS).exists()


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"[" * 100_000,
        b'{"a":' * 20_000,
        b"\xff\xfe",
        b"NaN",
        b"9" * 10_000,
        b'{"selection": 1e999, "code": 5}',
        b'{"selection": 1, "code": 5.0}',
        b'{"selection": true, "code": 5}',
        b'{"selection": 1}',
        b'{"selection": 1, "code": "<script>"}',
        b'{"selection": -1, "code": 5}',
        b'{"selection": 99999999999999999999, "code": 5}',
        b'[{"selection": 1, "code": 5}]',
    ],
    ids=lambda body: str(body)[:30],
)
def test_hostile_json_is_refused(server: Server, small_run: Path, body: bytes) -> None:
    server.scenes[0].relabel.select(Selection.of(drawn(SPOT)))
    for name in ("correct", "select", "revert"):
        status, told = posted(server, f"/data/0/{name}.json", body)
        assert status in (400, 413), told
        assert "Traceback" not in told["error"] and len(told["error"]) < 1000
    assert not (small_run / CORRECTIONS).exists()


def test_a_body_is_bounded_in_bytes_and_time(server: Server) -> None:
    assert posted(server, "/data/0/select.json", b" " * (server.params.body + 1))[0] == 413
    assert posted(server, "/data/0/select.json", {}, Content_Length="1000000000000")[0] == 413
    assert posted(server, "/data/0/select.json", {}, Content_Length="-2")[0] == 413
    began = time.monotonic()
    with pytest.raises(OSError):  # it says more than it sends
        posted(server, "/data/0/select.json", b"{}", Content_Length="1000")
    assert time.monotonic() - began < 8
    assert posted(server, "/data/0/select.json", drawn(SPOT))[0] == 200


@pytest.mark.parametrize(
    "path", ["/data/1/select.json", "/data/0/select.json?x=1", "/data/0/../0/select.json", "/", "*"]
)
def test_no_other_address_takes_a_body(server: Server, path: str) -> None:
    assert posted(server, path, drawn(SPOT))[0] == 405


def test_two_thousand_points_fit_into_a_body(server: Server) -> None:
    points = (np.random.default_rng(0).uniform(0, 4000, (2000, 2))).tolist()  # as a page writes doubles
    assert posted(server, "/data/0/select.json", drawn(points))[0] == 200


# ---------------------------------------------------------------------- the run's last command


@pytest.mark.slow
def test_the_last_command_runs_once_more_only_where_allowed(small_run: Path) -> None:
    with pytest.raises(InputError, match="may start nothing"):
        LastCommand(small_run, False).start()
    again = LastCommand(small_run, True)
    assert again.state()["command"].startswith("fwclass run ") and not again.state()["running"]
    scene = opened(small_run)
    scene.relabel.correct(scene.relabel.select(Selection.of(drawn(SPOT)))["selection"], 5)
    assert again.start()["running"]
    with pytest.raises(InputError, match="under way"):
        again.start()
    end = time.monotonic() + 300
    while again.state()["running"] and time.monotonic() < end:
        time.sleep(0.1)
    told = again.state()
    assert told["code"] == 0 and told["lines"] and told["word"]
    new = scene.reopened()
    assert new is not scene and new.delivery.report["sampling"]["corrections"]["applied"] > 0


def test_a_run_is_stopped_and_ends_with_the_viewer(small_run: Path) -> None:
    again = LastCommand(small_run, True)
    again.start()
    again.close()  # at once: it may not be done before
    told = again.state()
    assert not told["running"] and told["code"] != 0, told
    again.start()
    again.stop()
    assert again.stop()["lines"] is not None  # who asks twice has it killed
    end = time.monotonic() + 10
    while again.state()["running"] and time.monotonic() < end:
        time.sleep(0.05)
    assert again.state()["code"] not in (0, None)


def test_what_a_run_directory_names_as_code_is_not_started(small_run: Path) -> None:
    """A run of a workflow's file: the page may not start code that a directory names."""
    import fwclass.operate.request as request
    from fwclass.store.run_store import Store

    store = Store(small_run)
    kept = request.Request.kept(store)
    request.Request(kept.conf, kept.root, workflow=str(small_run / "evil.py")).keep(store)
    again = LastCommand(small_run, True)
    assert again.state()["command"] == "" and "workflow" in again.state()["why"]
    with pytest.raises(Exception, match="workflow"):
        again.start()
