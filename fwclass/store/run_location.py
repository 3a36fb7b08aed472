"""Where a run lies, a local directory or a prefix of a bucket: its store, its locks, and what lies at its root."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from fwclass.errors import FwclassError, StoreError
from fwclass.store.atomic import from_json, to_json
from fwclass.store.bucket import Remote, files_at
from fwclass.store.lock import WRITER, Lock, around, holder, refuse_inside, writer
from fwclass.store.params import StoreParams
from fwclass.store.remote_lock import check_token, remote_holder, remote_writer
from fwclass.store.run_store import Store
from fwclass.store.url import Url

RunLocation = Path | Remote
"""Small, and sent with every part."""


def location_of(out: Path | Url, params: StoreParams) -> RunLocation:
    """The run directory that a user named."""
    return Remote(out, params) if isinstance(out, Url) else out.resolve()


def address_of(location: RunLocation) -> Path | Url:
    """What the user named."""
    return location.url if isinstance(location, Remote) else location


def without_retries(location: RunLocation) -> RunLocation:
    """The same place for what shall not wait: a request that fails is not tried for long."""
    if not isinstance(location, Remote):
        return location
    return replace(location, params=location.params.model_copy(update={"patience": 0.0}))


def open_store(location: RunLocation, read_only: bool = False, lists: bool = False) -> Store:
    """The store of a run; with `lists` for who asks about all of it, and says what was made meanwhile (`forget`)."""
    return Store(location, read_only, lists)


def held_by(location: RunLocation, lock: Lock = WRITER) -> Mapping[str, Any] | None:
    """Host and pid of the run that is writing there, or of who else holds `lock`, None where there is none."""
    return remote_holder(location.objects, lock) if isinstance(location, Remote) else holder(location, lock)


@contextmanager
def lock_run(
    location: RunLocation, tell: Callable[[str], None], lock: Lock = WRITER
) -> Iterator[tuple[RunLocation, Callable[[], None]]]:
    """Hold the run: where parts are to be committed now, and what raises `StoreError` once the lock is lost."""
    if isinstance(location, Remote):
        _refuse_inside_remote(location)
        with remote_writer(location.objects, tell, lock) as (token, beat):
            yield replace(location, token=token), beat.check
    else:
        with writer(location, lock) as check:
            yield location, check


def confirm(location: RunLocation, lock: Lock) -> None:
    """`LostRace` where `lock` is another's by now: object storage is asked, because who has slept does not know yet.

    `location`: the one that `lock_run` gave. A kernel's lock is never taken over.
    """
    if isinstance(location, Remote):
        check_token(location.objects, location.token, lock)


def read_note(location: RunLocation, name: str) -> Any:
    """Plain data that lies at the run's root, None for none; `StoreError` where it cannot be read."""
    data = files_at(location).get(name)
    return from_json(data[0], address_of(location) / name) if data else None


def write_note(location: RunLocation, name: str, value: Any, lock: Lock) -> None:
    """Replace plain data at the run's root, for who holds `lock`; `OSError` or `StoreError` where it fails.

    On object storage, where a lock may be lost unnoticed, `LostRace` when it is (`location` is what `lock_run` gave).
    """
    confirm(location, lock)
    files_at(location).put(name, to_json(value))


@contextmanager
def unmade_again(location: RunLocation) -> Iterator[None]:
    """A run directory that is not there yet is taken away again, with its new parents, where a refusal leaves it
    without a single part; nothing that was there before is touched. On object storage nothing is. `ConfigError` for
    one that would lie in another's store or delivery."""
    if isinstance(location, Remote):
        _refuse_inside_remote(location)
        yield
        return
    refuse_inside(location)
    if location.exists():
        yield
        return
    parents = [p for p in location.parents if not p.exists()]
    try:
        yield
    except FwclassError:
        if _without_parts(location) and held_by(location) is None:
            shutil.rmtree(location)
            for path in parents:
                with suppress(OSError):  # somebody else's by now
                    path.rmdir()
        raise


def _refuse_inside_remote(location: Remote) -> None:
    """As `refuse_inside`: the other run would sweep what it did not put there. Nothing is asked for most addresses."""
    parts = location.url.split("/")
    for k in (k for k in range(3, len(parts)) if parts[k] in ("store", "generations")):
        run, params = Url("/".join(parts[:k])), location.params.model_copy(update={"patience": 0.0})
        with suppress(StoreError):  # who may not read there cannot have made it
            if Remote(run, params).objects.get("store/run.json") is not None:
                raise around(location.url, run)


def _without_parts(root: Path) -> bool:
    """There is nothing in a run directory but what every run writes before its first part."""
    if not root.is_dir() or {p.name for p in root.iterdir()} - {"store", "generations"}:
        return False
    inside = [p for p in (root / "generations").rglob("*") if not p.is_dir()]
    return not inside and not any(p.is_dir() for p in (root / "store").glob("*"))
