"""Receipts of a run, looked up: each time anew in a directory, many at a time and kept in memory on object storage."""

from __future__ import annotations

import itertools
import json
import threading
import time
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from fwclass.errors import DamagedError, StoreError
from fwclass.paths import name_fault
from fwclass.store.atomic import digest_of
from fwclass.store.bucket import Files
from fwclass.store.digests import Looks
from fwclass.store.objects import Mark, StoredObject
from fwclass.store.receipts import Receipt

Name = tuple[str, str]
"""(stage, part)."""
RECEIPT = "receipt.json"
AT_A_TIME = 256
"""Receipts that are fetched together."""
IN_MEMORY = 1 << 26
"""Bytes of receipts that are kept in memory, some 20 000 of a tile of 100 m; the one kept longest goes first."""

REMEMBERED = 1 << 23
"""Bytes of receipts in a directory that a process remembers, some 2 500 of a tile, which take eight times as much in
memory: a worker asks for those of a tile's neighbours again and again."""
SETTLED = 100_000_000
"""ns since a receipt was written after which it is remembered: the clocks of file systems tick up to 20 ms apart, and
what is written again within a tick looks the same."""


class _Remembered:
    """Receipts by path, each with how its file looked; those that were kept longest go when they are too many bytes."""

    def __init__(self) -> None:
        self._receipts: dict[str, tuple[Looks, tuple[Receipt | None, Mark]]] = {}
        self._bytes, self._guard = 0, threading.Lock()

    def get(self, path: str, looks: Looks) -> tuple[Receipt | None, Mark] | None:
        """What was kept of the file, None where it looks otherwise now."""
        entry = self._receipts.get(path)
        return entry[1] if entry is not None and entry[0] == looks else None

    def keep(self, path: str, looks: Looks, receipt: tuple[Receipt | None, Mark]) -> None:
        with self._guard:
            self._drop(path)
            while self._receipts and self._bytes + looks[0] > REMEMBERED:
                self._drop(next(iter(self._receipts)))
            self._receipts[path] = looks, receipt
            self._bytes += looks[0]

    def _drop(self, path: str) -> None:
        entry = self._receipts.pop(path, None)
        self._bytes -= entry[0][0] if entry else 0


_remembered = _Remembered()


class _Parsed:
    """Receipts by their bytes and where these lie: what this process wrote, or has read, is not parsed again."""

    def __init__(self) -> None:
        self._receipts: OrderedDict[tuple[str, bytes], Receipt] = OrderedDict()
        self._bytes, self._guard = 0, threading.Lock()

    def get(self, where: str, data: bytes) -> Receipt | None:
        return self._receipts.get((where, data))

    def keep(self, where: str, data: bytes, receipt: Receipt) -> None:
        with self._guard:
            self._bytes += 0 if (where, data) in self._receipts else len(data)
            self._receipts[where, data] = receipt
            while self._bytes > REMEMBERED:
                self._bytes -= len(self._receipts.popitem(last=False)[0][1])


_parsed = _Parsed()


