"""Generations of a run on object storage: copies made by the server, and an object that says which is current."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from fwclass import __version__
from fwclass.errors import StoreError
from fwclass.store.atomic import digest_of, files_below
from fwclass.store.generations import _FACTS, _PENDING, Generation, Generations
from fwclass.store.objects import MOST_COPIED, Mark, Objects, Wanted
from fwclass.store.scratch import Scratch
from fwclass.store.url import Url

CURRENT = "current.json"
_BELOW = "generations"


@dataclass(frozen=True)
class RemoteGeneration(Generation):
    """A generation at `address`; its path is where it would lie among the copies."""

    address: Url

    @property
    def where(self) -> Url:
        return self.address


@dataclass(frozen=True)
class RemoteGenerations(Generations):
    """As `Generations`: ``generations/<number>/…``, and ``current.json``, which names the one that readers see.

    `root` is the directory of copies on this host; only reports are written there before they are published.
    """

    objects: Objects
    scratch: Scratch

    @property
    def address(self) -> Url:
        return self.objects.url

    def all(self) -> list[Generation]:
        keys = sorted(
            h.key for h in self.objects.list(_BELOW) if h.key.endswith(f"/{_FACTS}") and h.key.count("/") == 2
        )
        found = zip(keys, self.objects.many(keys), strict=True)
        return sorted((self._read(k.split("/")[1], d[0]) for k, d in found if d), key=lambda g: g.number)

    def _read(self, name: str, data: bytes) -> Generation:
        facts = json.loads(data)
        path = self.directory / name
        where = self.address / _BELOW / name
        return RemoteGeneration(int(facts["number"]), path, bool(facts["whole"]), str(facts["digest"]), where)

    def _pointer(self) -> tuple[str, Mark] | None:
        found = self.objects.get(CURRENT)
        return (str(json.loads(found[0])["generation"]), found[1]) if found else None

    def current(self) -> Generation | None:
        pointer = self._pointer()
        facts = self.objects.get(f"{_BELOW}/{pointer[0]}/{_FACTS}") if pointer else None
        return self._read(pointer[0], facts[0]) if pointer and facts else None

    def shown(self, name: str) -> Path | None:
        """A copy of a file that the current generation has at its top, None where it has none."""
        pointer = self._pointer()
        key = f"{_BELOW}/{pointer[0]}/{name}" if pointer else ""
        held = next((h for h in self.objects.list(f"{_BELOW}/{pointer[0]}") if h.key == key), None) if pointer else None
        if held is None:
            return None
        unit = f"shown/{digest_of([key, held.mark.e_tag])}"
        wanted = {name: Wanted(key, held.size, self.root / unit / name)}
        self.scratch.need(self.objects, f"{self.root.name}/{unit}", wanted, {})
        return self.root / unit / name

    def publish(self, files: Mapping[str, tuple[Path, str]], whole: bool, keep: int) -> Generation:
        digest = digest_of({name: of for name, (_, of) in files.items()})
        pointer, before, there = self._pointer(), self.current(), self.all()
        if before is not None and before.whole == whole and before.digest == digest and self._same(before):
            self.clear_pending()
            return before
        numbers = [int(n) for h in self.objects.list(_BELOW) if (n := h.key.split("/")[1]).isdigit()]
        made = self._put(f"{1 + max(numbers, default=0):04d}", files, whole, digest)
        if whole or before is None or not before.whole:
            told = {"generation": made.name, "address": f"{_BELOW}/{made.name}", "digest": digest, "whole": whole}
            data = json.dumps(told, sort_keys=True, indent=1).encode()
            if pointer is None:
                self.objects.put_new(CURRENT, data)
            else:
                self.objects.put_over(CURRENT, data, pointer[1])
        self._drop([*there, made], keep)
        return made

    def _same(self, generation: Generation) -> bool:
        own = self.pending
        for path in files_below(own):
            there = self.objects.get(f"{_BELOW}/{generation.name}/{path.relative_to(own).as_posix()}")
            if there is None or there[0] != path.read_bytes():
                return False
        return True

    def _put(self, name: str, files: Mapping[str, tuple[Path, str]], whole: bool, digest: str) -> Generation:
        own, below = self.pending, f"{_BELOW}/{name}"
        sizes = {held.key: held.size for held in self.objects.list("store")}
        self._copy(sizes, {f"{below}/{to}": source for to, (source, _) in sorted(files.items())})
        reports = files_below(own)
        self.objects.put_files({f"{below}/{p.relative_to(own).as_posix()}": p for p in reports})
        facts = {
            "number": int(name), "made": datetime.now(UTC).isoformat(timespec="seconds"), "whole": whole,
            "digest": digest, "files": len(files), "fwclass": __version__,
        }  # fmt: skip
        data = json.dumps(facts, sort_keys=True, indent=1).encode()
        self.objects.put_new(f"{below}/{_FACTS}", data)
        self.clear_pending()
        return self._read(name, data)

    def _copy(self, sizes: Mapping[str, int], files: Mapping[str, Path]) -> None:
        """Copy parts' files, named by their copies on this host, to keys; the server does it, but for large ones."""
        pairs = [(source.relative_to(self.root).as_posix(), target) for target, source in files.items()]
        gone = [key for key, _ in pairs if key not in sizes]
        if gone:
            raise StoreError(
                "a part's file is gone", where=self.address / gone[0], do="run again; the missing parts are made"
            )
        self.objects.all(lambda pair: self.objects.copy(*pair), [p for p in pairs if sizes[p[0]] <= MOST_COPIED])
        for key, target in pairs:
            if sizes[key] > MOST_COPIED:
                unit, _, name = key.rpartition("/")
                path = self.root / key
                self.scratch.need(self.objects, f"{self.root.name}/{unit}", {name: Wanted(key, sizes[key], path)}, {})
                self.objects.put_files({target: path})

    def _drop(self, there: list[Generation], keep: int) -> None:
        pointer = self._pointer()
        wholes = [g.number for g in there if g.whole][-max(1, keep) :]
        for generation in there[:-1]:
            if generation.number not in wholes and (pointer is None or generation.name != pointer[0]):
                self._remove(generation.name)

    def _remove(self, name: str) -> None:
        self.objects.delete([f"{_BELOW}/{name}/{_FACTS}"])
        self.objects.delete(held.key for held in self.objects.list(f"{_BELOW}/{name}"))

    def clear_pending(self) -> None:
        shutil.rmtree(self.directory / _PENDING, ignore_errors=True)

    def clear_torn(self) -> None:
        """Remove generations that were never finished (for the lock's holder)."""
        keys = [held.key for held in self.objects.list(_BELOW)]
        finished = {k.split("/")[1] for k in keys if k.endswith(f"/{_FACTS}") and k.count("/") == 2}
        self.objects.delete(k for k in keys if k.split("/")[1] not in finished)

    def check_links(self) -> None:
        """Nothing of a user's stands where a delivery goes: it has a prefix of its own."""
