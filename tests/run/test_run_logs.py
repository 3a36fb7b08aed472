"""A part's log: a line of `key=value` for every attempt, from foreign text too, bounded, and never in the way."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from fwclass.errors import InputError
from fwclass.run.local import Loop
from fwclass.run.logs import LIMIT, line, log_attempt, log_path
from fwclass.run.part import Task, execute
from fwclass.run.progress import Display
from fwclass.run.runner import Runner


def parsed(text):
    """Fields of a line, read as logfmt's rules have it and by none of the program's code."""
    found = {}
    for key, bare, quoted in re.findall(r'(\w+)=(?:([^\s"=]+)|"((?:[^"\\]|\\.)*)")(?= |$)', text):
        found[key] = bare or quoted.encode("latin-1", "backslashreplace").decode("unicode_escape")
    return found


def made(inputs, directory):
    (directory / "a").write_text("12345")
    return {"rows": 7, "faults": {"no_packet": 3, "far": 1}}


def test_every_attempt_is_a_line(tmp_path):
    def refused(inputs, directory):
        raise InputError('no "oil"', where="tank 3", do="fill it")

    def broken(inputs, directory):
        raise RuntimeError("disk on fire\nand\x1b[31m red")

    for work in (refused, broken, made, made):  # the last finds it done: no attempt
        runner = Runner(tmp_path, Loop(), Display())
        runner.do([Task("one", "a", 1, {}, work)])
    rows = log_path(tmp_path, "one", "a").read_text().splitlines()
    first, second, third = map(parsed, rows)
    assert [r["status"] for r in (first, second, third)] == ["failed", "failed", "computed"]
    assert first["message"] == 'no "oil"\n  where: tank 3\n  what to do: fill it' and "traceback" not in first
    assert second["message"].startswith("RuntimeError: disk on fire\nand\x1b[31m red")
    assert "in broken" in second["traceback"] and "disk on fire" in second["traceback"]
    receipt = runner.store.receipt("one", "a")
    assert third["key"] == receipt.key and float(third["seconds"]) == pytest.approx(receipt.seconds, abs=0.001)
    assert (third["rows"], third["bytes"], third["faults"]) == ("7", "5", "no_packet:3,far:1")
    assert float(third["peak_mib"]) > 10 and third["stage"] == "one" and third["part"] == "a"
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", third["when"]) and int(third["pid"]) > 0
    for row in rows:
        assert row.isprintable() and shlex.split(row)


def test_no_text_breaks_a_line():
    for value in (
        "",
        " ",
        "a b",
        'say "x"',
        "back\\slash",
        "tab\there",
        "\x00\x1b]0;title\x07",
        "\u2028\u202e\ud800",
        "é=1",
    ):
        text = line({"message": value, "next": 1})
        assert text.count("\n") == 1 and text[:-1].isprintable()
        assert parsed(text[:-1])["next"] == "1"
        if "\ud800" not in value and value.isascii():
            assert parsed(text[:-1])["message"] == value
    assert line({"a": None, "b": 0.25, "c": "x/y:1"}) == "b=0.25 c=x/y:1\n"
    assert len(line({"m": "x y" * 100_000})) < 20_000


def test_a_log_is_bounded_and_keeps_the_newest(tmp_path):
    for k in range(400):
        log_attempt(tmp_path, "one", "a", {"status": "failed", "attempt": k, "message": "x y" * 300})
    path = log_path(tmp_path, "one", "a")
    rows = path.read_text().splitlines()
    assert path.stat().st_size <= LIMIT
    numbers = [int(parsed(r)["attempt"]) for r in rows]
    assert numbers == list(range(numbers[0], 400)) and len(numbers) > 20
    assert [p.name for p in path.parent.iterdir()] == ["a.log"]


def test_a_log_that_cannot_be_written_stops_nothing(tmp_path):
    (tmp_path / "logs").write_text("a file where a directory is wanted")
    assert execute(tmp_path, Task("one", "a", 1, {}, made)).status == "computed"


def test_ctrl_c_in_compiled_code_is_no_fault_of_the_part(tmp_path):
    """numba answers it by a `SystemError`: the run ends as interrupted, and no part has failed."""

    def stopped(inputs, directory):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as fault:
            raise SystemError("returned a result with an exception set") from fault

    with pytest.raises(KeyboardInterrupt):
        execute(tmp_path, Task("one", "a", 1, {}, stopped))
    assert not log_path(tmp_path, "one", "a").exists()
    assert not list((tmp_path / "store" / "staging").glob("*/*/*"))


def test_memory_that_runs_out_is_a_sentence(tmp_path):
    """The part's message was the name of an exception, and the way to a traceback."""

    def hoards(inputs, directory):
        np.empty((1 << 60,), np.uint8)

    ended = execute(tmp_path, Task("one", "a", 1, {}, hoards))
    assert ended.status == "failed" and ended.message.startswith("memory ran out\n") and "EiB" in ended.message
    assert "Error" not in ended.message and "traceback" not in log_path(tmp_path, "one", "a").read_text()


@pytest.mark.slow
def test_a_worker_that_is_lost_is_in_the_log(tmp_path: Path):
    from fwclass.run.cluster import Cluster

    with Cluster(None, 1, 1.0, 1000) as cluster:
        assert cluster.workers == 1
        ended = list(cluster.run(tmp_path, [Task("one", "a", 1, {}, _dies)]))
    assert [o.status for o in ended] == ["failed"]
    last = parsed(log_path(tmp_path, "one", "a").read_text().splitlines()[-1])
    assert last["status"] == "failed" and "worker was lost" in last["message"]


def _dies(inputs, directory):
    import os

    os._exit(1)