class Lookup:
    """Receipts below `files`; None for none, and no receipt where it is damaged.

    With `lists`, for who asks about the whole run and says what was made meanwhile (`forget`): a receipt is read once,
    and all objects are listed at the first question; what is not in the list is not there.
    """

    def __init__(self, files: Files, lists: bool) -> None:
        self._files, self._lists, self._keeps = files, lists, lists or files.far
        self._receipts: OrderedDict[Name, tuple[Receipt | None, Mark, int] | None] = OrderedDict()
        self._bytes = 0
        self._list: dict[str, StoredObject] | None = None
        self._renewed: set[Name] = set()

    def receipt(self, name: Name) -> tuple[Receipt | None, Mark] | None:
        """The receipt of a part and its mark."""
        if not self._keeps:
            return self._now(receipt_key(*name))
        if name not in self._receipts:
            self._look_up([name])
        entry = self._receipts[name]
        return entry[:2] if entry else None

    def _now(self, key: str) -> tuple[Receipt | None, Mark] | None:
        """The receipt under `key` as it lies there; it is not read where this process has and it looks as it did."""
        looks = self._files.look(key)
        if looks is None:
            return None
        path = f"{self._files.root}/{key}"
        entry = _remembered.get(path, looks)
        if entry is not None:
            return entry
        receipt = self._read(key, self._files.get(key))
        if receipt is not None and time.time_ns() - max(looks[1:]) > SETTLED:
            _remembered.keep(path, looks, receipt)
        return receipt

    def look_up(self, names: Iterable[Name]) -> None:
        """All these will be asked for: what is far away is fetched together."""
        if self._files.far:
            every = iter(names)
            while some := list(itertools.islice(every, AT_A_TIME)):  # so many that their receipts fit into memory
                self._look_up([n for n in dict.fromkeys(some) if n not in self._receipts])

    def _look_up(self, names: list[Name]) -> None:
        listed, wanted = self.listed(), []
        for name in names:
            item = None if listed is None else listed.get(receipt_key(*name))
            copy = self._copied(item) if item else None
            if name in self._renewed or listed is None or (item and copy is None):
                wanted.append(name)
            else:
                self._keep(name, copy)
        for name, data in zip(wanted, self._files.many([receipt_key(*n) for n in wanted]), strict=True):
            read = self._read(receipt_key(*name), data)
            if read is None or data is None or read[0] is None:
                self._keep(name, read and (*read, len(data[0]) if data else 0))
            else:
                self.remember(name, read[0], read[1], data[0])

    def _read(self, key: str, data: tuple[bytes, Mark] | None) -> tuple[Receipt | None, Mark] | None:
        if data is None:
            return None
        where = str(self._files.where / key)
        receipt = _parsed.get(where, data[0])
        if receipt is None:
            try:
                receipt = parse_receipt(data[0], key, where)
            except DamagedError:
                return None, data[1]
            _parsed.keep(where, data[0], receipt)
        return receipt, data[1]

    def _keep(self, name: Name, entry: tuple[Receipt | None, Mark, int] | None) -> None:
        self._drop(name)
        self._receipts[name] = entry
        self._bytes += entry[2] if entry else 0
        while self._bytes > IN_MEMORY and len(self._receipts) > 1:
            self._drop(next(iter(self._receipts)))

    def _drop(self, name: Name) -> None:
        entry = self._receipts.pop(name, None)
        self._bytes -= entry[2] if entry else 0

    def wrote(self, name: Name, receipt: Receipt, mark: Mark, data: bytes) -> None:
        """What this process has written of a part."""
        where = str(self._files.where / receipt_key(*name))
        _parsed.keep(where, data, Receipt.written(json.loads(data), where))
        self.remember(name, receipt, mark, data)

    def remember(self, name: Name, receipt: Receipt, mark: Mark, data: bytes) -> None:
        """What was just read of a part, or written, and of its files if it is younger than the list."""
        if not self._keeps:
            return
        self._keep(name, (receipt, mark, len(data)))
        key = receipt_key(*name)
        if self._list is not None and name in self._renewed:
            self._renewed.discard(name)
            self._list[key] = StoredObject(key, len(data), mark, 0.0)
            for output, facts in receipt.outputs.items():
                file = f"{self._files.unit(receipt)}/{output}"
                self._list[file] = StoredObject(file, int(facts["bytes"]), Mark(None), 0.0)
        if self._files.far and self._lists:
            path = self._copy_of(key, mark)
            path.parent.mkdir(parents=True, exist_ok=True)
            beside = path.with_suffix(".new")
            beside.write_bytes(data)
            beside.replace(path)

    def forget(self, name: Name) -> None:
        """The part was made, by whomever: what is remembered of it does not hold."""
        self._renewed.add(name)
        self._drop(name)

    # the list of all objects

    def listed(self) -> dict[str, StoredObject] | None:
        """Every object of the store by key, where they are to be listed."""
        if self._lists and self._files.far and self._list is None:
            self._list = self._all()
            receipts = [h for h in self._list.values() if h.key.endswith(f"/{RECEIPT}")]
            lacking = (h.key.split("/") for h in receipts if not self._copy_of(h.key, h.mark).exists())
            self.look_up((words[1], words[2]) for words in lacking)
        return self._list

    def _all(self) -> dict[str, StoredObject]:
        return {item.key: item for item in self._files.list("store")}

    def all(self) -> Mapping[str, StoredObject]:
        """Every file of the store by key."""
        listed = self.listed()
        return self._all() if listed is None else listed

    def names(self, below: str) -> Sequence[str]:
        """What lies directly below a key of the store, in order."""
        if not self._files.far:
            return self._files.names(below)
        keys = (key[len(below) + 1 :] for key in self.all() if key.startswith(f"{below}/"))
        return sorted({key.split("/")[0] for key in keys})

    def sizes(self, receipt: Receipt) -> dict[str, int]:
        """Bytes of a part's files that are there, by name."""
        unit, listed = self._files.unit(receipt), self.listed()
        if listed is None:
            return self._files.sizes(unit, receipt.outputs)
        keys = {name: f"{unit}/{name}" for name in receipt.outputs}
        return {name: listed[key].size for name, key in keys.items() if key in listed}

    # copies of receipts on this host, so that a list is enough to know them again

    def _copy_of(self, key: str, mark: Mark) -> Path:
        name = digest_of([key, mark.e_tag, mark.version])
        return self._files.root / "receipts" / name[:2] / name

    def _copied(self, item: StoredObject) -> tuple[Receipt, Mark, int] | None:
        try:
            data = self._copy_of(item.key, item.mark).read_bytes()
            return parse_receipt(data, item.key, item.key), item.mark, len(data)
        except (OSError, StoreError):
            return None

    def clear_copies(self) -> None:
        """Remove kept receipts that are not the present ones."""
        now = {self._copy_of(item.key, item.mark).name for key, item in self.all().items() if key.endswith(RECEIPT)}
        for path in (self._files.root / "receipts").glob("*/*"):
            if path.name not in now:
                path.unlink(missing_ok=True)


