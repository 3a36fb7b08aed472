"""What a command makes of one file is of that file: one that changes meanwhile is told."""

from __future__ import annotations

from collections.abc import Callable
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
    """`work` on ``job.source``, which it reads several times; `InputError` where the file is another one at its end, as
    its size and times tell: points of one would have been paired with answers for the other."""

    @wraps(work)
    def watched(job: J, tell: Tell = quiet) -> dict[str, Any]:
        before = looks(job.source) if job.source.is_file() else None
        done = work(job, tell)
        if not job.source.is_file() or looks(job.source) != before:
            raise InputError(
                "the file was changed while it was read",
                where=job.source,
                expected="one file from beginning to end",
                do="remove what was written, and run the same again when the file is whole",
            )
        return done

    return watched
