"""The command line for tests: in this process, or in one of its own where the process itself matters."""

from __future__ import annotations

import contextlib
import io
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any
from unittest import mock

from fwclass import cores
from fwclass.cli import main
from fwclass.errors import INTERRUPTS

Ended = subprocess.CompletedProcess[str]


def coarse() -> Any:
    """While this holds, pictures of a run have a ninth of their dots: they took a quarter of a small run's time."""
    return mock.patch("fwclass.publish.drawing.DPI", 50)


def fwclass(*words: object, cwd: Path | None = None) -> Ended:
    """Run the command in this process: its exit code, standard output and standard error.

    What is no fault of data or configuration comes out as the exception that it is.
    """
    line, code = ["fwclass", *map(str, words)], 0
    before = {number: signal.getsignal(number) for number in INTERRUPTS}
    with (
        coarse(),
        mock.patch.object(cores, "_cores", 1),
        contextlib.chdir(cwd or Path.cwd()),
        mock.patch.object(sys, "argv", line),
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        finally:
            if threading.current_thread() is threading.main_thread():
                for number, handler in before.items():
                    signal.signal(number, handler)
    return subprocess.CompletedProcess(line, code, out.getvalue(), err.getvalue())


def process(*words: object, cwd: Path | None = None) -> Ended:
    """Run the command in a process of its own: with workers, or where nothing else may be on its standard output."""
    line = [sys.executable, "-c", "from fwclass.cli import main; main()", *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True, cwd=cwd, timeout=300)
