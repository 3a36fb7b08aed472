"""What a run delivers, generation by generation: a reader sees all of one, and never half of two.

``<run>/generations/<number>/`` holds ``laz/ parquet/ rasters/ model/``, the reports, ``manifest.json`` with the size
and digest of each of these files, and ``generation.json``, which has the digest of the manifest.
``<run>/current`` is a link to one of them; ``<run>/laz`` and its like are links through `current`, so that all of them
change at one stroke. Files are hard links to the parts of the store: what did not change takes no disk again. On object
storage they are copies made by the server, and ``current.json`` says which generation is seen. See FORMAT.md.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fwclass import __version__
from fwclass.errors import DamagedError, StoreError, first_few
from fwclass.paths import below, relative_fault
from fwclass.store.atomic import bytes_digest, digest_of, file_digest, files_below, remove_directory, to_json
from fwclass.store.bucket import Files
from fwclass.store.directory import FACTS, GENERATIONS, MANIFEST, Facts
from fwclass.store.objects import Mark
from fwclass.store.refusals import Unreachable
from fwclass.store.seal import seal, unseal
from fwclass.store.url import Url

_PENDING = ".pending"
_NAME = re.compile(r"(\d+)(-[0-9a-f]+)?", re.ASCII)
"""Number, and on object storage what no other writer's generation of that number has in its name."""

Manifest = Mapping[str, Facts]
"""Facts of every file of a generation, by its path there."""

Tell = Callable[[str], None]


def _silent(text: str) -> None:
    pass


@dataclass(frozen=True)
class Generation:
    """One delivery: `whole` if the plan had no failures and was not restricted; `digest` of all parts' files, and of
    its `manifest` ("" for one of before there were any); `path` on this host, and `where` for a user."""

    number: int
    path: Path
    whole: bool
    digest: str
    manifest: str
    where: Path | Url

    @property
    def name(self) -> str:
        """Its directory's name."""
        return self.path.name

    @property
    def key(self) -> str:
        """Its key in the store."""
        return f"{GENERATIONS}/{self.name}"


