"""What a run delivers, generation by generation: a reader sees all of one, and never half of two.

``<run>/generations/<number>/`` holds ``laz/ parquet/ rasters/ model/``, the reports and ``generation.json``.
``<run>/current`` is a link to one of them; ``<run>/laz`` and its like are links through `current`, so that all of them
change at one stroke. Files are hard links to the parts of the store: what did not change takes no disk again. See
FORMAT.md.
"""

from __future__ import annotations

import contextlib
import filecmp
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fwclass import __version__
from fwclass.errors import DamagedError, StoreError
from fwclass.paths import below
from fwclass.store.atomic import digest_of, files_below, read_json, sync, write_json
from fwclass.store.url import Url

CURRENT = "current"
_FACTS = "generation.json"
_PENDING = ".pending"


@dataclass(frozen=True)
class Generation:
    """One delivery: `whole` if the plan had no failures and was not restricted; `digest` of all parts' files."""

    number: int
    path: Path
    whole: bool
    digest: str

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
        """A file that the current generation has at its top, None where it has none."""
        path = self.root / CURRENT / name
        return path if path.exists() else None

    def publish(self, files: Mapping[str, tuple[Path, str]], whole: bool, keep: int) -> Generation:
        """Make a generation of `pending` and of `files` (path below the generation: file of the store and its digest).

        It becomes the current one if it is `whole`, or if no whole one is there. Of the whole ones the last `keep`
        stay; others go as soon as a later one is made. The current one is returned as it is where it holds just this.
        """
        self.check_links()
        digest = digest_of({name: of for name, (_, of) in files.items()})
        before = self.current()
        if before is not None and before.whole == whole and before.digest == digest and self._stands(before, files):
            self.clear_pending()
            return before
        number = 1 + max((int(p.name) for p in self.directory.glob("[0-9]*") if p.name.isdigit()), default=0)
        made = self._write(number, files, whole, digest)
        if whole or before is None or not before.whole:
            self._show(made)
        self._collect(keep)
        return made

    def _stands(self, generation: Generation, files: Mapping[str, tuple[Path, str]]) -> bool:
        """Nobody took a file of the generation away, and the reports that wait are those that it has."""
        own = self.pending
        reports = ((p, generation.path / p.relative_to(own)) for p in files_below(own))
        parts = ((source, generation.path / name) for name, (source, _) in files.items())
        return all(there.is_file() and filecmp.cmp(p, there, shallow=False) for p, there in reports) and all(
            there.is_file() and there.stat().st_size == source.stat().st_size for source, there in parts
        )

    def _write(self, number: int, files: Mapping[str, tuple[Path, str]], whole: bool, digest: str) -> Generation:
        own = self.pending
        made: set[Path] = {own}
        for name, (source, _) in sorted(files.items()):
            target = below(own, name)
            if target.parent not in made:
                target.parent.mkdir(parents=True, exist_ok=True)
                made.add(target.parent)
            link(source, target)
        facts = {
            "number": number, "made": datetime.now(UTC).isoformat(timespec="seconds"), "whole": whole,
            "digest": digest, "files": len(files), "fwclass": __version__,
        }  # fmt: skip
        write_json(own / _FACTS, facts)
        for directory in made:
            sync(directory)
        target = self.directory / f"{number:04d}"
        own.rename(target)
        sync(self.directory)
        return _read(target)

    def _show(self, generation: Generation) -> None:
        """Make `generation` the current one: one rename; then links for what is new in it, none for what is gone."""
        _point(self.root / CURRENT, Path(self.directory.name) / generation.name)
        entries = {p.name for p in generation.path.iterdir() if p.name != _FACTS}
        for name in sorted(entries):
            if not (self.root / name).is_symlink():
                _point(self.root / name, Path(CURRENT) / name)
        for path in self.root.iterdir():
            if path.is_symlink() and path.name not in entries and path.readlink().parent == Path(CURRENT):
                path.unlink(missing_ok=True)
        sync(self.root)

    def _collect(self, keep: int) -> None:
        current = self.current()
        there = self.all()
        wholes = [g.number for g in there if g.whole][-max(1, keep) :]
        for generation in there[:-1]:
            shown = current is not None and generation.number == current.number
            if generation.number not in wholes and not shown:
                shutil.rmtree(generation.path, ignore_errors=True)

    def check_links(self) -> None:
        """`StoreError` where something else stands in a place that a delivery needs."""
        for name in (CURRENT, "laz", "parquet", "rasters", "model", "report.html", "report.json"):
            path = self.root / name
            if path.exists() and not path.is_symlink():
                raise StoreError(
                    "something of the user's stands where a delivery is to appear", where=path,
                    expected=f"nothing, or a link into {self.directory}", got="a file or directory",
                    do="move it away, or choose another --out",
                )  # fmt: skip


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
    beside.symlink_to(target)
    beside.replace(path)


def _read(path: Path) -> Generation:
    facts: dict[str, Any] = read_json(path / _FACTS)
    try:
        return Generation(int(facts["number"]), path, bool(facts["whole"]), str(facts["digest"]))
    except (KeyError, TypeError, ValueError) as fault:
        raise DamagedError(
            "not the facts of a generation", where=path / _FACTS, got=fault, do=f"remove the directory {path}"
        ) from fault