def receipt_key(stage: str, part: str) -> str:
    """Where a part's receipt lies; `StoreError` for names that lead elsewhere."""
    return f"{part_key(stage, part)}/{RECEIPT}"


@lru_cache(maxsize=4096)
def part_key(stage: str, part: str) -> str:
    """The directory of a part; `StoreError` for names that lead elsewhere."""
    fault = name_fault(stage) or name_fault(part)
    if fault:
        raise StoreError("this cannot be the name of a part", where="the store", got=f"{stage!r}/{part!r}: {fault}")
    return f"store/{stage}/{part}"


def parse_receipt(data: bytes, key: str, where: str) -> Receipt:
    """The receipt under `key`, which must be of the part that the key names (`StoreError`); `DamagedError` for none."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as fault:
        raise DamagedError("not a receipt", where=where, got=fault, do="remove the file") from fault
    receipt = Receipt.from_json(value, where)
    if receipt_key(receipt.stage, receipt.part) != key:
        raise StoreError(
            "a receipt of another part",
            where=where,
            expected=key.removeprefix("store/").removesuffix(f"/{RECEIPT}"),
            got=f"{receipt.stage}/{receipt.part}",
            do="remove the file; the part is made anew",
        )
    return receipt


def units_by_part(keys: Iterable[str], no_stages: Iterable[str]) -> Iterator[tuple[Name, dict[str, list[str]]]]:
    """Keys of parts' files by part, and by the directory that they lie in."""
    parts: dict[Name, dict[str, list[str]]] = {}
    for key in keys:
        words = key.split("/")
        if len(words) > 4 and words[1] not in no_stages:
            parts.setdefault((words[1], words[2]), {}).setdefault("/".join(words[:4]), []).append(key)
    yield from parts.items()