@dataclass(frozen=True)
class Generations:
    """The generations of a run; only the holder of its lock changes them."""

    files: Files

    @property
    def directory(self) -> Path:
        """Where generations lie on this host."""
        return self.files.root / GENERATIONS

    @property
    def pending(self) -> Path:
        """Where the next generation's reports are written before it is published; made when asked for."""
        path = below(self.files.root, f"{GENERATIONS}/{_PENDING}")
        if path.is_symlink():
            path.unlink()
        path.mkdir(parents=True, exist_ok=True)
        return path

    def clear_pending(self) -> None:
        """Remove reports that were never delivered."""
        remove_directory(self.directory / _PENDING)

    def check_links(self) -> None:
        """`StoreError` where something else stands in a place that a delivery needs."""
        self.files.check_links()

    def all(self) -> list[Generation]:
        """Every generation that is there, the oldest first; a damaged one says nothing."""
        return self._all(self._names())

    def _names(self) -> list[str]:
        return [name for name in self.files.names(GENERATIONS) if name[0].isdigit()]

    def _all(self, names: Sequence[str]) -> list[Generation]:
        generations = map(self._parsed, names, self.files.many([f"{GENERATIONS}/{n}/{FACTS}" for n in names]))
        return sorted((g for g in generations if g is not None), key=lambda g: (g.number, g.name))

    def _parsed(self, name: str, data: tuple[bytes, Mark] | None) -> Generation | None:
        """A generation as its own file tells of it; None where there is none, or a damaged one."""
        try:
            where = self.files.where / GENERATIONS / name
            return _generation_of(data[0], self.directory / name, where) if data else None
        except DamagedError:
            return None

    def _named(self, name: str) -> Generation | None:
        return self._parsed(name, self.files.get(f"{GENERATIONS}/{name}/{FACTS}")) if _NAME.fullmatch(name) else None

    def current(self) -> Generation | None:
        """What readers see, None before anything was delivered."""
        pointer = self.files.pointer()
        return self._named(pointer[0]) if pointer else None

    def shown(self, name: str) -> Path | None:
        """A file that the current generation has at its top, on this host; None where it has none, or not the one it
        should have."""
        current = self.current()
        facts = (self.manifest(current) or {}).get(name) if current is not None else None
        if current is None or facts is None:
            return None
        try:
            self.files.fetch(current.key, {name: facts})
        except StoreError as fault:
            if isinstance(fault, Unreachable):
                raise
            return None
        return self.files.root / current.key / name

    def manifest(self, generation: Generation) -> Manifest | None:
        """Facts of every file that the generation should have; None where it has no manifest, or a damaged one."""
        data = self.files.get(f"{generation.key}/{MANIFEST}")
        if data is None or bytes_digest(data[0]) != generation.manifest:
            return None
        try:
            return manifest_files(data[0])
        except ValueError:
            return None

    def lacking(self, generation: Generation, listed: Manifest) -> list[str]:
        """Files of a manifest that are gone, or have another size; none is read."""
        sizes = self.files.sizes(generation.key, listed)
        return [name for name, facts in listed.items() if sizes.get(name) != facts["bytes"]]

    def lacks(self, generation: Generation) -> list[str]:
        """As `lacking`, of its own manifest, which is named alone where it is damaged; nothing of one without any."""
        listed = self.manifest(generation)
        if listed is None:
            return [MANIFEST] if generation.manifest else []
        return self.lacking(generation, listed)

    def damage(self) -> dict[str, list[str]]:
        """Files of each generation that are gone or not what was written, by its name, where there are any: the one
        that readers see first. All are read, but for those of before there were manifests."""
        pointer = self.files.pointer()
        shown = [pointer[0]] if pointer and pointer[0] else []
        others = [name for name in self._names() if name not in shown]
        facts = self.files.many([f"{GENERATIONS}/{name}/{FACTS}" for name in others])
        there = {n: self._parsed(n, data) for n, data in zip(others, facts, strict=True) if data is not None}
        there = {name: self._named(name) for name in shown} | there
        damaged = {name: [FACTS] for name, generation in there.items() if generation is None}
        damaged |= self._damaged_of([g for g in there.values() if g is not None and g.manifest])
        return {name: damaged[name] for name in there if damaged.get(name)}

    def _damaged(self, generation: Generation, trusted: Collection[str]) -> list[str]:
        """Files that are gone, of another size, or of other bytes; those that are `trusted` are read only where they
        were written over."""
        return self._damaged_of([generation], trusted)[generation.name]

    def _damaged_of(self, generations: Sequence[Generation], trusted: Collection[str] = ()) -> dict[str, list[str]]:
        """As `_damaged`, of each by its name; what several share is read once."""
        manifests = {g.name: self.manifest(g) for g in generations}
        sound: dict[str, set[str]] = {}
        doubted: dict[str, int] = {}
        for generation in generations:
            key, manifest = generation.key, manifests[generation.name] or {}
            there = {h.key: h for h in self.files.list(key)}
            same = {n for n, facts in manifest.items() if (h := there.get(f"{key}/{n}")) and h.size == facts["bytes"]}
            kept = {n for n in same if n in trusted and there[f"{key}/{n}"].mark.e_tag == manifest[n].get("e_tag")}
            sound[generation.name] = same
            doubted |= {f"{key}/{n}": there[f"{key}/{n}"].size for n in sorted(same - kept)}
        digests = self.files.digests(doubted)

        def broken(key: str, name: str, facts: Mapping[str, Any], same: set[str]) -> bool:
            path = f"{key}/{name}"
            return name not in same or (path in doubted and digests.get(path) != facts["digest"])

        damaged = {}
        for generation in generations:
            listed, same = manifests[generation.name], sound[generation.name]
            damaged[generation.name] = (
                [MANIFEST]
                if listed is None
                else [n for n, facts in listed.items() if broken(generation.key, n, facts, same)]
            )
        return damaged

    def publish(
        self, files: Mapping[str, tuple[Path, str]], whole: bool, keep: int, read: bool = False, tell: Tell = _silent
    ) -> Generation:
        """Make a generation of `pending` and of `files` (path below the generation: file of the store and its digest).

        It becomes the current one if it is `whole`, or if no whole one is there. Of the whole ones the last `keep`
        stay, and of earlier ones the last that has what these have not; others go as soon as a later one is made.

        The current one is returned as it is where it holds just this: every file that it should have is there with its
        size, and reports (where all are `read`, all files) with their bytes. `tell` is told what is not, and the new
        one takes its place: it goes.

        `DamagedError`: a file that the current generation does not have is not what was written.
        """
        self.check_links()
        digest = digest_of({name: of for name, (_, of) in files.items()})
        pointer, names = self.files.pointer(), self._names()
        before, there, broken = self._named(pointer[0]) if pointer else None, self._all(names), list[str]()
        if before is not None and pointer and before.whole == whole and before.digest == digest:
            marked = self.manifest(before) or {} if self.files.far else files  # on a disk, reports are nobody else's
            broken = self._damaged(before, () if read else marked)
            _tell_broken(before, broken, tell)
            if not broken and self._reports_stand(before):
                self.clear_pending()
                if not self.files.far:  # the run that made it may have ended before all links were there
                    self._point(before, pointer[1])
                self._retire(names, there, keep, before, pointer[1])
                return before
        number = 1 + max((int(m[1]) for name in names if (m := _NAME.fullmatch(name))), default=0)
        latest = self._write(number, files, whole, digest, before)
        if before is None or whole or not before.whole:
            self._point(latest, pointer[1] if pointer else None)
            alone = sorted(self._products(before) - self._products(latest)) if before is not None else []
            if before is not None and alone:
                tell(f"delivery         has no {', '.join(alone)}: those of {before.name} stay in {before.where}")
            sound = [g for g in there if not broken or before is None or g.name != before.name]
            self._retire(names, [*sound, latest], keep, latest, None)
        elif pointer:
            self._retire(names, [*there, latest], keep, before, pointer[1])
        return latest

    def retire_earlier(self) -> list[str]:
        """Remove all generations but the current one, a later one that is not whole, and the last of `unique`; names of
        those that went."""
        pointer, names = self.files.pointer(), self._names()
        shown = self._named(pointer[0]) if pointer else None
        if pointer and shown is not None:
            self._retire(names, self._all(names), 1, shown, pointer[1])
        return sorted(set(names) - set(self._names()))

    def unique(self) -> dict[str, list[str]]:
        """Earlier whole generations, the last first, with the directories that neither the current one nor one between
        has: what another workflow delivered."""
        shown = self.current()
        whole = [g for g in self.all() if g.whole]
        return self._unique(whole, [shown] if shown is not None else [])

    def _unique(self, whole: Sequence[Generation], kept: Sequence[Generation]) -> dict[str, list[str]]:
        have = set[str]().union(*map(self._products, kept))
        unique = {}
        for generation in reversed([g for g in whole if g not in kept]):
            more = self._products(generation) - have
            have |= more
            if more:
                unique[generation.name] = sorted(more)
        return unique

    def _products(self, generation: Generation) -> set[str]:
        """Directories of a generation: ``laz``, ``parquet``, ``rasters``, ``model`` and so on."""
        return {name.partition("/")[0] for name in self.manifest(generation) or {} if "/" in name}

    def _reports_stand(self, generation: Generation) -> bool:
        """The reports that wait are those that the generation has."""
        manifest, own = self.manifest(generation) or {}, self.pending
        waiting = {p.relative_to(own).as_posix(): p for p in files_below(own)}
        return all(n in manifest and file_digest(p) == manifest[n]["digest"] for n, p in waiting.items())

    def _write(
        self, number: int, files: Mapping[str, tuple[Path, str]], whole: bool, digest: str, before: Generation | None
    ) -> Generation:
        def sealing(manifest: Manifest) -> tuple[str, str]:
            text = to_json({"files": manifest})
            return text, to_json(_facts_of(number, whole, digest, text, len(files)))

        name = self.files.deliver(self.pending, number, files, before.name if before else "", sealing)
        self.clear_pending()
        generation = self._named(name)
        if generation is None:
            raise StoreError("what was just delivered is gone", where=self.directory / name, do="run again")
        return generation

    def _point(self, generation: Generation, mark: Mark | None) -> None:
        """Make `generation` the current one; `LostRace` where the pointer is not the one any more that `mark` marks."""
        self.files.point(generation.name, {"digest": generation.digest, "whole": generation.whole}, mark)

    def _retire(
        self, names: Sequence[str], there: Sequence[Generation], keep: int, shown: Generation, mark: Mark | None
    ) -> None:
        """Remove generations beyond the last `keep` whole ones and the `unique`, and what was never finished, or not
        removed to the end.

        On object storage one may be another writer's, who slept and will go on. So the pointer is written anew before
        (over `mark`; None: it just was): who read the earlier one cannot lead readers there any more.
        """
        whole = [g for g in there if g.whole]
        kept = [*whole[-max(1, keep) :], *there[-1:], shown]
        stay = {g.name for g in kept}
        if set(names) - stay:
            stay |= self._unique(whole, kept).keys()
        gone = [name for name in names if name not in stay]
        if gone and mark is not None and self.files.far:
            self._point(shown, mark)
        self.files.retire(gone)


