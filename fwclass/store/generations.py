"""What a run delivers, generation by generation: a reader sees all of one, and never half of two.

``<run>/generations/<number>/`` holds ``laz/ parquet/ rasters/ model/``, the reports, ``manifest.json`` with the size
and digest of each of these files, and ``generation.json``, which has the digest of the manifest.
``<run>/current`` is a link to one of them; ``<run>/laz`` and its like are links through `current`, so that all of them
change at one stroke. Files are hard links to the parts of the store: what did not change takes no disk again. See
FORMAT.md.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fwclass import __version__
from fwclass.errors import DamagedError, StoreError
from fwclass.paths import below
from fwclass.store.atomic import bytes_digest, digest_of, file_digest, files_below, read_json, sync, write_text
from fwclass.store.digests import check_file
from fwclass.store.seal import sealed, unsealed
from fwclass.store.url import Url

CURRENT = "current"
MANIFEST = "manifest.json"
_FACTS = "generation.json"
_PENDING = ".pending"

Manifest = Mapping[str, Mapping[str, Any]]
"""``bytes`` and ``digest`` of every file of a generation, by its path there; on object storage also its ``e_tag``."""


Tell = Callable[[str], None]


def _silent(text: str) -> None:
    pass


@dataclass(frozen=True)
class Generation:
    """One delivery: `whole` if the plan had no failures and was not restricted; `digest` of all parts' files, and of
    its `manifest` ("" for one of before there were any)."""

    number: int
    path: Path
    whole: bool
    digest: str
    manifest: str

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def where(self) -> Path | Url:
        """What a user is told."""
        return self.path


@dataclass(frozen=True)
class Generations:
    """The generations of the run directory `root`; only the holder of its lock changes them."""

    root: Path

    @property
    def directory(self) -> Path:
        return self.root / "generations"

    @property
    def pending(self) -> Path:
        """Where the next generation's reports are written before it is published; made when asked for."""
        path = below(self.root, f"{self.directory.name}/{_PENDING}")
        if path.is_symlink():
            path.unlink()
        path.mkdir(parents=True, exist_ok=True)
        return path

    def clear_pending(self) -> None:
        shutil.rmtree(self.directory / _PENDING, ignore_errors=True)

    def all(self) -> list[Generation]:
        """Every generation that is there, the oldest first; a damaged one says nothing."""
        found = []
        for path in self.directory.glob("[0-9]*"):
            with contextlib.suppress(FileNotFoundError, DamagedError):  # collected meanwhile
                found.append(_read(path))
        return sorted(found, key=lambda g: g.number)

    def current(self) -> Generation | None:
        """What readers see, None before anything was delivered."""
        try:
            return _read(self.directory / (self.root / CURRENT).readlink().name)
        except (FileNotFoundError, DamagedError):
            return None

    def shown(self, name: str) -> Path | None:
        """A file that the current generation has at its top, None where it has none, or not the one it should have."""
        current = self.current()
        facts = (self.manifest(current) or {}).get(name) if current is not None else None
        path = self.root / CURRENT / name
        return path if facts is not None and path.is_file() and file_digest(path) == facts["digest"] else None

    def manifest(self, generation: Generation) -> Manifest | None:
        """Facts of every file that the generation should have; None where it has no manifest, or a damaged one."""
        path = generation.path / MANIFEST
        try:
            return _manifest_of(path.read_bytes(), generation)
        except (FileNotFoundError, NotADirectoryError):
            return None

    def damage(self) -> tuple[str, list[str]]:
        """The name of the generation that readers see, and files of it that are gone or not what was written: all are
        read; nothing for one of before there were manifests."""
        try:
            name = (self.root / CURRENT).readlink().name
        except FileNotFoundError:
            return "", []
        generation = self.current()
        if generation is None:
            return name, [_FACTS]
        return name, self._damaged(generation) if generation.manifest else []

    def _damaged(self, generation: Generation, read: bool = True) -> list[str]:
        """Files that are gone, of another size, or, where they are `read`, of other bytes."""
        manifest = self.manifest(generation)
        if manifest is None:
            return [MANIFEST]
        return [name for name, facts in manifest.items() if not _is(generation.path / name, facts, read)]

    def publish(
        self, files: Mapping[str, tuple[Path, str]], whole: bool, keep: int, read: bool = False, tell: Tell = _silent
    ) -> Generation:
        """Make a generation of `pending` and of `files` (path below the generation: file of the store and its digest).

        It becomes the current one if it is `whole`, or if no whole one is there. Of the whole ones the last `keep`
        stay; others go as soon as a later one is made. The current one is returned as it is where it holds just this:
        every file that it should have is there with its size and, where they are `read`, its bytes. `tell` is told
        what is not.

        Raises
        ------
        DamagedError
            A file that the current generation does not have is not what was written.
        """
        self.check_links()
        digest = digest_of({name: of for name, (_, of) in files.items()})
        before = self.current()
        if before is not None and before.whole == whole and before.digest == digest:
            broken = self._damaged(before, read)
            tell_broken(before, broken, tell)
            if not broken and self._reports_stand(before):
                self.clear_pending()
                self._show(before)  # the run that made it may have ended before it was
                self._collect(keep)
                return before
        number = 1 + max((int(p.name) for p in self.directory.glob("[0-9]*") if p.name.isdigit()), default=0)
        made = self._write(number, files, whole, digest)
        if whole or before is None or not before.whole:
            self._show(made)
        self._collect(keep)
        return made

    def _reports_stand(self, generation: Generation) -> bool:
        """The reports that wait are those that the generation has."""
        manifest, own = self.manifest(generation) or {}, self.pending
        waiting = {p.relative_to(own).as_posix(): p for p in files_below(own)}
        return all(n in manifest and file_digest(p) == manifest[n]["digest"] for n, p in waiting.items())

    def _write(self, number: int, files: Mapping[str, tuple[Path, str]], whole: bool, digest: str) -> Generation:
        own, before = self.pending, self.current()
        manifest = {p.relative_to(own).as_posix(): _facts_of(p, file_digest(p)) for p in files_below(own)}
        made: set[Path] = {own}
        for name, (source, of) in sorted(files.items()):
            target = below(own, name)
            if target.parent not in made:
                target.parent.mkdir(parents=True, exist_ok=True)
                made.update(d for d in target.parents if own in d.parents)
            if before is None or not _same_file(source, before.path / name):
                check_file(str(source), of)
            link(source, target)
            manifest[name] = _facts_of(target, of)
        text = _text({"files": manifest})
        write_text(own / MANIFEST, text)
        write_text(own / _FACTS, _text(facts_of(number, whole, digest, text, len(files))))
        for directory in made:
            sync(directory)
        target = self.directory / f"{number:04d}"
        own.rename(target)
        sync(self.directory)
        sync(self.root)  # before a link leads there
        return _read(target)

    def _show(self, generation: Generation) -> None:
        """Make `generation` the current one: one rename; then links for what is new in it, none for what is gone."""
        _point(self.root / CURRENT, Path(self.directory.name) / generation.name)
        entries = {p.name for p in generation.path.iterdir() if p.name not in (_FACTS, MANIFEST)}
        for name in sorted(entries):
            if not (self.root / name).is_symlink():
                _point(self.root / name, Path(CURRENT) / name)
        for path in self.root.iterdir():
            if path.is_symlink() and path.name not in entries and path.readlink().parent == Path(CURRENT):
                path.unlink(missing_ok=True)
        sync(self.root)

    def _collect(self, keep: int) -> None:
        """Remove earlier generations, and what is left of some that were never finished, or not removed to the end."""
        current = self.current()
        there = self.all()
        stay = {g.name for g in [g for g in there if g.whole][-max(1, keep) :] + there[-1:]}
        for path in self.directory.glob("[0-9]*"):
            if path.name not in stay and (current is None or path.name != current.name):
                shutil.rmtree(path, ignore_errors=True)

    def check_links(self) -> None:
        """`StoreError` where something else stands in a place that a delivery needs."""
        for name in (
            CURRENT,
            "laz",
            "parquet",
            "rasters",
            "model",
            "survey.qgz",
            "tiles.gpkg",
            "report.html",
            "report.json",
        ):
            path = self.root / name
            if path.exists() and not path.is_symlink():
                raise StoreError(
                    "something of the user's stands where a delivery is to appear",
                    where=path,
                    expected=f"nothing, or a link into {self.directory}",
                    got="a file or directory",
                    do="move it away, or choose another --out",
                )


