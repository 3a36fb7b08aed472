"""`fwclass schedule` and `fwclass history` as processes: intervals, deliveries, signals, locks, and whom they tell."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from commandline import fwclass
from hook import Hook
from schedulemaker import FAILS_AT_ONCE, NOWHERE, strip, under_way, until

from fwclass.store.lock import writer

HIDDEN = "Xy7HIDDENz"


@pytest.fixture
def survey(tmp_path) -> Path:
    (tmp_path / "data" / "strips").mkdir(parents=True)
    (tmp_path / "in").mkdir()
    (tmp_path / "c.yaml").write_text(FAILS_AT_ONCE)
    return tmp_path


def line(survey: Path, *words: object) -> list[str]:
    return [
        sys.executable,
        "-m",
        "fwclass",
        "schedule",
        str(survey / "c.yaml"),
        "--out",
        str(survey / "r"),
        *map(str, words),
    ]


def once(survey: Path, *words: object, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        line(survey, "--once", *words), capture_output=True, text=True, timeout=300, env={**os.environ, **(env or {})}
    )


@contextmanager
def going(survey: Path, *words: object) -> Iterator[subprocess.Popen]:
    """A schedule under way; its standard error is in the file `log`."""
    with under_way(line(survey, *words), survey / "log") as process:
        yield process


def past(survey: Path) -> list[dict]:
    return json.loads(fwclass("history", survey / "r", "--json").stdout)


def ended(survey: Path, count: int) -> Callable[[], bool]:
    return lambda: (survey / "r").is_dir() and sum("exit_code" in run for run in past(survey)) >= count


def state(survey: Path) -> dict:
    path = survey / "r" / "schedule.json"
    return json.loads(path.read_text()) if path.exists() else {}


def no_secret(survey: Path, *outputs: str) -> None:
    """Neither in what was printed nor in any file below the run directory."""
    files = [p for p in (survey / "r").rglob("*") if p.is_file()]
    assert files
    for text in (*outputs, *(p.read_bytes().decode("latin1") for p in files)):
        assert HIDDEN not in text and base64.b64encode(HIDDEN.encode()).decode()[:8] not in text


def test_once_runs_tells_and_ends_with_the_runs_code(survey):
    """The address by --set, the token by the environment: neither is in any output or file."""
    words = json.dumps(
        [sys.executable, "-c", f"import sys; open({str(survey / 'got')!r}, 'w').write(sys.stdin.read())"]
    )
    with Hook([503]) as hook:
        done = once(
            survey,
            "--every",
            "1s",
            "--set",
            f"schedule.webhook=http://{hook.place}/{HIDDEN}?key={HIDDEN}",
            "--set",
            "schedule.webhook_token_env=HOOK_TOKEN",
            "--set",
            f"schedule.command={words}",
            env={"HOOK_TOKEN": HIDDEN},
        )
    assert done.returncode == 1 and done.stdout == "", done.stderr
    assert "no file matches" in done.stderr and "run ended: failed" in done.stderr
    [run] = past(survey)
    assert run["word"] == "failed" and run["why"]["trigger"] == "interval" and run["message"] == "no file matches"
    assert [path for path, _, _ in hook.got] == [f"/{HIDDEN}?key={HIDDEN}"] * 2
    _, headers, body = hook.got[-1]
    assert headers["Authorization"] == f"Bearer {HIDDEN}"
    record = json.loads(body)
    assert record == json.loads((survey / "got").read_text()) and record["run"] == str(survey / "r")
    assert record["id"] == run["id"] and record["survey"] == "small" and HIDDEN.encode() not in body
    assert run["told"]["webhook"] == {"to": f"http://{hook.place}/…", "ok": True, "fault": "", "tries": 2}
    assert run["told"]["command"]["ok"]
    assert state(survey)["state"] == "stopped" and state(survey)["last"]["id"] == run["id"]
    text = fwclass("history", survey / "r").stdout.splitlines()
    assert len(text) == 2 and re.search(r"interval +failed \(1\) +0 +0 +0 +0 ", text[1])
    no_secret(survey, done.stdout, done.stderr, *text)


@pytest.mark.slow
@pytest.mark.faults
def test_an_interval_goes_on_after_a_killed_run_until_sigterm(survey):
    with going(survey, "--every", "1s") as process:
        os.kill(until(lambda: state(survey).get("run"))["pid"], signal.SIGKILL)
        until(ended(survey, 2))
        assert state(survey)["pid"] == process.pid and state(survey)["next"]
        second = once(survey, "--every", "1h")
        assert second.returncode == 1 and "another schedule is at work" in second.stderr, second.stderr
        assert f"pid {process.pid} on " in second.stderr
        process.send_signal(signal.SIGTERM)
        assert process.wait(240) == 0
    runs = past(survey)
    assert (runs[0]["exit_code"], runs[0]["word"]) == (-9, "killed by SIGKILL") and runs[1]["word"] == "failed"
    assert {r["why"]["trigger"] for r in runs} == {"interval"}
    assert state(survey)["state"] == "stopped" and "told to stop by SIGTERM" in (survey / "log").read_text()


def test_ctrl_c_ends_the_run_under_way_too(survey):
    with going(survey, "--every", "1h") as process:
        child = until(lambda: state(survey).get("run"))["pid"]
        process.send_signal(signal.SIGINT)
        assert process.wait(240) == 130
        with pytest.raises(ProcessLookupError):
            os.kill(child, 0)
    [run] = past(survey)
    assert run["word"] == "interrupted" and state(survey)["last"]["word"] == "interrupted"


@pytest.mark.slow
def test_a_run_beside_another_is_refused_not_failed(survey):
    """By a schedule that was killed before: its lock went with it."""
    with going(survey, "--cron", "0 0 1 1 *"):
        until(lambda: state(survey).get("state") == "waiting")
    with writer(survey / "r"):
        done = once(survey, "--every", "1h")
        by_hand = fwclass("run", survey / "c.yaml", "--out", survey / "r")
    assert done.returncode == 1 and by_hand.returncode == 1 and "run ended: refused" in done.stderr
    assert [(r["word"], r["why"]["trigger"]) for r in past(survey)] == [("refused", "interval"), ("refused", "manual")]


def test_what_was_missed_while_no_schedule_was_there_is_one_run(survey):
    """A tick of cron at 3 o'clock, and files that were delivered, but not run."""
    (survey / "r").mkdir()
    (survey / "r" / "schedule.json").write_text(json.dumps({"last_tick": time.time() - 5 * 86400.0, "owed": ["a.las"]}))
    words = ("--cron", "0 3 * * *", "--set", "schedule.timezone=Europe/Berlin", "--inbox", survey / "in")
    with going(survey, *words) as process:
        until(ended(survey, 1))
        until(lambda: state(survey)["state"] == "waiting" and state(survey)["owed"] == [])
        assert state(survey)["next"] > state(survey)["heartbeat"]
        process.send_signal(signal.SIGTERM)
        assert process.wait(240) == 0
    [run] = past(survey)
    assert run["why"]["trigger"] == "cron" and run["why"]["tick"] < run["began"]
    assert [f["name"] for f in run["why"]["files"]] == ["a.las"]
    assert abs(state(survey)["last_tick"] - time.time()) < 600