def _tell_broken(generation: Generation, broken: Sequence[str], tell: Tell) -> None:
    """Say that files of a generation are not what was delivered, for who makes another in its place."""
    if broken and generation.manifest:
        some = first_few(broken, 3)
        tell(f"delivery         {generation.name} is not what was delivered: {some}; another is made in its place")


def _facts_of(number: int, whole: bool, digest: str, manifest: str, files: int) -> dict[str, Any]:
    """What a generation's own file says, with a digest of itself; `manifest`: the text of that."""
    facts = {
        "number": number,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "whole": whole,
        "digest": digest,
        "files": files,
        "fwclass": __version__,
        "manifest": bytes_digest(manifest.encode()),
    }
    return seal(facts)


def manifest_files(data: bytes) -> Manifest:
    """Facts of the files of a manifest, by their paths; `ValueError` where no writer of manifests wrote it."""
    try:
        files = json.loads(data)["files"]
        listed = {n: {**f, "bytes": int(f["bytes"]), "digest": str(f["digest"])} for n, f in files.items()}
    except (LookupError, TypeError, AttributeError, ArithmeticError, RecursionError) as fault:
        raise ValueError(f"{type(fault).__name__}: {fault}"[:200]) from fault
    for name in listed:
        if relative_fault(name):
            raise ValueError(f"{name[:80]!r}: {relative_fault(name)}")
    return listed


