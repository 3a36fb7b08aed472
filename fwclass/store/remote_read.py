"""Reading a run on object storage: receipts, and copies of the files on this host's disk.

Keys below the run's address are the paths of a local store, but that a part's directory is ``<key>-<digest>``, so that
no object is ever written over by another part's bytes.
"""

from __future__ import annotations

import itertools
import json
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

from fwclass.errors import DamagedError, StoreError
from fwclass.store.atomic import digest_of, file_digest
from fwclass.store.objects import Held, Mark, Objects, Wanted, objects_at
from fwclass.store.params import StoreParams
from fwclass.store.receipts import Receipt
from fwclass.store.remote_failures import RemoteFailures
from fwclass.store.remote_generations import RemoteGenerations
from fwclass.store.run_store import RECEIPT, Store
from fwclass.store.scratch import Scratch, scratch_of
from fwclass.store.url import Url

Name = tuple[str, str]
AT_A_TIME = 256
"""Receipts that are fetched together."""
IN_MEMORY = 1 << 27
"""Bytes of receipts that are kept in memory; others are read again from the copies."""


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
        return objects_at(self.url, self.params)

    @property
    def scratch(self) -> Scratch:
        return scratch_of(self.params)

    @property
    def copies(self) -> Path:
        """Directory on this host that stands for the run's address."""
        return self.scratch.root / digest_of(str(self.url))[:16]

    def __str__(self) -> str:
        return str(self.url)


@dataclass
class Seen:
    """What a store has seen of its receipts, None for a damaged one; with a list of all objects, what is not in it is
    not there."""

    receipts: OrderedDict[Name, tuple[Receipt | None, Mark, int] | None] = field(default_factory=OrderedDict)
    bytes: int = 0
    listed: dict[str, Held] | None = None
    renewed: set[Name] = field(default_factory=set)

    def keep(self, name: Name, found: tuple[Receipt | None, Mark, int] | None) -> None:
        """Remember a part's receipt (with its mark and size) or that there is none, and forget what is too much."""
        self.forget(name)
        self.receipts[name] = found
        self.bytes += found[2] if found else 0
        while self.bytes > IN_MEMORY and len(self.receipts) > 1:
            self.forget(next(iter(self.receipts)))

    def forget(self, name: Name) -> None:
        found = self.receipts.pop(name, None)
        self.bytes -= found[2] if found else 0


