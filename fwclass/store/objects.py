"""One prefix of a bucket: reading, writing, conditional writing, listing. The only file that imports obstore."""

from __future__ import annotations

import hashlib
import itertools
import os
import random
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from fwclass.errors import ConfigError, StoreError
from fwclass.store.params import StoreParams
from fwclass.store.refusals import LostRace, as_store_error, lasting
from fwclass.store.url import Url
from fwclass.units import MIB

T = TypeVar("T")
CREDENTIALS = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN")
LEAST = 3
"""Times that a request is made before it is given up."""
MOST_COPIED = 5 * 10**9
"""Bytes: no server copies a larger object in one request."""


@dataclass(frozen=True)
class Mark:
    """Which version of an object it is: what the server calls it, never a time."""

    e_tag: str | None
    version: str | None = None

    @property
    def condition(self) -> dict[str, str]:
        """As object storage takes it: write only where the object is as it was."""
        return {n: v for n, v in (("e_tag", self.e_tag), ("version", self.version)) if v is not None}


@dataclass(frozen=True)
class StoredObject:
    """An object as a list shows it: key below the prefix, bytes, mark, when it was written [s since the epoch]."""

    key: str
    size: int
    mark: Mark
    written: float


@dataclass(frozen=True)
class Download:
    """An object to be written to the file `target`: its bytes, and its version if that matters."""

    key: str
    size: int
    target: Path
    e_tag: str | None = None


class Objects:
    """The objects below `url`. Every method raises `StoreError` where object storage fails for `params.patience`."""

    def __init__(self, url: Url, params: StoreParams) -> None:
        self.url, self.params = url, params
        self._store = _open_store(str(url), params)
        self._pool = ThreadPoolExecutor(params.parallel, thread_name_prefix="objects")

    def get(self, key: str) -> tuple[bytes, Mark] | None:
        """Bytes and mark of an object, None where there is none."""
        import obstore

        def read() -> tuple[bytes, Mark]:
            answer = obstore.get(self._store, key)
            return bytes(answer.bytes()), _mark(answer.meta)

        try:
            return self._again(read, key)
        except FileNotFoundError:
            return None

    def many(self, keys: Sequence[str]) -> list[tuple[bytes, Mark] | None]:
        """As `get`, of several."""
        return self.all(self.get, keys)

    def all(self, work: Callable[[Any], T], items: Iterable[Any]) -> list[T]:
        """`work` of every one of `items`, several at a time; the first fault comes out."""
        return list(self._pool.map(work, items))

    def put(self, key: str, data: bytes) -> None:
        """Write an object, whatever is there."""
        import obstore

        self._again(lambda: obstore.put(self._store, key, data), key)

    def put_files(self, files: Mapping[str, Path]) -> None:
        """Upload files to keys, several at a time, and several pieces of large ones; each appears whole or not."""
        import obstore

        chunk, streams = self.params.chunk_mib * MIB, self.params.parallel
        sizes = {key: path.stat().st_size for key, path in files.items()}
        small = [item for item in files.items() if sizes[item[0]] <= chunk]
        large = [item for item in files.items() if sizes[item[0]] > chunk]
        self.all(lambda item: self._again(lambda: obstore.put(self._store, *item, use_multipart=False), item[0]), small)
        for key, path in large:
            self._again(
                lambda key=key, path=path: obstore.put(  # type: ignore[misc]
                    self._store, key, path, use_multipart=True, chunk_size=chunk, max_concurrency=streams
                ),
                key,
            )

    def put_new(self, key: str, data: bytes) -> Mark:
        """Write an object that must not be there yet; `LostRace` if it is."""
        return self._conditional(key, data, "create")

    def put_over(self, key: str, data: bytes, mark: Mark) -> Mark:
        """Write over the version `mark` of an object; `LostRace` if it is another one by now, or gone."""
        return self._conditional(key, data, mark.condition)

    def _conditional(self, key: str, data: bytes, mode: Any) -> Mark:
        import obstore
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        try:
            result = self._again(lambda: obstore.put(self._store, key, data, mode=mode, use_multipart=False), key)
            return _mark(result)
        except (AlreadyExistsError, PreconditionError) as fault:
            present = self.get(key)
            if present is not None and present[0] == data:
                return present[1]  # it was ours: an answer was lost on the way and the request sent again
            raise LostRace(
                "another run wrote here at the same time",
                where=self.url / key,
                do="let only one run work below this address, then run the same again",
            ) from fault

    def list(self, below: str = "") -> Iterator[StoredObject]:
        """Every object whose key begins with ``below/`` (all)."""
        import obstore

        def read() -> list[StoredObject]:
            objects: dict[str, StoredObject] = {}
            for one in itertools.chain.from_iterable(obstore.list(self._store, below or None, chunk_size=1000)):
                key = one["path"]
                if key in objects:  # a server whose pages go round would be listened to for ever
                    raise OSError(f"the list has {key!r} twice")
                objects[key] = StoredObject(key, one["size"], _mark(one), one["last_modified"].timestamp())
            return list(objects.values())

        yield from self._again(read, below)

    def delete(self, keys: Iterable[str]) -> None:
        """Remove objects; those that are gone already count as removed."""
        import obstore

        listed = list(keys)
        if listed:
            self._again(lambda: obstore.delete(self._store, listed), listed[0])

    def copy(self, source: str, target: str) -> None:
        """Copy an object on the server, of at most `MOST_COPIED` bytes."""
        import obstore

        try:
            self._again(lambda: obstore.copy(self._store, source, target), source)
        except FileNotFoundError as fault:
            raise StoreError(
                "a part's file is gone", where=self.url / source, do="run again; the missing parts are made"
            ) from fault

    def fetch(self, wanted: Sequence[Download]) -> None:
        """Write objects to files, several at a time, and several pieces of large ones.

        `FileNotFoundError`: there is no such object. `LostRace`: it is another version than the wanted one by now.
        """
        chunk = self.params.chunk_mib * MIB
        self.all(self._whole, [one for one in wanted if one.size <= chunk])
        for one in wanted:
            if one.size > chunk:
                pieces = [(first, min(one.size, first + chunk)) for first in range(0, one.size, chunk)]
                with one.target.open("wb") as stream:
                    stream.truncate(one.size)
                    handle = stream.fileno()
                    self.all(lambda piece, one=one, handle=handle: self._piece(one, handle, piece), pieces)  # type: ignore[misc]

    def _whole(self, one: Download) -> None:
        with one.target.open("wb") as stream:
            if one.size:
                self._piece(one, stream.fileno(), (0, one.size))

    def digest(self, key: str, size: int) -> str | None:
        """Digest of an object of `size` bytes, a piece after the other; None where there is none."""
        state, chunk = hashlib.blake2b(digest_size=16), self.params.chunk_mib * MIB
        try:
            for first in range(0, size, chunk):
                state.update(self._range(key, (first, min(size, first + chunk))))
        except FileNotFoundError:
            return None
        return state.hexdigest()

    def _piece(self, one: Download, handle: int, piece: tuple[int, int]) -> None:
        at, data = piece[0], self._range(one.key, piece, one.e_tag)
        while data:
            wrote = os.pwrite(handle, data, at)
            at, data = at + wrote, data[wrote:]

    def _range(self, key: str, piece: tuple[int, int], e_tag: str | None = None) -> memoryview:
        """Bytes ``[first, end)`` of an object, of the version `e_tag` if that matters."""
        import obstore
        from obstore.exceptions import PreconditionError

        options: Any = {"range": piece, **({"if_match": e_tag} if e_tag else {})}

        def read() -> memoryview:
            answer = obstore.get(self._store, key, options=options)
            data, came = memoryview(answer.bytes()), answer.meta.get("e_tag")
            if e_tag and came and came != e_tag:  # not every server heeds what was asked for
                raise LostRace("an object was changed while it was read", where=self.url / key)
            if len(data) != piece[1] - piece[0]:
                raise OSError(f"{len(data)} bytes came, not {piece[1] - piece[0]}")
            return data

        try:
            return self._again(read, key)
        except PreconditionError as fault:
            raise LostRace("an object was changed while it was read", where=self.url / key) from fault

    def _again(self, work: Callable[[], T], key: str) -> T:
        """`work`, tried again while it fails for another reason than that the object is (not) there."""
        from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError

        began, wait = time.monotonic(), 0.1
        for tries in itertools.count(1):
            try:
                return work()
            except (FileNotFoundError, AlreadyExistsError, PreconditionError) as fault:
                if "NoSuchBucket" in str(fault):
                    raise as_store_error(fault, self.url / key, time.monotonic() - began) from fault
                raise
            except (BaseError, OSError) as fault:
                spent = time.monotonic() - began
                local = isinstance(fault, OSError) and fault.errno is not None
                if local:
                    raise
                enough = (
                    spent + wait > self.params.patience and tries >= LEAST
                )  # a host that slept has spent no patience
                if lasting(fault) or enough:
                    raise as_store_error(fault, self.url / key, spent) from fault
                time.sleep(wait * random.uniform(0.5, 1.0))  # noqa: S311 - workers shall not all come back at once
                wait = min(2 * wait, 10.0)
        raise AssertionError


