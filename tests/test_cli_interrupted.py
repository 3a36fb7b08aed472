"""A command that is ended by a signal: Ctrl-C, once and twice, and what `kill`, a system or a closed terminal sends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from commandline import fwclass
from smallsurvey import small_survey


def heeding() -> None:
    """Signals as a terminal leaves them, whatever started the tests (`nohup`, a service) ignores."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def ignoring_hangup() -> None:
    heeding()
    signal.signal(signal.SIGHUP, signal.SIG_IGN)


def ended(
    survey: Path,
    out: Path,
    *numbers: signal.Signals,
    workers: int = 0,
    trees: int = 5000,
    signals: Callable[[], None] = heeding,
) -> tuple[int, str]:
    """Start a run, send it signals once a part was made, half a second apart; its exit code and what it said."""
    words = ["run", str(survey), "--out", str(out), "--workers", str(workers), "--set", f"train.trees={trees}"]
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "fwclass", *words],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        preexec_fn=signals,
    )
    until = time.monotonic() + 120
    while not (out / "store" / "tile").is_dir() and process.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    for number in numbers:
        process.send_signal(number)
        time.sleep(0.5)
    _, told = process.communicate(timeout=120)
    return process.returncode, told


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_run_in_words(tmp_path: Path, number: signal.Signals) -> None:
    survey = small_survey(tmp_path)
    code, told = ended(survey, tmp_path / "run", number)
    assert code == 130 and "nothing half-written is left" in told and "Traceback" not in told
    again = fwclass("run", survey, "--out", tmp_path / "run", "--workers", "0", "--set", "train.trees=5")
    assert again.returncode == 0, again.stderr


@pytest.mark.slow
def test_nohup_keeps_a_run_whose_terminal_closes(tmp_path: Path) -> None:
    survey = small_survey(tmp_path)
    code, told = ended(survey, tmp_path / "run", signal.SIGHUP, trees=5, signals=ignoring_hangup)
    assert code == 0, told


@pytest.mark.slow
def test_a_second_signal_while_workers_end_changes_nothing(tmp_path: Path) -> None:
    code, told = ended(small_survey(tmp_path), tmp_path / "run", signal.SIGINT, signal.SIGINT, workers=2)
    assert code == 130 and "nothing half-written is left" in told
    assert "Traceback" not in told and "Exception" not in told


def test_a_signal_while_text_is_executed_ends_by_the_same_code(tmp_path: Path) -> None:
    """As classes of data are made, on the way in; it ended by SIGINT after the words."""
    (tmp_path / "early.py").write_text(
        "import fwclass.cli as c\nc.cli = lambda **_: exec('raise KeyboardInterrupt')\nc.main()\n"
    )
    told = subprocess.run(
        [sys.executable, "-m", "early"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join((str(tmp_path), str(Path(__file__).parents[1])))},
    )
    assert told.returncode == 130 and "interrupted" in told.stderr


def test_numba_s_own_settings_do_not_end_a_command(tmp_path: Path) -> None:
    small_survey(tmp_path)
    words = [sys.executable, "-m", "fwclass", "ground", str(tmp_path / "a.las"), str(tmp_path / "b.las")]
    told = subprocess.run(
        words,
        capture_output=True,
        text=True,
        env=os.environ | {"NUMBA_NUM_THREADS": "0", "PYTHONPATH": str(Path(__file__).parents[1])},
    )
    assert told.returncode == 0, told.stderr


def test_sums_do_not_depend_on_the_threads_that_the_environment_asks_for() -> None:
    """Workers have one thread for linear algebra; what runs without workers must have as many."""
    code = (
        "import fwclass.__main__, numpy as n; v = n.random.default_rng(0).normal(size=(2, 100_000)); print(v[0] @ v[1])"
    )
    told = {
        subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": threads, "PYTHONPATH": str(Path(__file__).parents[1])},
        ).stdout
        for threads in ("1", "2", "4")
    }
    assert len(told) == 1, told
