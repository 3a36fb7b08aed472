"""A guard around commands on files: an error where a file that a command has read changes before it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, Protocol, TypeVar

from fwclass.errors import InputError
from fwclass.paths import files_read_with
from fwclass.store.digests import Looks, looks


class _Job(Protocol):
    @property
    def source(self) -> Path: ...


J = TypeVar("J", bound=_Job)
Work = Callable[..., dict[str, Any]]


def of_unchanged(work: Callable[[J, Callable[[str], None]], dict[str, Any]]) -> Work:
    """`work` on ``job.source``, which it reads several times, while that stays as it is (`check_unchanged`)."""

    @wraps(work)
    def watched(job: J, *tell: Callable[[str], None]) -> dict[str, Any]:
        with check_unchanged(job.source):
            return work(job, *tell)

    return watched


@contextmanager
def check_unchanged(*paths: Path | None) -> Iterator[None]:
    """`InputError` at the end where one of `paths`, or a file that is read with it (its waveforms, the parts of a
    Shapefile, the files of a directory), is another one by then, as its size and times tell: points of one would have
    been paired with answers for the other. None is nothing to watch."""
    watched = [path for path in paths if path is not None]
    before = _seen(watched)
    try:
        yield
    except Exception:  # what breaks in a file that changed, and what it is called, comes of that
        _check(watched, before)
        raise
    _check(watched, before)


def _check(watched: list[Path], before: dict[Path, Looks]) -> None:
    changed = sorted({path for path, _ in before.items() ^ _seen(watched).items()})
    if changed:
        raise InputError(
            "the file was changed while it was read",
            where=changed[0],
            expected="one file from beginning to end",
            got=f"{len(changed)} files changed" if len(changed) > 1 else "",
            do="remove what was written, and run the same again when the file is whole",
        )


def _seen(paths: list[Path]) -> dict[Path, Looks]:
    """What tells whether the files are others; a name where there is no file has no place in it."""
    seen = {}
    for path in dict.fromkeys(one for named in paths for one in files_read_with(named)):
        try:
            seen[path] = looks(path)
        except (OSError, ValueError):  # whoever opens it is told
            continue
    return seen
