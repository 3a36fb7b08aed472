"""The history of a run directory: whole lines, torn ones, two writers, killed runs, and its bounds."""

from __future__ import annotations

import json
import multiprocessing
import os
import socket

import pytest

from fwclass.errors import InputError, LockedError, QualityError
from fwclass.operate.history import Entry, past_runs, record_run, table, word_of
from fwclass.operate.request import Request
from fwclass.store import history
from fwclass.store.lock import writer

TESTED = [[3, 1], [0, 4]]


def request(root, *settings):
    return Request("c.yaml", str(root), settings)


@pytest.mark.parametrize(
    ("fault", "code", "word"),
    [
        (SystemExit(3), 3, "partial"),
        (SystemExit("text"), 1, "failed"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (LockedError("x"), 1, "refused"),
        (InputError("no file"), 1, "failed"),
        (QualityError("low"), 4, "quality"),
        (RuntimeError("https://h/SECRET"), 1, "failed"),
        (OSError(28, "No space left on device", "/SECRET"), 1, "failed"),
    ],
)
def test_every_end_has_its_word(tmp_path, fault, code, word):
    with pytest.raises(type(fault)), record_run(tmp_path, request(tmp_path)) as entry:
        entry.begin(None)
        raise fault
    [run] = past_runs(tmp_path)
    assert (run["exit_code"], run["word"]) == (code, word) and run["pid"] == os.getpid()
    assert "SECRET" not in (tmp_path / "store" / history.NAME).read_text()


def test_settings_are_kept_without_secrets(tmp_path):
    settings = ("train.trees=5", "schedule.webhook=https://u:SECRET@h/SECRET")
    asked = Request.of(tmp_path / "c.yaml", tmp_path, settings, "classification", frozenset({"1_2"}))
    with record_run(tmp_path, asked, "tile/1_2") as entry:
        entry.begin(None)
    [run] = past_runs(tmp_path)
    assert run["settings"] == ["train.trees=5"] and run["tiles"] == ["1_2"] and run["only"] == "tile/1_2"
    assert run["word"] == "done" and run["why"] == {"trigger": "manual"}
    assert "--only tile/1_2" in table([run]) and "SECRET" not in json.dumps(run)


def _die(root) -> None:
    with writer(root):
        Entry(root, request(root)).begin(None)
        os._exit(9)


def test_a_killed_run_is_told_as_interrupted_and_one_at_work_as_running(tmp_path):
    dead = multiprocessing.get_context("fork").Process(target=_die, args=(tmp_path,))
    dead.start()
    dead.join()
    with writer(tmp_path):
        Entry(tmp_path, request(tmp_path)).begin(None)
        assert [r["word"] for r in past_runs(tmp_path)] == ["interrupted", "running"]
        os.truncate(tmp_path / "store" / "lock", 0)  # as on a disk without room for the name
        assert [r["word"] for r in past_runs(tmp_path)] == ["interrupted", "running"]
    told = table(past_runs(tmp_path))
    assert [line.split()[3] for line in told.splitlines()[1:]] == ["interrupted", "interrupted"]


def test_a_torn_line_loses_itself_alone(tmp_path):
    history.append(tmp_path, {"id": 1})
    path = tmp_path / "store" / history.NAME
    with path.open("ab") as stream:
        stream.write(b'{"id": 2, "rec')
    history.append(tmp_path, {"id": 3})
    with path.open("ab") as stream:
        stream.write(b"\xff\xfe\0\n[1]\n")
    history.append(tmp_path, {"id": 4})
    assert [line["id"] for line in history.lines(tmp_path)] == [1, 3, 4]


def _write(root, number: int) -> None:
    for k in range(100):
        history.append(root, {"id": f"{number}-{k}", "text": "x" * 500})


def test_writers_side_by_side_lose_nothing(tmp_path, monkeypatch):
    """Four at once, the file put away in the middle: every line is there once, whole, each writer's in its order."""
    monkeypatch.setattr(history, "HISTORY_BYTES", 150_000)
    context = multiprocessing.get_context("fork")
    writers = [context.Process(target=_write, args=(tmp_path, n)) for n in range(4)]
    for process in writers:
        process.start()
    for process in writers:
        process.join()
    found = [line["id"] for line in history.lines(tmp_path)]
    assert len(found) == len(set(found)) == 400
    for n in range(4):
        assert [f for f in found if f.startswith(f"{n}-")] == [f"{n}-{k}" for k in range(100)]
    assert (tmp_path / "store" / history.EARLIER).exists()


def test_the_history_is_bounded_and_keeps_the_newest(tmp_path, monkeypatch):
    monkeypatch.setattr(history, "HISTORY_BYTES", 10_000)
    for k in range(1000):
        history.append(tmp_path, {"id": k})
        assert sum(p.stat().st_size for p in (tmp_path / "store").glob("history*.jsonl")) <= 20_000
    found = [line["id"] for line in history.lines(tmp_path)]
    assert found == list(range(1000 - len(found), 1000)) and len(found) >= 10_000 // len('{"id": 999}\n')


def test_an_end_whose_beginning_was_put_away_is_still_a_run(tmp_path):
    entry = Entry(tmp_path, request(tmp_path))
    entry.begin(None)
    (tmp_path / "store" / history.NAME).unlink()
    entry.end(0, "done")
    [run] = past_runs(tmp_path)
    assert run["word"] == "done" and run["host"] == socket.gethostname()


def test_a_history_that_cannot_be_written_stops_no_run(tmp_path, capsys):
    (tmp_path / "store").write_text("in the way")
    with record_run(tmp_path, request(tmp_path)) as entry:
        entry.begin(None)
    assert "could not be written" in capsys.readouterr().err


def test_words_of_signals():
    assert word_of(-9) == "killed by SIGKILL" and word_of(2) == "configuration" and word_of(77) == "failed"


@pytest.mark.parametrize(
    "damage",
    [
        b"[" * 100_000,
        b'{"id": 1' + b"0" * 5000 + b"}",
        b"\xff\x00\xfe",
        b'{"record": "end", "id": "x", "began": "now", "word": "done", "parts": [1], "exit_code": 0}',
        b'{"record": "end", "id": "x", "began": "now", "word": "done", "why": "it", "tiles": 3}',
        b'{"record": "end", "id": "x", "began": "now", "word": "done", "settings": 7}',
        b'{"record": "end", "id": "x", "began": "now", "word": "done", "seconds": Infinity}',
        *(
            b'{"record": "end", "id": "x", "began": "now", "word": "done", ' + inner + b"}"
            for inner in (
                b'"why": {"files": 5}',
                b'"why": {"files": ["a"]}',
                b'"told": {"webhook": 5}',
                b'"tiles": [5]',
                b'"workflow": ["x"]',
                b'"seconds": 1' + b"0" * 400,
                b'"accuracy": {"overall_accuracy": 1' + b"0" * 400 + b"}",
                b'"accuracy": {"overall_accuracy": "x"}',
            )
        ),
    ],
)
def test_a_damaged_line_hides_no_other(tmp_path, damage):
    for _ in range(2):
        with record_run(tmp_path, request(tmp_path)) as entry:
            entry.begin(None)
        with (tmp_path / "store" / history.NAME).open("ab") as stream:
            stream.write(damage + b"\n")
    runs = past_runs(tmp_path)
    assert [run["exit_code"] for run in runs if run["id"] != "x"] == [0, 0]
    assert table(runs).count("manual") == 2
    with record_run(tmp_path, request(tmp_path)) as entry:
        assert entry.judged({"accuracy": {"overall_accuracy": 0.5, "kappa": 0.1, "confusion": TESTED}}) == ""


@pytest.mark.parametrize(("overall", "kappa"), [(None, None), (1.0, None), (0.5, 0.0)])
def test_a_run_may_have_no_accuracy(tmp_path, overall, kappa):
    """Where nothing is tested, and kappa where one class is."""
    for _ in range(2):
        with record_run(tmp_path, request(tmp_path)) as entry:
            entry.begin(None)
            assert entry.judged({"accuracy": {"overall_accuracy": overall, "kappa": kappa, "confusion": TESTED}}) == ""
    wanted = None if overall is None else {"overall_accuracy": overall, "kappa": kappa, "tested": 8}
    assert [run["accuracy"] for run in past_runs(tmp_path)] == [wanted] * 2
    assert table(past_runs(tmp_path)).count("manual") == 2


def test_a_history_that_is_a_link_is_not_read(tmp_path):
    (tmp_path / "run" / "store").mkdir(parents=True)
    (tmp_path / "mine.jsonl").write_text('{"id": "x"}\n')
    (tmp_path / "run" / "store" / "history.jsonl").symlink_to(tmp_path / "mine.jsonl")
    with pytest.raises(InputError, match="no file of the directory itself"):
        list(history.lines(tmp_path / "run"))