def _mark(meta: Any) -> Mark:
    return Mark(meta.get("e_tag"), meta.get("version"))


_memory: dict[str, Any] = {}
_guard = threading.Lock()


@lru_cache(maxsize=8)
def objects_at(url: str, params: StoreParams) -> Objects:
    """The objects below `url`, opened once in this process."""
    return Objects(Url(url), params)


def _open_store(url: str, params: StoreParams) -> Any:
    try:
        from obstore.exceptions import BaseError
        from obstore.store import MemoryStore, from_url
    except ImportError as fault:
        raise ConfigError(
            "object storage needs a library that is not installed",
            where=url,
            expected="obstore",
            got=fault,
            do="pip install 'fwclass[cloud]'",
        ) from fault
    if url.startswith("memory://"):
        with _guard:
            return _memory.setdefault(url, MemoryStore())
    for name in CREDENTIALS:
        if not os.environ.get(name, "").isprintable():  # the library panics where it becomes a header
            raise ConfigError(
                "a credential has a character that cannot be seen",
                where=name,
                expected="one line, without its end",
                do=f"set it again: {name}=$(tr -d '\\r\\n' < FILE)",
            )
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""
    limits: dict[str, Any] = {
        "client_options": {
            "timeout": timedelta(seconds=params.timeout),
            "connect_timeout": timedelta(seconds=params.timeout),
            "allow_http": endpoint.startswith("http://"),
        },
        "retry_config": {"max_retries": 3, "retry_timeout": timedelta(seconds=min(params.patience, params.timeout))},
    }
    if url.startswith("s3://") and endpoint:
        limits["endpoint"] = endpoint
    try:
        return from_url(url, **limits)
    except (BaseError, ValueError) as fault:
        raise as_store_error(fault, url, 0.0) from fault
