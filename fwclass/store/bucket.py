"""Files of a run on object storage, with the names of `directory`; copies of what is read lie on this host's disk.

Keys below the run's address are the paths of a run directory, but that a part's directory is ``<key>-<digest>``, so
that no object is ever written over by another part's bytes.
"""

from __future__ import annotations

import json
import os
import socket
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from fwclass.errors import StoreError
from fwclass.store.atomic import digest_of, file_digest, files_below, remove_directory, staged, to_json
from fwclass.store.digests import Looks, remember
from fwclass.store.directory import FACTS, GENERATIONS, MANIFEST, Directory, Facts, Sealing, failure_key
from fwclass.store.objects import MOST_COPIED, Download, Mark, Objects, StoredObject, objects_at
from fwclass.store.params import StoreParams
from fwclass.store.receipts import Receipt
from fwclass.store.remote_lock import check_token
from fwclass.store.scratch import Scratch, scratch_of
from fwclass.store.url import Url

CURRENT = "current.json"

_written: set[tuple[Url, str]] = set()
"""What this process has written once: (address, key)."""


@dataclass(frozen=True)
class Remote:
    """Where a run lies on object storage; small, because it travels with every part.

    `token`: of the lock under which parts are committed; empty: of nobody's.
    """

    url: Url
    params: StoreParams
    token: str = ""

    @property
    def objects(self) -> Objects:
        """The objects below the address."""
        return objects_at(self.url, self.params)

    @property
    def scratch(self) -> Scratch:
        """Where copies lie on this host."""
        return scratch_of(self.params)

    @property
    def copies(self) -> Path:
        """Directory on this host that stands for the run's address."""
        return self.scratch.root / digest_of(str(self.url))[:16]

    def __str__(self) -> str:
        return str(self.url)