@dataclass(frozen=True)
class RemoteReader(Store):
    """The reading side of a `RemoteStore`; `root` is the directory of copies on this host.

    With `lists`, all objects are listed once, at the first question: for who asks about the whole run.
    """

    remote: Remote = field(kw_only=True)
    lists: bool = False
    _seen: Seen = field(default_factory=Seen, compare=False)

    @classmethod
    def at(cls, remote: Remote, read_only: bool = False, lists: bool = False) -> Self:
        return cls(remote.copies, read_only, remote=remote, lists=lists)

    @property
    def objects(self) -> Objects:
        return self.remote.objects

    @property
    def where(self) -> Url:
        return self.remote.url

    @property
    def failures(self) -> RemoteFailures:  # type: ignore[override]
        return RemoteFailures(self.objects)

    @property
    def generations(self) -> RemoteGenerations:
        return RemoteGenerations(self.root, self.objects, self.remote.scratch)

    # receipts

    def _listed(self) -> dict[str, Held] | None:
        if self.lists and self._seen.listed is None:
            self._seen.listed = {held.key: held for held in self.objects.list("store")}
            receipts = [h for h in self._seen.listed.values() if h.key.endswith(f"/{RECEIPT}")]
            lacking = (h.key.split("/") for h in receipts if not self._copy_of(h.key, h.mark).exists())
            self.look_up((words[1], words[2]) for words in lacking)
        return self._seen.listed

    def _all(self) -> Mapping[str, Held]:
        """Every object of the store by key."""
        listed = self._listed()
        return {held.key: held for held in self.objects.list("store")} if listed is None else listed

    def receipt(self, stage: str, part: str) -> Receipt | None:
        """As `Store.receipt`."""
        found = self._held(stage, part)
        return found[0] if found else None

    def _held(self, stage: str, part: str) -> tuple[Receipt | None, Mark] | None:
        """The object of the receipt; None for none, no receipt in it where it is damaged."""
        self.look_up([(stage, part)])
        found = self._seen.receipts[stage, part]
        return found[:2] if found else None

    def look_up(self, names: Iterable[Name]) -> None:
        listed = self._listed()
        for some in _batches(names):
            self._look_up([n for n in dict.fromkeys(some) if n not in self._seen.receipts], listed)

    def _look_up(self, wanted: list[Name], listed: Mapping[str, Held] | None) -> None:
        ask = []
        for name in wanted:
            held = None if listed is None else listed.get(key_of_receipt(*name))
            copied = self._copied(held) if held else None
            if name in self._seen.renewed or listed is None or (held and copied is None):
                ask.append(name)
            else:
                self._seen.keep(name, copied)
        for name, found in zip(ask, self.objects.many([key_of_receipt(*n) for n in ask]), strict=True):
            if found is None:
                self._seen.keep(name, None)
            else:
                key = key_of_receipt(*name)
                try:
                    receipt = _receipt_of(found[0], key, self.where / key)
                except DamagedError:
                    self._seen.keep(name, (None, found[1], len(found[0])))
                else:
                    self._remember(name, receipt, found[1], found[0])

    def _remember(self, name: Name, receipt: Receipt, mark: Mark, data: bytes) -> None:
        """What was just read or written of a part, and of its files if it is younger than the list."""
        self._seen.keep(name, (receipt, mark, len(data)))
        if self._seen.listed is not None and name in self._seen.renewed:
            self._seen.renewed.discard(name)
            key = key_of_receipt(*name)
            self._seen.listed[key] = Held(key, len(data), mark, 0.0)
            for below, facts in receipt.outputs.items():
                key = f"{unit_of(receipt)}/{below}"
                self._seen.listed[key] = Held(key, int(facts["bytes"]), Mark(None), 0.0)
        if self.lists:
            path = self._copy_of(key_of_receipt(*name), mark)
            path.parent.mkdir(parents=True, exist_ok=True)
            beside = path.with_suffix(".new")
            beside.write_bytes(data)
            beside.replace(path)

    def _copy_of(self, key: str, mark: Mark) -> Path:
        """Where the receipt is kept on this host, so that a list is enough to know it again."""
        name = digest_of([key, mark.e_tag, mark.version])
        return self.root / "receipts" / name[:2] / name

    def _copied(self, held: Held) -> tuple[Receipt, Mark, int] | None:
        try:
            data = self._copy_of(held.key, held.mark).read_bytes()
            return _receipt_of(data, held.key, held.key), held.mark, len(data)
        except (OSError, StoreError):
            return None

    def _forget_copies(self) -> None:
        """Remove kept receipts that are not the present ones."""
        now = {self._copy_of(held.key, held.mark).name for key, held in self._all().items() if key.endswith(RECEIPT)}
        for path in (self.root / "receipts").glob("*/*"):
            if path.name not in now:
                path.unlink(missing_ok=True)

    def forget(self, name: Name) -> None:
        self._seen.renewed.add(name)
        self._seen.forget(name)

    def receipts(self, stage: str) -> Iterator[Receipt]:
        keys = [k.split("/") for k in self._all()]
        parts = sorted({k[2] for k in keys if len(k) == 4 and k[1] == stage and k[3] == RECEIPT})
        self.look_up((stage, part) for part in parts)
        for part in parts:
            receipt = self.receipt(stage, part)
            if receipt is not None:
                yield receipt

    def parts(self) -> list[Name]:
        keys = (k.split("/") for k in self._all())
        return sorted({(k[1], k[2]) for k in keys if len(k) > 3})

    def _digests(self, kind: str) -> list[str]:
        names = (k.removeprefix(f"store/{kind}/") for k in self._all() if k.startswith(f"store/{kind}/"))
        return sorted(n.removesuffix(".json") for n in names)

    # files

    def base(self, receipt: Receipt) -> Path:
        return self.root / unit_of(receipt)

    def size_of(self, receipt: Receipt, name: str) -> int | None:
        return self._sizes(receipt).get(name)

    def _sizes(self, receipt: Receipt) -> dict[str, int]:
        """Bytes of a part's files that are there, by name."""
        unit, listed = unit_of(receipt), self._listed()
        if listed is None:
            return {held.key[len(unit) + 1 :]: held.size for held in self.objects.list(unit)}
        keys = {name: f"{unit}/{name}" for name in receipt.outputs}
        return {name: listed[key].size for name, key in keys.items() if key in listed}

    def damaged(self, receipt: Receipt) -> list[str]:
        """As `Store.damaged`: every object is fetched, whatever copies this host has."""
        unit, sizes, found = unit_of(receipt), self._sizes(receipt), []
        self.root.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=self.root) as scratch:
            for name, facts in receipt.outputs.items():
                target = Path(scratch) / "object"
                whole = sizes.get(name) == facts["bytes"]
                if whole:
                    with suppress(FileNotFoundError):  # it went just now
                        self.objects.fetch([Wanted(f"{unit}/{name}", int(facts["bytes"]), target)])
                if not whole or not target.exists() or file_digest(target) != facts["digest"]:
                    found.append(name)
                target.unlink(missing_ok=True)
        return found

    def done(self, stage: str, part: str, key: str) -> Receipt | None:
        receipt = self.receipt(stage, part)
        if receipt is None or receipt.key != key:
            return None
        there = self._sizes(receipt)
        whole = all(there.get(name) == facts["bytes"] for name, facts in receipt.outputs.items())
        return receipt if whole else None

    def path(self, stage: str, part: str, name: str) -> Path:
        """A copy of a file or directory of a finished part, on this host; held to the receipt's digests there."""
        receipt = self.receipt(stage, part)
        if receipt is None:
            raise self._not_done(stage, part)
        unit = unit_of(receipt)
        asked = {f"{name}{rest}": f for rest, f in receipt.files(name).items()}
        files = {n: Wanted(f"{unit}/{n}", int(f["bytes"]), self.root / unit / n) for n, f in asked.items()}
        digests = {n: str(f["digest"]) for n, f in asked.items()}
        try:
            self.remote.scratch.need(self.objects, f"{self.root.name}/{unit}", files, digests)
        except FileNotFoundError as fault:
            raise StoreError(
                "an object of a finished part is gone",
                where=f"{stage}/{part} in {self.where}",
                got=fault,
                do="run again; the part is made anew",
            ) from fault
        return self.root / unit / name

    def recall(self, name: str) -> Any:
        found = self.objects.get(f"store/{name}")
        return json.loads(found[0]) if found else None

    def under_way(self) -> dict[Name, float]:
        keys = ((held.key.split("/"), held.written) for held in self.objects.list("store/staging"))
        return {(k[2], k[3]): written for k, written in keys if len(k) == 4}

    def _not_done(self, stage: str, part: str) -> StoreError:
        return StoreError(
            "a part that others need is not done",
            where=f"{stage}/{part} in {self.where}",
            do="run again; the missing parts are made",
        )


def _batches(names: Iterable[Name]) -> Iterator[list[Name]]:
    """So many at a time that their receipts fit into memory."""
    every = iter(names)
    while some := list(itertools.islice(every, AT_A_TIME)):
        yield some


def key_of_receipt(stage: str, part: str) -> str:
    return f"store/{stage}/{part}/{RECEIPT}"


def unit_of(receipt: Receipt) -> str:
    """The directory of a part's files, on object storage and in the copies."""
    return f"store/{receipt.stage}/{receipt.part}/{receipt.key}-{receipt.digest[:8]}"


def _receipt_of(data: bytes, key: str, where: object) -> Receipt:
    """The receipt under `key`, which must be of the part that the key names."""
    try:
        receipt = Receipt.from_json(json.loads(data), where)
    except (ValueError, TypeError, RecursionError) as fault:
        raise DamagedError("not a receipt", where=where, got=fault, do="remove the object") from fault
    if key_of_receipt(receipt.stage, receipt.part) != key:
        raise StoreError(
            "a receipt of another part", where=where, got=f"{receipt.stage}/{receipt.part}", do="remove the object"
        )
    return receipt
