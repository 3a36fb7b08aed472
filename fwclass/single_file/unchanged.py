"""What a command makes of one file is of that file: one that changes meanwhile is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, Protocol, TypeVar

from fwclass.errors import InputError
from fwclass.single_file.tiles import Tell, quiet
from fwclass.store.digests import looks


class _Job(Protocol):
    @property
    def source(self) -> Path: ...


J = TypeVar("J", bound=_Job)
Work = Callable[..., dict[str, Any]]


def of_unchanged(work: Callable[[J, Tell], dict[str, Any]]) -> Work:
    """`work` on ``job.source``, which it reads several times, while that is `unchanged`."""

    @wraps(work)
    def watched(job: J, tell: Tell = quiet) -> dict[str, Any]:
        with unchanged(job.source):
            return work(job, tell)

    return watched


@contextmanager
def unchanged(path: Path) -> Iterator[None]:
    """`InputError` at the end where `path` is another file by then, as its size and times tell: points of one would
    have been paired with answers for the other."""
    before = looks(path) if path.is_file() else None
    yield
    if not path.is_file() or looks(path) != before:
        raise InputError(
            "the file was changed while it was read",
            where=path,
            expected="one file from beginning to end",
            do="remove what was written, and run the same again when the file is whole",
        )
