"""The command line: a contract that scripts outside the project call."""

from __future__ import annotations

import atexit
import gc
import io
import math
import signal
import sys
import threading
import time
from types import FrameType

import click

from fwclass.cli import (
    backscatter,
    clean,
    compile_kernels,
    difference,
    draft,
    features,
    files,
    ground,
    label,
    model,
    plan,
    schedule,
    seams,
    select,
    status,
    street,
    survey,
    view,
)
from fwclass.cli.base import cli
from fwclass.cli.output import watched_output
from fwclass.errors import FAILED, INTERRUPTED, INTERRUPTS, FwclassError, memory_error, system_error, visible
from fwclass.isolation import isolate
from fwclass.redact import redacted

COMMANDS = (
    *(backscatter, clean, compile_kernels, difference, draft, features, files, ground, label, model, plan, schedule),
    *(seams, select, status, street, survey, view),
)
"""Modules that give `cli` its commands."""

PATIENCE = 10.0
"""Seconds in which an interrupted command may end; until then further signals change nothing."""


def _heed_interrupts() -> None:
    """Let whoever ends the command, and not only a terminal, end it as Ctrl-C does; a signal that is ignored stays so
    (``nohup``)."""
    began = -math.inf

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal began
        if time.monotonic() > began + PATIENCE:
            began = time.monotonic()
            raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        for number in INTERRUPTS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, interrupt)


def main() -> None:
    """Entry point: faults of data and configuration are told in words, without a traceback."""
    isolate()
    _heed_interrupts()
    atexit.register(gc.freeze)  # Python's last steps would look for cycles in all that libraries made
    try:
        with watched_output() as check:
            cli(standalone_mode=False)
            check()
    except click.exceptions.Exit as end:
        sys.exit(end.exit_code)
    except click.ClickException as fault:
        lines = io.StringIO()
        fault.show(lines)
        click.echo(redacted(lines.getvalue()), err=True, nl=False)
        sys.exit(fault.exit_code)
    except (click.Abort, KeyboardInterrupt):
        if threading.current_thread() is threading.main_thread():
            for number in INTERRUPTS:
                signal.signal(number, signal.SIG_IGN)  # or Python's last steps end by one
        # One that came while text was executed, as dataclasses do, has Python end by SIGINT, until the next text is.
        exec("pass")  # noqa: S102
        click.echo(
            "interrupted; nothing half-written is left, and in a run directory the same command goes on from here",
            err=True,
        )
        sys.exit(INTERRUPTED)
    except FwclassError as fault:
        click.echo(f"fwclass: {fault}", err=True)
        sys.exit(fault.exit_code)
    except BrokenPipeError:
        sys.exit(FAILED)
    except OSError as fault:
        click.echo(f"fwclass: {system_error(fault)}", err=True)
        sys.exit(FAILED)
    except MemoryError as fault:
        click.echo(f"fwclass: {memory_error(fault)}", err=True)
        sys.exit(FAILED)
    except RuntimeError as fault:
        if not str(fault).startswith("Symlink loop"):  # what Path.resolve says before Python 3.13
            raise
        click.echo(f"fwclass: {visible(fault)}\n  what to do: remove the link, which leads back to itself", err=True)
        sys.exit(FAILED)