def _generation_of(data: bytes, path: Path, where: Path | Url) -> Generation:
    """The generation that its own file tells of; `DamagedError` where it tells none, or was changed since."""
    try:
        plain = unseal(json.loads(data))
        manifest = str(plain.get("manifest", ""))
        return Generation(int(plain["number"]), path, bool(plain["whole"]), str(plain["digest"]), manifest, where)
    except (KeyError, TypeError, ValueError, ArithmeticError, RecursionError) as fault:
        raise DamagedError(
            "not the facts of a generation",
            where=where / FACTS,
            got=fault,
            do="run again: a generation is made that is whole",
        ) from fault


def is_generation(directory: Path | Url) -> bool:
    """A directory of this host that a delivery was written or copied to."""
    return isinstance(directory, Path) and (directory / FACTS).is_file() and not (directory / "store").is_dir()


def copy_damage(directory: Path) -> list[str]:
    """Files of a generation that somebody copied to `directory` which are gone there or not what was delivered; all are
    read. Files beside them are not looked at.

    `DamagedError`: what tells of the generation is damaged itself.
    """
    generation = _generation_of((directory / FACTS).read_bytes(), directory, directory)
    listed = (directory / MANIFEST).read_bytes() if (directory / MANIFEST).is_file() else b""
    if bytes_digest(listed) != generation.manifest:
        return [MANIFEST]
    files = {name: (directory / name, facts) for name, facts in manifest_files(listed).items()}
    return [
        name
        for name, (path, facts) in files.items()
        if not path.is_file() or path.stat().st_size != facts["bytes"] or file_digest(path) != facts["digest"]
    ]