def link(source: Path, target: Path) -> None:
    """Give a finished file a second name; a copy where the file system has no hard links (or no more of them)."""
    try:
        os.link(source, target)
    except FileNotFoundError as fault:
        raise StoreError(
            "a part's file is gone", where=source, got=fault, do="run again; the missing parts are made"
        ) from fault
    except OSError:
        shutil.copy2(source, target)
        sync(target)


def _point(path: Path, target: Path) -> None:
    """Make `path` a link to `target`, in place of the link that it was."""
    beside = path.with_name(f".{path.name}.link")
    beside.unlink(missing_ok=True)
    if path.is_symlink() and path.readlink() == target:
        return
    beside.symlink_to(target)
    beside.replace(path)


def tell_broken(generation: Generation, broken: Sequence[str], tell: Tell) -> None:
    """Say that files of a generation are not what was delivered, for who makes another in its place."""
    if broken and generation.manifest:
        some = ", ".join(broken[:3]) + (f" and {len(broken) - 3} more" if len(broken) > 3 else "")
        tell(f"delivery         {generation.name} is not what was delivered: {some}; another is made in its place")


def facts_of(number: int, whole: bool, digest: str, manifest: str, files: int) -> dict[str, Any]:
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
    return sealed(facts)


def generation_of(facts: Any, path: Path, where: object) -> Generation:
    """The generation that its own file tells of; `DamagedError` where it tells none, or was changed since."""
    try:
        plain = unsealed(facts)
        manifest = str(plain.get("manifest", ""))
        return Generation(int(plain["number"]), path, bool(plain["whole"]), str(plain["digest"]), manifest)
    except (KeyError, TypeError, ValueError) as fault:
        raise DamagedError(
            "not the facts of a generation", where=where, got=fault, do="run again: a generation is made that is whole"
        ) from fault


def _read(path: Path) -> Generation:
    return generation_of(read_json(path / _FACTS), path, path / _FACTS)


def _manifest_of(data: bytes, generation: Generation) -> Manifest | None:
    """A manifest's files; None where it is not the one that the generation names."""
    return dict(json.loads(data)["files"]) if bytes_digest(data) == generation.manifest else None


def _text(value: Any) -> str:
    return json.dumps(value, sort_keys=True, indent=1, allow_nan=False) + "\n"


def _facts_of(path: Path, digest: str) -> dict[str, Any]:
    return {"bytes": path.stat().st_size, "digest": digest}


def _is(path: Path, facts: Mapping[str, Any], read: bool) -> bool:
    """The file is there with its size and, where it is `read`, its bytes."""
    try:
        if path.stat().st_size != facts["bytes"] or not path.is_file():
            return False
        return not read or file_digest(path) == facts["digest"]
    except OSError:
        return False


def _same_file(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except OSError:
        return False