@pytest.mark.slow
def test_a_growing_strip_is_waited_for_and_its_redelivery_replaces_it(survey):
    content = strip(survey / "whole.las").read_bytes()
    target = survey / "data" / "strips" / "a.las"
    with going(survey, "--inbox", survey / "in", "--set", NOWHERE) as process:
        with (survey / "in" / "a.las").open("wb") as stream:
            for k in range(5):
                stream.write(content[k * len(content) // 5 : (k + 1) * len(content) // 5])
                stream.flush()
                time.sleep(0.4)
                assert not target.exists()
        until(ended(survey, 1))
        assert target.read_bytes() == content
        until(lambda: state(survey)["state"] == "waiting")
        with writer(survey / "r"):  # as a run by hand would
            strip(survey / "again.las", seed=1).rename(survey / "in" / "a.las")
            until(lambda: "they wait for its end" in (survey / "log").read_text())
            assert target.read_bytes() == content
        until(ended(survey, 2))
        process.send_signal(signal.SIGTERM)
        assert process.wait(240) == 0
    log = (survey / "log").read_text()
    assert "a.las: waits: it has not stayed unchanged for 1 s" in log and "the older one is kept as replaced/" in log
    assert log.count("they wait for its end") == 1
    [kept] = (survey / "in" / "replaced").glob("*/a.las")
    assert kept.read_bytes() == content and target.read_bytes() != content
    first, second = past(survey)
    assert [f["name"] for f in first["why"]["files"]] == ["a.las"] and first["why"]["trigger"] == "inbox"
    assert second["why"]["files"][0]["replaced"] and "a.las again" in fwclass("history", survey / "r").stdout
    assert state(survey)["owed"] == []


@pytest.mark.slow
def test_a_whole_run_shows_no_secret_of_its_configuration(survey):
    """Report, page, run.json, history, receipts, logs; and what is printed when a part fails."""
    strip(survey / "data" / "strips" / "a.las")
    with Hook() as hook:
        address = f"http://me:{HIDDEN}@{hook.place}/{HIDDEN}"
        text = FAILS_AT_ONCE.replace("schedule: {", f"schedule: {{webhook: '{address}', ")
        (survey / "c.yaml").write_text(text)
        done = once(survey, "--every", "1s")
    assert done.returncode == 0, done.stderr
    record = json.loads(hook.got[0][2])
    assert record["word"] == "done" and record["parts"]["computed"] > 20 and record["generation"] == 1
    shown = [
        fwclass(*w) for w in (("status", survey / "r"), ("status", survey / "r", "--json"), ("history", survey / "r"))
    ]
    report = (survey / "r" / "report.json").read_text()
    assert json.loads(report)["config"]["train"]["trees"] == 5 and "webhook" not in report
    shutil.rmtree(survey / "r" / "store" / "label")
    (survey / "r" / "store" / "label").write_text("in the way")
    failed = fwclass("run", survey / "c.yaml", "--out", survey / "r", "--set", f"schedule.webhook=https://h/{HIDDEN}")
    assert failed.returncode == 3 and "alone: fwclass run" in failed.stderr and "schedule.webhook=…" in failed.stderr
    no_secret(survey, done.stderr, *(s.stdout + s.stderr for s in (*shown, failed)))


@pytest.mark.parametrize(
    "setting",
    [
        f"schedule.webhook=ftp://h/{HIDDEN}",
        f"schedule.webhook={HIDDEN}",
        f"schedul.webhook=https://h/{HIDDEN}",
        f"schedule={{webhook: {HIDDEN}}}",
        f"schedule.webhook=[{HIDDEN}",
        f"schedule.webhok=https://h/{HIDDEN}",
        f"schedule.webhook=https://h/a b{HIDDEN}",
        f"schedule.command={HIDDEN}",
    ],
)
def test_a_wrong_address_is_refused_without_being_told(survey, setting):
    done = fwclass("schedule", survey / "c.yaml", "--every", "1h", "--set", setting)
    assert done.returncode == 2 and HIDDEN not in done.stderr + done.stdout and "schedul" in done.stderr


@pytest.mark.parametrize("wrong", ["https://h/{}\n\tx: 1", "https://h/{}: x: [", "[https://h/{}"])
def test_a_configuration_that_is_no_yaml_is_not_quoted(survey, wrong):
    (survey / "c.yaml").write_text(f"schedule:\n  webhook: {wrong.format(HIDDEN)}\n")
    done = fwclass("schedule", survey / "c.yaml", "--every", "1h")
    assert done.returncode == 2 and "line" in done.stderr and HIDDEN not in done.stderr
    done = fwclass("run", f"https://h/{HIDDEN}", f"https://h/{HIDDEN}")
    assert done.returncode == 2 and HIDDEN not in done.stderr


def test_what_cannot_be_scheduled(survey):
    conf = survey / "c.yaml"
    for words, told in (
        ((), "nothing says when to run"),
        (("--every", "1h", "--cron", "0 3 * * *"), "exclude one another"),
        (("--cron", "0 3 * *"), "five fields are wanted"),
        (("--cron", "0 0 30 2 *"), "no cron expression"),
        (("--every", "0s"), "greater than 0"),
        (("--every", "9999999999999999d"), "at most 3660d"),
        (("--every", "soon"), "a time like 90s"),
        (("--inbox", survey / "none"), "the inbox is no directory"),
        (("--inbox", survey / "data" / "strips"), "where the survey looks"),
        (("--every", "1h", "--workflow", "nonsense"), "no such workflow"),
        (
            (
                "--every",
                "1h",
                "--set",
                "schedule.webhook=http://h/x",
                "--set",
                "schedule.webhook_token_env=NOT_SET_HERE",
            ),
            "NOT_SET_HERE is not set",
        ),
    ):
        done = fwclass("schedule", conf, "--out", survey / "r", *words)
        assert done.returncode == 2 and told in done.stderr, done.stderr
    assert fwclass("history", survey / "none").returncode == 2
    told = fwclass("history", survey)
    assert told.returncode == 2 and "no such run directory" in told.stderr


@pytest.mark.slow
def test_a_hundred_runs_take_no_more_memory_or_handles(survey):
    """With an inbox that is looked at and a webhook; the configuration is broken, so that runs are short."""
    with Hook() as hook:
        words = (
            "--inbox",
            survey / "in",
            "--set",
            f"schedule.webhook=http://{hook.place}/x",
            "--set",
            "schedule.look=0.05",
        )
        strip(survey / "in" / "a.las").write_bytes(b"LASF")  # never complete
        with going(survey, "--every", "0.05s", *words) as process:
            until(lambda: state(survey).get("run"))
            (survey / "c.yaml").write_text("survey: [")
            facts = psutil.Process(process.pid)
            until(lambda: len(hook.got) >= 20, 300.0)
            before = facts.memory_info().rss, facts.num_fds()
            until(lambda: len(hook.got) >= 120, 600.0)
            after = facts.memory_info().rss, facts.num_fds()
            assert facts.num_threads() <= 2
    assert after[0] - before[0] < 2 << 20, (before, after)
    assert abs(after[1] - before[1]) <= 4, (before, after)  # a connection, a pipe to a child
    assert {r["word"] for r in past(survey)[5:]} == {"configuration"}
    print(f"resident {after[0] / 2**20:.0f} MiB, {after[1]} handles")
