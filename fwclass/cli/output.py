"""Standard output that says in words where it cannot take what is printed: a full disk, or ``>&-``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from fwclass.errors import FwclassError


class Output:
    """Stands for `stream`, None where standard output was closed: what is printed is lost then, which is told at the
    end (`check`), when the work is done."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream, self._lost = stream, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """As of a text file."""
        if self._stream is None:
            self._lost = self._lost or bool(text)
            return len(text)
        with _as_fault():
            return self._stream.write(text)

    def flush(self) -> None:
        """As of a text file."""
        if self._stream is not None:
            with _as_fault():
                self._stream.flush()

    def check(self) -> None:
        """`FwclassError` where something that was printed is lost."""
        self.flush()
        if self._lost:
            raise _fault("it is closed")


@contextmanager
def _as_fault() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as fault:
        raise _fault(fault.strerror) from fault


def _fault(got: str | None) -> FwclassError:
    return FwclassError("what is printed cannot be written", where="standard output", got=got or "")


@contextmanager
def watched_output() -> Iterator[Callable[[], None]]:
    """An `Output` in the place of standard output; its `check`."""
    stream = sys.stdout
    output = Output(stream)
    sys.stdout = output
    try:
        yield output.check
    finally:
        sys.stdout = stream