@dataclass(frozen=True)
class Bucket:
    """The objects below the address of `remote`; each method does what its namesake of `Directory` does."""

    remote: Remote
    far: ClassVar[bool] = True

    @property
    def objects(self) -> Objects:
        """The objects below the run's address."""
        return self.remote.objects

    @property
    def root(self) -> Path:
        """The directory of copies on this host."""
        return self.remote.copies

    @property
    def where(self) -> Url:
        return self.remote.url

    def unit(self, receipt: Receipt) -> str:
        return unit_of(receipt)

    # files

    def list(self, below: str) -> Iterator[StoredObject]:
        return self.objects.list(below)

    def names(self, below: str) -> Sequence[str]:
        return sorted({item.key[len(below) + 1 :].split("/")[0] for item in self.list(below)})

    def sizes(self, below: str, names: Iterable[str]) -> dict[str, int]:
        sizes = {item.key[len(below) + 1 :]: item.size for item in self.list(below)}
        return {name: sizes[name] for name in names if name in sizes}

    def digests(self, sizes: Mapping[str, int]) -> dict[str, str]:
        """As of a directory: every object is read, whatever copies this host has."""
        digests = self.objects.all(lambda item: self.objects.digest(*item), sizes.items())
        return {key: digest for key, digest in zip(sizes, digests, strict=True) if digest is not None}

    def get(self, key: str) -> tuple[bytes, Mark] | None:
        return self.objects.get(key)

    def many(self, keys: Sequence[str]) -> Sequence[tuple[bytes, Mark] | None]:
        return self.objects.many(keys)

    def put(self, key: str, text: str) -> None:
        self.objects.put(key, text.encode())

    def look(self, key: str) -> Looks | None:
        """Nothing tells without a request."""
        return None

    def put_once(self, key: str, text: Callable[[], str]) -> None:
        """As in a directory; one that another process wrote is written again, which costs less than to ask."""
        if (self.where, key) not in _written:
            self.put(key, text())
            _written.add((self.where, key))

    def put_new(self, key: str, text: str) -> Mark:
        return self.objects.put_new(key, text.encode())

    def put_over(self, key: str, text: str, mark: Mark) -> Mark:
        return self.objects.put_over(key, text.encode(), mark)

    def delete(self, keys: Iterable[str]) -> None:
        self.objects.delete(keys)

    def delete_below(self, below: str, first: str) -> None:
        self._delete_after([item.key for item in self.list(below)], first)

    def _delete_after(self, keys: Sequence[str], first: str) -> None:
        """Remove objects, those whose last name is `first` before all others."""
        self.delete(key for key in keys if key.endswith(f"/{first}"))
        self.delete(key for key in keys if not key.endswith(f"/{first}"))

    def fetch(self, below: str, files: Mapping[str, Facts]) -> None:
        downloads = {n: Download(f"{below}/{n}", int(f["bytes"]), self.root / below / n) for n, f in files.items()}
        digests = {n: str(f["digest"]) for n, f in files.items()}
        try:
            self.remote.scratch.need(self.objects, f"{self.root.name}/{below}", downloads, digests)
        except FileNotFoundError as fault:
            raise StoreError(
                "an object of a finished part is gone",
                where=self.where / below,
                got=fault,
                do="run again; the part is made anew",
            ) from fault

    def flush(self, below: str) -> None:
        """Object storage forgets nothing that it has acknowledged."""

    def check(self) -> None:
        if self.remote.token:
            check_token(self.objects, self.remote.token)

    # parts

    @contextmanager
    def making(self, stage: str, part: str) -> Iterator[tuple[Path, Callable[[], None]]]:
        """As in a directory; an object tells of the part until it is committed, or has failed."""
        mark = f"store/staging/{stage}/{part}"
        self.put(mark, json.dumps({"host": socket.gethostname(), "pid": os.getpid()}))
        try:
            with staged(self.root / "store" / "staging", stage, part) as directory:
                yield directory, lambda: None
        except BaseException:
            with suppress(StoreError):  # the next holder of the lock removes it
                self.delete([mark])
            raise

    def finish(self, path: Path, delivered: bool) -> None:
        """The file is to be uploaded."""

    def put_part(self, receipt: Receipt, directory: Path) -> None:
        unit, scratch = self.unit(receipt), self.remote.scratch
        target = self.root / unit
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch.drop(f"{self.root.name}/{unit}")
        directory.replace(target)
        scratch.adopt(f"{self.root.name}/{unit}", sum(int(f["bytes"]) for f in receipt.outputs.values()))
        for name, facts in receipt.outputs.items():
            remember(target / name, str(facts["digest"]))
        self.objects.put_files({f"{unit}/{name}": target / name for name in receipt.outputs})

    def collect(self, receipt: Receipt, old: Receipt | None) -> None:
        name = receipt.stage, receipt.part
        gone = [f"store/staging/{'/'.join(name)}", failure_key(*name)]
        if old is not None and self.unit(old) != self.unit(receipt):
            gone += [f"{self.unit(old)}/{output}" for output in old.outputs]
        self.delete(gone)

    def delete_outputs(self, names: Iterable[str]) -> None:
        """No part lies at the address itself."""

    def under_way(self) -> dict[tuple[str, str], float]:
        keys = ((item.key.split("/"), item.written) for item in self.list("store/staging"))
        return {(k[2], k[3]): written for k, written in keys if len(k) == 4}

    def sweep(self) -> None:
        """What killed workers left is removed when the next run begins: to find it, everything is listed."""

    # generations

    def check_links(self) -> None:
        """A delivery has a prefix of its own, where nothing of a user's stands."""

    def astray(self, name: str) -> tuple[str, ...]:
        """Nothing: readers of a bucket go by the pointer alone."""
        return ()

    def pointer(self) -> tuple[str, Mark] | None:
        pointer = self.get(CURRENT)
        if pointer is None:
            return None
        try:
            return str(json.loads(pointer[0])["generation"]), pointer[1]
        except (ValueError, TypeError, KeyError, RecursionError):
            return "", pointer[1]

    def point(self, name: str, facts: Mapping[str, Any], mark: Mark | None) -> None:
        """As in a directory; `LostRace` where the pointer is not the one any more that was read.

        No two pointers are the same bytes, so that none is taken for an earlier one.
        """
        address = {"generation": name, "address": f"{GENERATIONS}/{name}", "written": uuid.uuid4().hex}
        text = to_json({**address, **facts})
        if mark is None:
            self.put_new(CURRENT, text)
        else:
            self.put_over(CURRENT, text, mark)

    def deliver(
        self, pending: Path, number: int, files: Mapping[str, tuple[Path, str]], before: str, sealing: Sealing
    ) -> str:
        """As in a directory; the name has digits that no other writer's generation of that number has."""
        name = f"{number:04d}-{uuid.uuid4().hex[:8]}"
        unit = f"{GENERATIONS}/{name}"
        sizes = self._copy(unit, files)
        reports = {p.relative_to(pending).as_posix(): p for p in files_below(pending)}
        self.objects.put_files({f"{unit}/{to}": p for to, p in reports.items()})
        digests = {to: of for to, (_, of) in files.items()} | {to: file_digest(p) for to, p in reports.items()}
        sizes |= {to: p.stat().st_size for to, p in reports.items()}
        present = {h.key[len(unit) + 1 :]: h for h in self.list(unit)}
        lacking = sorted(to for to, size in sizes.items() if to not in present or present[to].size != size)
        if lacking:
            there = present.get(lacking[0])
            raise StoreError(
                "what was just delivered is gone, or of another size",
                where=self.where / unit / lacking[0],
                expected=f"{sizes[lacking[0]]} bytes",
                got=f"{there.size} bytes" if there else "nothing",
                do="run again",
            )
        manifest = {
            to: {"bytes": present[to].size, "digest": of, "e_tag": present[to].mark.e_tag} for to, of in digests.items()
        }
        for to, text in zip((MANIFEST, FACTS), sealing(manifest), strict=True):
            self.put_new(f"{unit}/{to}", text)
        return name

    def _copy(self, unit: str, files: Mapping[str, tuple[Path, str]]) -> dict[str, int]:
        """Copy parts' files, named by their copies on this host with their digests, below a key; the server does it,
        but for large ones. Their bytes."""
        sizes = {item.key: item.size for item in self.list("store")}
        pairs = [(files[to][0].relative_to(self.root).as_posix(), f"{unit}/{to}", files[to]) for to in sorted(files)]
        gone = [key for key, _, _ in pairs if key not in sizes]
        if gone:
            raise StoreError(
                "a part's file is gone", where=self.where / gone[0], do="run again; the missing parts are made"
            )
        small = [pair[:2] for pair in pairs if sizes[pair[0]] <= MOST_COPIED]
        self.objects.all(lambda pair: self.objects.copy(*pair), small)
        for key, target, (path, digest) in pairs:
            if sizes[key] > MOST_COPIED:
                below, _, name = key.rpartition("/")
                self.fetch(below, {name: {"bytes": sizes[key], "digest": digest}})
                self.objects.put_files({target: path})
        return {target[len(unit) + 1 :]: sizes[key] for key, target, _ in pairs}

    def retire(self, names: Iterable[str]) -> None:
        wanted = set(names)
        if wanted:
            keys = [h.key for h in self.list(GENERATIONS) if h.key.split("/")[1] in wanted]
            self._delete_after(keys, FACTS)

    def clear_copies(self) -> None:
        """Remove what this host's earlier process left half."""
        remove_directory(self.root / "store" / "staging")


Files = Directory | Bucket
"""What a store stands on."""


def files_at(location: Path | Remote) -> Files:
    """The files of a run."""
    return Bucket(location) if isinstance(location, Remote) else Directory(location)


def unit_of(receipt: Receipt) -> str:
    """The directory of a part's files, on object storage and in the copies."""
    return f"store/{receipt.stage}/{receipt.part}/{receipt.key}-{receipt.digest[:8]}"
