"""What a command says where its own output cannot be written, or where it is ended before it has begun."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import commandline
import pytest
from lasmaker import write_las
from smallsurvey import small_survey

import fwclass
from fwclass.cli.runner import cores_remark
from fwclass.errors import FwclassError
from fwclass.run import cluster

FULL = Path("/dev/full")
PRINTS = [("--help",), ("info", "a.las"), ("info", "a.las", "--json")]
"""Words that print."""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    write_las(tmp_path / "a.las", [[500_000.0, 5_400_000.0, 200.0]], point_format=6)
    return tmp_path


def ended(words: tuple[str, ...], place: Path, redirection: str) -> subprocess.CompletedProcess[str]:
    line = ["sh", "-c", f'exec "$@" {redirection}', "sh", sys.executable, "-P", "-m", "fwclass", *words]
    env = os.environ | {"PYTHONPATH": str(Path(fwclass.__file__).parents[1])}
    return subprocess.run(line, cwd=place, env=env, capture_output=True, text=True, timeout=120)


def test_a_command_that_ends_does_not_look_for_cycles_in_all_that_it_has_loaded() -> None:
    """With numba and SciPy that was a tenth of what `fwclass features` takes."""
    child = (
        "import atexit, gc, sys; atexit.register(lambda: print(gc.get_freeze_count() > 1000)); "
        "sys.argv = ['fwclass', '--version']; from fwclass.cli import main; main()"
    )
    told = subprocess.run([sys.executable, "-c", child], capture_output=True, text=True, check=True).stdout
    assert told.splitlines()[-1] == "True"


@pytest.mark.parametrize("words", PRINTS, ids=" ".join)
@pytest.mark.parametrize(
    ("redirection", "got"), [(">/dev/full", "No space left"), (">&-", "it is closed")], ids=["full", "closed"]
)
def test_what_cannot_be_printed_is_told(place: Path, words: tuple[str, ...], redirection: str, got: str) -> None:
    if not FULL.exists():
        pytest.skip(f"no {FULL} on this system")
    answer = ended(words, place, redirection)
    assert answer.returncode == 1, answer.stderr
    assert "what is printed cannot be written" in answer.stderr and got in answer.stderr
    assert "Traceback" not in answer.stderr and "Exception" not in answer.stderr


def test_nobody_misses_what_was_not_printed(place: Path) -> None:
    answer = ended(("ground", "a.las", "b.las"), place, ">&-")
    assert answer.returncode == 0 and (place / "b.las").exists(), answer.stderr


def test_a_command_that_is_interrupted_while_it_is_loaded_ends_quietly() -> None:
    child = """
import os, signal, sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "fwclass.cli":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
signal.signal(signal.SIGINT, signal.default_int_handler)
from fwclass.__main__ import main
main()
"""
    answer = subprocess.run([sys.executable, "-c", child], capture_output=True, text=True, timeout=60)
    assert (answer.returncode, answer.stdout, answer.stderr) == (130, "", "")


@pytest.mark.parametrize(
    "workers, cores, words",
    [
        (4, 2, "2 started of 4 asked for: more than this machine's 2 cores"),
        (2, 16, "2 of 16 cores"),
        (2, 3, ""),
        (2, 2, ""),
    ],
)
def test_workers_that_do_not_fit_the_cores_are_told(workers: int, cores: int, words: str) -> None:
    """Of 32 cores two worked, and nothing said so; four on two cores took a tenth longer than two."""
    remark = cores_remark(workers, cores)
    assert words in remark and bool(words) == bool(remark)


@pytest.mark.parametrize("asked, started", [(9, 2), (2, 2), (1, 1)])
def test_no_more_workers_are_started_than_cores_serve(
    asked: int, started: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On two cores four workers took 114 s for what two did in 103, and twice the memory."""

    def start(address: str | None, workers: int, *rest: object, **more: object) -> None:
        raise FwclassError(f"{workers} at {address}", where="here")

    monkeypatch.setattr(cluster, "CORES", 2)
    monkeypatch.setattr(cluster, "Cluster", start)
    run = commandline.fwclass("run", small_survey(tmp_path), "--out", tmp_path / "run", "--workers", asked)
    assert f"{started} at None" in run.stderr
