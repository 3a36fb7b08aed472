"""Where a run lies, a local directory or a prefix of a bucket: its store, and its lock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from fwclass.store.lock import holder, writer
from fwclass.store.params import StoreParams
from fwclass.store.remote import RemoteStore
from fwclass.store.remote_lock import remote_holder, remote_writer
from fwclass.store.remote_read import Remote
from fwclass.store.run_store import SeenStore, Store
from fwclass.store.url import Url

Home = Path | Remote
"""Small, and sent with every part."""


def home_of(out: Path | Url, params: StoreParams) -> Home:
    """The run directory that a user named."""
    return Remote(out, params) if isinstance(out, Url) else out.resolve()


def address_of(home: Home) -> Path | Url:
    """What the user named."""
    return home.url if isinstance(home, Remote) else home


def open_store(home: Home, read_only: bool = False, lists: bool = False) -> Store:
    """The store of a run; with `lists` for who asks about all of it, and says what was made meanwhile (`forget`)."""
    if isinstance(home, Remote):
        return RemoteStore.at(home, read_only, lists)
    return (SeenStore if lists else Store)(home, read_only)


def held_by(home: Home) -> Mapping[str, Any] | None:
    """Host and pid of the run that is writing there, None where there is none."""
    return remote_holder(home.objects) if isinstance(home, Remote) else holder(home)


@contextmanager
def locked(home: Home, tell: Callable[[str], None]) -> Iterator[tuple[Home, Callable[[], None]]]:
    """Hold the run: where parts are to be committed now, and what raises `StoreError` once the lock is lost."""
    if isinstance(home, Remote):
        with remote_writer(home.objects, tell) as (token, beat):
            yield replace(home, token=token), beat.check
    else:
        with writer(home) as check:
            yield home, check
