"""Generations of a run on object storage: copies made by the server, and an object that says which is current."""

from __future__ import annotations

import json
import re
import shutil
import uuid
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fwclass.errors import DamagedError, StoreError
from fwclass.store.atomic import bytes_digest, digest_of, file_digest, files_below
from fwclass.store.generations import (
    _FACTS,
    _PENDING,
    MANIFEST,
    Generation,
    Generations,
    Manifest,
    Tell,
    _manifest_of,
    _silent,
    _text,
    facts_of,
    generation_of,
    tell_broken,
)
from fwclass.store.objects import MOST_COPIED, Held, Mark, Objects, Wanted
from fwclass.store.scratch import Scratch
from fwclass.store.url import Url

CURRENT = "current.json"
_BELOW = "generations"
_NAME = re.compile(r"(\d+)(-[0-9a-f]+)?", re.ASCII)
"""Number, and what no other writer's generation of that number has in its name."""


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
        return self._all(list(self._listed()))

    def _listed(self) -> dict[str, Held]:
        """Every object of every generation by key."""
        return {held.key: held for held in self.objects.list(_BELOW)}

    def _all(self, keys: Iterable[str]) -> list[Generation]:
        """The generations that are whole; a damaged one says nothing."""
        finished = sorted(k for k in keys if k.endswith(f"/{_FACTS}") and k.count("/") == 2)
        found = []
        for key, data in zip(finished, self.objects.many(finished), strict=True):
            with suppress(DamagedError):
                found += [self._read(key.split("/")[1], data[0])] if data else []
        return sorted(found, key=lambda g: (g.number, g.name))

    def _read(self, name: str, data: bytes) -> Generation:
        where = self.address / _BELOW / name
        try:
            facts = json.loads(data)
        except (ValueError, RecursionError):
            facts = None
        plain = generation_of(facts, self.directory / name, where / _FACTS)
        return RemoteGeneration(plain.number, plain.path, plain.whole, plain.digest, plain.manifest, where)

    def _pointer(self) -> tuple[str, Mark] | None:
        """Name of the generation that readers see, "" where the pointer is damaged; None for no pointer."""
        found = self.objects.get(CURRENT)
        if found is None:
            return None
        try:
            name = str(json.loads(found[0])["generation"])
        except (ValueError, TypeError, KeyError, RecursionError):
            name = ""
        return name, found[1]

    def current(self) -> Generation | None:
        pointer = self._pointer()
        return self._named(pointer[0]) if pointer else None

    def _named(self, name: str) -> Generation | None:
        facts = self.objects.get(f"{_BELOW}/{name}/{_FACTS}") if _NAME.fullmatch(name) else None
        try:
            return self._read(name, facts[0]) if facts else None
        except DamagedError:
            return None

    def shown(self, name: str) -> Path | None:
        """A copy of a file that the current generation has at its top, None where it has none, or not the one it
        should have."""
        current = self.current()
        facts = (self.manifest(current) or {}).get(name) if current is not None else None
        found = self.objects.get(f"{_BELOW}/{current.name}/{name}") if current is not None and facts else None
        if found is None or facts is None or bytes_digest(found[0]) != facts["digest"]:
            return None
        unit = f"shown/{facts['digest']}"
        path = self.root / unit / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(found[0])
        self.scratch.adopt(f"{self.root.name}/{unit}", len(found[0]))
        return path

    def manifest(self, generation: Generation) -> Manifest | None:
        found = self.objects.get(f"{_BELOW}/{generation.name}/{MANIFEST}")
        return _manifest_of(found[0], generation) if found else None

    def damage(self) -> tuple[str, list[str]]:
        pointer = self._pointer()
        if pointer is None:
            return "", []
        generation = self._named(pointer[0])
        if generation is None:
            return pointer[0], [_FACTS]
        return pointer[0], self._broken(generation, self._listed(), True) if generation.manifest else []

    def _broken(self, generation: Generation, listed: Mapping[str, Held], read: bool) -> list[str]:
        """Files that are gone, of another size, or of other bytes; not `read` are those that nobody wrote over."""
        manifest, found = self.manifest(generation), []
        if manifest is None:
            return [MANIFEST]
        with TemporaryDirectory(dir=self._here()) as scratch:
            for name, facts in manifest.items():
                held = listed.get(f"{_BELOW}/{generation.name}/{name}")
                there = held is not None and held.size == facts["bytes"]
                if held is not None and there and (read or held.mark.e_tag != facts["e_tag"]):
                    there = self._reads(held, facts, Path(scratch) / "object")
                if not there:
                    found.append(name)
        return found

    def _reads(self, held: Held, facts: Mapping[str, Any], target: Path) -> bool:
        """The object has its bytes; also where it was copied, and has another mark."""
        try:
            self.objects.fetch([Wanted(held.key, held.size, target)])
            return file_digest(target) == facts["digest"]
        except FileNotFoundError:
            return False
        finally:
            target.unlink(missing_ok=True)

    def _here(self) -> Path:
        self.root.mkdir(parents=True, exist_ok=True)
        return self.root

    def publish(
        self, files: Mapping[str, tuple[Path, str]], whole: bool, keep: int, read: bool = False, tell: Tell = _silent
    ) -> Generation:
        digest = digest_of({name: of for name, (_, of) in files.items()})
        pointer, listed = self._pointer(), self._listed()
        before, there = self._named(pointer[0]) if pointer else None, self._all(listed)
        if before is not None and pointer and before.whole == whole and before.digest == digest:
            broken = self._broken(before, listed, read)
            tell_broken(before, broken, tell)
            if not broken and self._reports_stand(before):
                self.clear_pending()
                self._drop(listed, there, keep, before, pointer[1])
                return before
        number = 1 + max((int(m[1]) for key in listed if (m := _NAME.fullmatch(key.split("/")[1]))), default=0)
        made = self._put(f"{number:04d}-{uuid.uuid4().hex[:8]}", files, whole, digest)
        if whole or before is None or not before.whole:
            self._point(made, pointer[1] if pointer else None)
            self._drop(listed, [*there, made], keep, made, None)
        elif pointer:
            self._drop(listed, [*there, made], keep, before, pointer[1])
        return made

    def _point(self, generation: Generation, mark: Mark | None) -> Mark:
        """Lead readers to `generation`; `LostRace` where the pointer is not the one any more that was read.

        No two pointers are the same bytes, so that none is taken for an earlier one.
        """
        told = {
            "generation": generation.name,
            "address": f"{_BELOW}/{generation.name}",
            "digest": generation.digest,
            "whole": generation.whole,
            "written": uuid.uuid4().hex,
        }
        data = _text(told).encode()
        return self.objects.put_new(CURRENT, data) if mark is None else self.objects.put_over(CURRENT, data, mark)

    def _drop(
        self, listed: Iterable[str], there: list[Generation], keep: int, shown: Generation, mark: Mark | None
    ) -> None:
        """Remove generations beyond the last `keep` whole ones, and what was never finished.

        One may be another writer's, who slept and will go on. So the pointer is written anew before (over `mark`; None:
        it just was): who read the earlier one cannot lead readers there any more.
        """
        stay = {g.name for g in [g for g in there if g.whole][-max(1, keep) :] + there[-1:]} | {shown.name}
        gone = [key for key in listed if key.split("/")[1] not in stay]
        if gone and mark is not None:
            self._point(shown, mark)
        self.objects.delete(key for key in gone if key.endswith(f"/{_FACTS}"))
        self.objects.delete(key for key in gone if not key.endswith(f"/{_FACTS}"))

    def _put(self, name: str, files: Mapping[str, tuple[Path, str]], whole: bool, digest: str) -> Generation:
        own, below = self.pending, f"{_BELOW}/{name}"
        sizes = {held.key: held.size for held in self.objects.list("store")}
        self._copy(sizes, {f"{below}/{to}": files[to] for to in sorted(files)})
        reports = {p.relative_to(own).as_posix(): p for p in files_below(own)}
        self.objects.put_files({f"{below}/{to}": p for to, p in reports.items()})
        digests = {to: of for to, (_, of) in files.items()} | {to: file_digest(p) for to, p in reports.items()}
        held = {h.key[len(below) + 1 :]: h for h in self.objects.list(below)}
        lacking = sorted(digests.keys() - held.keys())
        if lacking:
            raise StoreError("what was just delivered is gone", where=self.address / below / lacking[0], do="run again")
        manifest = {
            to: {"bytes": held[to].size, "digest": of, "e_tag": held[to].mark.e_tag} for to, of in digests.items()
        }
        text = _text({"files": manifest})
        self.objects.put_new(f"{below}/{MANIFEST}", text.encode())
        data = _text(facts_of(int(name.partition("-")[0]), whole, digest, text, len(files))).encode()
        self.objects.put_new(f"{below}/{_FACTS}", data)
        self.clear_pending()
        return self._read(name, data)

    def _copy(self, sizes: Mapping[str, int], files: Mapping[str, tuple[Path, str]]) -> None:
        """Copy parts' files, named by their copies on this host with their digests, to keys; the server does it, but
        for large ones."""
        pairs = [(source.relative_to(self.root).as_posix(), target) for target, (source, _) in files.items()]
        gone = [key for key, _ in pairs if key not in sizes]
        if gone:
            raise StoreError(
                "a part's file is gone", where=self.address / gone[0], do="run again; the missing parts are made"
            )
        self.objects.all(lambda pair: self.objects.copy(*pair), [p for p in pairs if sizes[p[0]] <= MOST_COPIED])
        for key, target in pairs:
            if sizes[key] > MOST_COPIED:
                unit, _, name = key.rpartition("/")
                path, of = files[target]
                wanted = {name: Wanted(key, sizes[key], path)}
                self.scratch.need(self.objects, f"{self.root.name}/{unit}", wanted, {name: of})
                self.objects.put_files({target: path})

    def clear_pending(self) -> None:
        shutil.rmtree(self.directory / _PENDING, ignore_errors=True)

    def check_links(self) -> None:
        """Nothing of a user's stands where a delivery goes: it has a prefix of its own."""
