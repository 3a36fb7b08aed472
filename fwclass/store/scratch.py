"""Copies of objects on this host's disk: fetched once, checked, the longest unread ones removed first.

What one process keeps is its own: processes of one host take different directories, so none removes what another reads.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import threading
import uuid
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from fwclass.errors import StoreError
from fwclass.isolation import cache_home
from fwclass.store.atomic import digest_of, file_digest, files_below, remove_directory
from fwclass.store.digests import MEND, digest_now, remember
from fwclass.store.objects import Download, Objects
from fwclass.store.params import StoreParams
from fwclass.units import GIB

KEPT = 64
"""Directories that were handed out last: somebody may be about to open them."""
TRIES = 3
"""Times that an object is fetched whose bytes are not what they should be."""

_default: list[Path] = []
_open: dict[Path, Scratch] = {}
_guard = threading.Lock()


def worker_directory(path: Path) -> None:
    """Where this process, a worker, keeps its copies unless it is told otherwise."""
    _default[:] = [path]


def scratch_directory(params: StoreParams) -> Path:
    """Where this process keeps its copies."""
    chosen = os.environ.get("FWCLASS_SCRATCH") or params.scratch
    if chosen:
        return Path(chosen).expanduser().absolute()
    if _default:
        return _default[0] / "fwclass"
    return cache_home() / "fwclass"


def scratch_of(params: StoreParams) -> Scratch:
    """This process' directory for copies, opened once."""
    with _guard:
        parent = scratch_directory(params)
        if parent not in _open:
            _open[parent] = Scratch(parent, params.scratch_gib)
        return _open[parent]


class Scratch:
    """A directory of copies in units: directories that come and go whole. At most `gib` are kept [GiB]."""

    def __init__(self, parent: Path, gib: float) -> None:
        self._limit = gib * GIB
        self.root, self._lock_file = _own_directory(parent)
        self._sizes: OrderedDict[str, int] = OrderedDict()
        self._total = 0
        self._guard = threading.RLock()
        self._busy: dict[str, threading.Lock] = {}
        self.fetched = 0
        self._begin()
        for unit, size, _ in sorted(self._leftovers(), key=lambda one: one[2]):
            self._sizes[unit] = size
            self._total += size

    @property
    def _staging(self) -> Path:
        return self.root / "fetching"

    def _begin(self) -> None:
        """Remove what an earlier process left half, and all if the host went down since: not all may be on its disk."""
        boot = _boot()
        if not boot or not _reads(self.root / "boot", boot):
            for path in self.root.iterdir():
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
            (self.root / "boot").write_text(boot)
        for half in (self._staging, *self.root.glob("*/store/staging")):
            remove_directory(half)
        (self.root / "units").mkdir(exist_ok=True)

    def _leftovers(self) -> list[tuple[str, int, float]]:
        """(unit, bytes, last use) of what an earlier process left; every unit is named by a file in ``units``."""
        units = []
        for mark in (self.root / "units").glob("*"):
            unit = mark.read_text(encoding="utf-8")
            if not unit:  # its writer was killed
                mark.unlink()
                continue
            size = sum(p.stat().st_size for p in files_below(self.root / unit))
            units.append((unit, size, mark.stat().st_mtime))
        return units

    def need(self, objects: Objects, unit: str, files: Mapping[str, Download], digests: Mapping[str, str]) -> None:
        """Make sure that `files` (by path below the unit) lie in the directory `unit`; `target` of each is overwritten.

        `digests` are those of their bytes, by the same path, as far as they are known.

        `StoreError`: an object's bytes are not those of its digest, however often it is fetched. `FileNotFoundError` or
        `LostRace`: as `Objects.fetch`.
        """
        for name in files:
            if name.startswith("/") or ".." in name.split("/"):
                raise StoreError("an object's name leads out of its directory", where=objects.url, got=name)
        with self._guard:
            busy = self._busy.setdefault(unit, threading.Lock())
        with busy:
            lacking = {n: w for n, w in files.items() if not _there(self.root / unit / n, w.size, digests.get(n))}
            if lacking:
                self._fetch(objects, unit, lacking, digests)
            self.used(unit, sum(lacking[n].size for n in lacking))

    def _fetch(self, objects: Objects, unit: str, lacking: Mapping[str, Download], digests: Mapping[str, str]) -> None:
        self._make_room(sum(w.size for w in lacking.values()))
        beside = self._staging / uuid.uuid4().hex
        try:
            wanted = dict(lacking)
            for _ in range(TRIES):
                aside = {n: Download(w.key, w.size, beside / n, w.e_tag) for n, w in wanted.items()}
                for one in aside.values():
                    one.target.parent.mkdir(parents=True, exist_ok=True)
                objects.fetch(list(aside.values()))
                self.fetched += sum(one.size for one in aside.values())
                wanted = {n: lacking[n] for n, one in aside.items() if file_digest(one.target) != digests.get(n, "")}
                wanted = {n: w for n, w in wanted.items() if n in digests}
                if not wanted:
                    break
            if wanted:
                name, one = next(iter(wanted.items()))
                raise StoreError(
                    "an object is not what was written",
                    where=objects.url / one.key,
                    expected=f"{one.size} bytes of digest {digests[name]}",
                    got="other bytes",
                    do=MEND,
                )
            self._mark(unit).write_text(unit, encoding="utf-8")
            for name in lacking:
                target = self.root / unit / name
                target.parent.mkdir(parents=True, exist_ok=True)
                (beside / name).replace(target)
                if name in digests:
                    remember(target, digests[name])
        finally:
            shutil.rmtree(beside, ignore_errors=True)

    def adopt(self, unit: str, size: int) -> None:
        """The directory `unit` was put here by its maker."""
        self._mark(unit).write_text(unit, encoding="utf-8")
        self.used(unit, size)
        self._make_room(0)

    def close(self) -> None:
        """Let another process have the directory."""
        self._lock_file.close()

    def drop(self, unit: str) -> None:
        """Remove a unit."""
        with self._guard:
            self._total -= self._sizes.pop(unit, 0)
            self._mark(unit).unlink(missing_ok=True)
            remove_directory(self.root / unit)

    def used(self, unit: str, more: int = 0) -> None:
        """`unit` is in use now, and has grown by `more` bytes."""
        with self._guard:
            self._sizes[unit] = self._sizes.get(unit, 0) + more
            self._total += more
            self._sizes.move_to_end(unit)
        with suppress(FileNotFoundError):
            os.utime(self._mark(unit))

    def _make_room(self, more: int) -> None:
        with self._guard:
            while self._total + more > self._limit and len(self._sizes) > KEPT:
                self.drop(next(iter(self._sizes)))

    def _mark(self, unit: str) -> Path:
        return self.root / "units" / digest_of(unit)


def _there(path: Path, size: int, digest: str | None) -> bool:
    """The copy is there, with its size and, where that is known, its digest."""
    try:
        return path.stat().st_size == size and (digest is None or digest_now(path) == digest)
    except OSError:
        return False


def _boot() -> str:
    """A name of this run of the host, empty where the system has none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


def _reads(path: Path, text: str) -> bool:
    try:
        return path.read_text() == text
    except OSError:
        return False


def _own_directory(parent: Path) -> tuple[Path, IO[Any]]:
    """The first directory below `parent` that no other process has; it is this one's until it ends."""
    number = 0
    while True:
        root = parent / str(number)
        root.mkdir(parents=True, exist_ok=True)
        stream = (root / "lock").open("a")
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
            return root, stream
        except BlockingIOError:
            stream.close()
            number += 1
