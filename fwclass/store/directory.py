"""Files of a run in a directory, by keys: paths below it, with ``/`` between the names. See FORMAT.md.

What a `Store` stands on: `list`, `get`, `put_new`, `put_over` and `fetch`, and what follows from how a directory makes
a part or a delivery appear whole. `bucket` has the same on object storage.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from fwclass.errors import StoreError
from fwclass.paths import below as path_below
from fwclass.paths import open_regular
from fwclass.store.atomic import (
    clear_staged,
    file_digest,
    files_below,
    move_into_place,
    remove_directory,
    staged,
    sync,
    watched,
    write_text,
)
from fwclass.store.digests import Looks, check_file, looks, remember
from fwclass.store.links import leads_to, link, link_to, same_file
from fwclass.store.objects import Mark, StoredObject
from fwclass.store.receipts import Receipt
from fwclass.store.table_cache import moved

ANY = Mark(None)
"""The mark of every file of a directory: its lock is the kernel's and cannot be lost, so no write has a condition."""
CURRENT = "current"
GENERATIONS = "generations"
FACTS, MANIFEST = "generation.json", "manifest.json"
"""Of a generation: what it says of itself, and of each of its files."""
DELIVERED = (
    *(CURRENT, "laz", "parquet", "rasters", "model", "survey.qgz", "tiles.gpkg", "contours.gpkg", "contours.qml"),
    *("quality.gpkg", "quality.html", "quality.json", "vectors", "vectors.gpkg", "report.html", "report.json"),
)
"""What readers see of a delivery: links in the run directory."""

Facts = Mapping[str, Any]
"""``bytes`` and ``digest`` of a file; of one of a generation on object storage ``e_tag`` too."""
Sealing = Callable[[Mapping[str, Facts]], tuple[str, str]]
"""The texts of a manifest and of what its generation says of itself, of the facts of all files."""


@dataclass(frozen=True)
class Directory:
    """The files below `root`."""

    root: Path
    far: ClassVar[bool] = False
    """A question costs a request: many are asked together, and answers are kept."""

    @property
    def where(self) -> Path:
        """The run, for messages."""
        return self.root

    def unit(self, receipt: Receipt) -> str:
        """The key of the directory of a part's files."""
        return "" if receipt.place == "run" else f"store/{receipt.stage}/{receipt.part}/{receipt.key}"

    # files

    def list(self, below: str) -> Iterator[StoredObject]:
        """Every file whose key begins with ``below/``, in no order."""
        top = len(str(self.root)) + 1
        for directory, _, names in os.walk(self.root / below):
            for name in names:
                path = f"{directory}/{name}"
                with suppress(OSError):  # it went just now
                    facts = os.stat(path)  # noqa: PTH116
                    yield StoredObject(path[top:], facts.st_size, ANY, facts.st_mtime)

    def names(self, below: str) -> Sequence[str]:
        """What lies directly below a key, in order, but for what is just being written; nothing where there is no such
        directory."""
        try:
            return sorted(name for name in os.listdir(self.root / below) if not name.startswith("."))  # noqa: PTH208
        except (FileNotFoundError, NotADirectoryError):
            return []

    def sizes(self, below: str, names: Iterable[str]) -> dict[str, int]:
        """Bytes of those of `names` below a key that are there."""
        sizes = ((name, _size(f"{self.root}/{below}/{name}")) for name in names)
        return {name: size for name, size in sizes if size is not None}

    def digests(self, sizes: Mapping[str, int]) -> dict[str, str]:
        """Digests of the files of these keys that are there, from their bytes as they are now; `sizes` in bytes. What
        has several names here is read once."""
        paths = {key: self.root / key for key in sizes}
        files = {key: _file_of(path) for key, path in paths.items() if path.is_file()}
        digests = {file: file_digest(paths[key]) for file, key in {file: key for key, file in files.items()}.items()}
        return {key: digests[file] for key, file in files.items()}

    def get(self, key: str) -> tuple[bytes, Mark] | None:
        """Bytes and mark of a file, None where there is none."""
        try:
            with open_regular(f"{self.root}/{key}") as stream:  # half the time of Path
                return stream.read(), ANY
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            return None

    def many(self, keys: Sequence[str]) -> Sequence[tuple[bytes, Mark] | None]:
        """As `get`, of several."""
        return [self.get(key) for key in keys]

    def put(self, key: str, text: str) -> None:
        """Write a small file, whoever wrote it before; `OSError` (a directory) or `StoreError` where that fails."""
        write_text(path_below(self.root, key), text)

    def look(self, key: str) -> Looks | None:
        """What tells without reading whether a file is another one, None where there is none."""
        try:
            return looks(f"{self.root}/{key}")
        except (FileNotFoundError, NotADirectoryError):
            return None

    def put_once(self, key: str, text: Callable[[], str]) -> None:
        """Write a small file whose key follows from its text, unless it is there."""
        if self.look(key) is None:
            self.put(key, text())

    def put_new(self, key: str, text: str) -> Mark:
        """Write a file that must not be there yet (`LostRace`), and that tells of itself whether it is whole: a power
        cut may leave none, an earlier or a torn one."""
        return self.put_over(key, text, ANY)

    def put_over(self, key: str, text: str, mark: Mark) -> Mark:
        """As `put_new`, over the version `mark` of it (`LostRace` where it is another one by now)."""
        write_text(path_below(self.root, key), text, flush=False)
        return mark

    def delete(self, keys: Iterable[str]) -> None:
        """Remove files; those that are gone already count as removed."""
        for key in keys:
            path_below(self.root, key).unlink(missing_ok=True)

    def delete_below(self, below: str, first: str) -> None:
        """Remove a directory, its file `first` before all others: without it the rest means nothing."""
        path_below(self.root, f"{below}/{first}").unlink(missing_ok=True)
        remove_directory(self.root / below)

    def fetch(self, below: str, files: Mapping[str, Facts]) -> None:
        """Have files (by path below a key) on this host, below `root`, each with its bytes.

        `StoreError`: one is gone. `DamagedError`: one has other bytes.
        """
        for name, facts in files.items():
            check_file(f"{self.root}/{below}/{name}", str(facts["digest"]))

    def flush(self, below: str) -> None:
        """No power cut brings back what was removed directly below a key."""
        sync(self.root / below)

    def check(self) -> None:
        """`LostRace` once another has the lock of the run."""

    # parts

    @contextmanager
    def making(self, stage: str, part: str) -> Iterator[tuple[Path, Callable[[], None]]]:
        """A directory of this host to make a part in, and what raises `StoreError` where it was taken away meanwhile;
        `under_way` tells of the part until it ends."""
        with (
            staged(path_below(self.root, f"store/staging/{stage}").parent, stage, part) as directory,
            watched(directory) as check,
        ):
            yield directory, check

    def finish(self, path: Path, delivered: bool) -> None:
        """A file that was made is whole: flush it; what is `delivered` nobody may write, as it is linked to, and who
        may read it is the umask's to say."""
        if delivered:
            path.chmod(path.stat().st_mode & 0o444)
        sync(path)

    def put_part(self, receipt: Receipt, directory: Path) -> None:
        """Bring the files of `directory` to their keys; a receipt is to follow."""
        if receipt.place == "run":
            for name in receipt.outputs:
                move_into_place(directory / name, path_below(self.root, name))
        else:  # `Store.done` looks at every file: names that a power cut took are noticed, and the part is made again
            move_into_place(directory, path_below(self.root, self.unit(receipt), links=False), flush=False)
        for name, facts in receipt.outputs.items():
            path = f"{self.root}/{self.unit(receipt)}/{name}"
            remember(path, str(facts["digest"]))
            moved(directory / name, path)

    def collect(self, receipt: Receipt, old: Receipt | None) -> None:
        """A part is committed: remove what no receipt names any more."""
        with suppress(OSError):  # it is done, whatever is left beside it
            self.delete([failure_key(receipt.stage, receipt.part)])
            if receipt.place == "run":
                self.delete_outputs(set(old.outputs if old else ()) - set(receipt.outputs))
                return
            with os.scandir(f"{self.root}/store/{receipt.stage}/{receipt.part}") as entries:
                for entry in entries:
                    if entry.is_dir() and entry.name != receipt.key:
                        remove_directory(Path(entry.path))
                    elif entry.name.startswith("."):  # a receipt whose writer was killed
                        Path(entry.path).unlink(missing_ok=True)

    def delete_outputs(self, names: Iterable[str]) -> None:
        """Remove files of a part that lie in the run directory itself."""
        for name in names:
            path_below(self.root, name).unlink(missing_ok=True)

    def under_way(self) -> dict[tuple[str, str], float]:
        """When each part that is being made was begun [s since the epoch], by (stage, part).

        A killed worker leaves its directory until the run ends: a part may stand here that has failed since.
        """
        begun: dict[tuple[str, str], float] = {}
        staging = self.root / "store" / "staging"
        for path in (p for own in _inside(staging) for stage in _inside(own) for p in _inside(stage)):
            with suppress(FileNotFoundError):  # it has ended meanwhile
                name = (path.parent.name, path.name)
                begun[name] = max(path.parent.stat().st_mtime, begun.get(name, 0.0))
        return begun

    def sweep(self) -> None:
        """Remove what killed workers left of parts, when a run has ended or before it begins."""
        store = self.root / "store"
        for path in (store / "staging").glob("*"):
            clear_staged(path_below(self.root, path.relative_to(self.root).as_posix()))
        remove_directory(store / "staging")
        for path in (p for d in ("", "params", "libraries") for p in (store / d).glob(".*")):  # half-written
            path_below(self.root, path.relative_to(self.root).as_posix()).unlink(missing_ok=True)

    # generations

    def check_links(self) -> None:
        """`StoreError` where something of the user's stands in a place that a delivery needs, or where parts or
        generations would lie on another disk: a delivery's files are those of parts, linked."""
        for name in ("store", GENERATIONS):
            if (self.root / name).is_symlink():
                raise StoreError(
                    "parts and generations belong into the run directory itself",
                    where=self.root / name,
                    expected="a directory, or nothing",
                    got=f"a link to {(self.root / name).readlink()}",
                    do="put the whole run directory there: --out",
                )
        if (self.root / CURRENT).is_dir() and not (self.root / CURRENT).is_symlink():
            raise self._copied()
        for name in DELIVERED:
            path = self.root / name
            if path.exists() and not path.is_symlink():
                raise StoreError(
                    "something of the user's stands where a delivery is to appear",
                    where=path,
                    expected=f"nothing, or a link into {self.root / GENERATIONS}",
                    got="a file or directory",
                    do="move it away, or choose another --out",
                )

    def pointer(self) -> tuple[str, Mark] | None:
        """Name and mark of the generation that readers see, None for none; "" where the pointer is damaged."""
        try:
            shown = (self.root / CURRENT).readlink()
            own = (self.root / shown.parent).resolve() == (self.root / GENERATIONS).resolve()
            return (shown.name if own else ""), ANY
        except FileNotFoundError:
            return None
        except OSError:
            if not (self.root / CURRENT).is_dir():
                raise
            raise self._copied() from None

    def astray(self, name: str) -> tuple[str, ...]:
        """What a generation has at its top, and in whose place something else stands in the run directory."""
        tops = (p.name for p in _inside(self.root / GENERATIONS / name) if p.name not in (FACTS, MANIFEST))
        there = [top for top in tops if os.path.lexists(self.root / top)]
        return tuple(sorted(top for top in there if not leads_to(self.root / top, Path(CURRENT) / top)))

    def _copied(self) -> StoreError:
        """What to say of a run directory whose links became files."""
        return StoreError(
            "the run directory was copied without its links",
            where=self.root / CURRENT,
            expected="a link to the delivery that is shown",
            got="a directory",
            do="copy the run again with its links (cp -a, rsync -a, tar); to read this delivery alone, "
            f"fwclass.open({str(self.root / CURRENT)!r}) opens it",
        )

    def point(self, name: str, facts: Mapping[str, Any], mark: Mark | None) -> None:
        """Lead readers to a generation, in place of what `mark` marks: one rename; then links for what is new in it,
        none for what is gone."""
        link_to(self.root / CURRENT, Path(GENERATIONS) / name)
        entries = {p.name for p in (self.root / GENERATIONS / name).iterdir() if p.name not in (FACTS, MANIFEST)}
        for entry in sorted(entries):
            if not (self.root / entry).is_symlink():
                link_to(self.root / entry, Path(CURRENT) / entry)
        for path in self.root.iterdir():
            if path.is_symlink() and path.name not in entries and path.readlink().parent == Path(CURRENT):
                path.unlink(missing_ok=True)
        sync(self.root)

    def deliver(
        self, pending: Path, number: int, files: Mapping[str, tuple[Path, str]], before: str, sealing: Sealing
    ) -> str:
        """Make a generation of the files in `pending` and of `files` (path below it: file of a part, digest), which
        are linked; its name. What is no file of the generation `before` is held to its digest."""
        manifest = {p.relative_to(pending).as_posix(): _facts_of(p, file_digest(p)) for p in files_below(pending)}
        directories: set[Path] = {pending}
        for name, (source, digest) in sorted(files.items()):
            target = path_below(pending, name)
            if target.parent not in directories:
                target.parent.mkdir(parents=True, exist_ok=True)
                directories.update(d for d in target.parents if pending in d.parents)
            if not before or not same_file(source, self.root / GENERATIONS / before / name):
                check_file(str(source), digest)
            link(source, target)
            manifest[name] = _facts_of(target, digest)
        for name, text in zip((MANIFEST, FACTS), sealing(manifest), strict=True):
            write_text(pending / name, text)
        for directory in directories:
            sync(directory)
        target = self.root / GENERATIONS / f"{number:04d}"
        pending.rename(target)
        sync(target.parent)
        sync(self.root)  # before a link leads there
        return target.name

    def retire(self, names: Iterable[str]) -> None:
        """Remove generations, and what is left of some that were never finished."""
        for name in names:
            remove_directory(path_below(self.root, f"{GENERATIONS}/{name}"))


def failure_key(stage: str, part: str) -> str:
    """Where lies what a part said when it failed."""
    return f"store/failures/{stage}/{part}.json"


def _file_of(path: Path) -> tuple[int, int] | Path:
    """Device and number of a file that has several names; the name of another: not every file system numbers files."""
    facts = path.stat()
    return (facts.st_dev, facts.st_ino) if facts.st_nlink > 1 else path


def _facts_of(path: Path, digest: str) -> dict[str, Any]:
    return {"bytes": path.stat().st_size, "digest": digest}


def _size(path: str) -> int | None:
    """Bytes of a file, None where there is none."""
    try:
        facts = os.stat(path)  # noqa: PTH116 (half the time of Path.stat, for every file of a run)
    except OSError as fault:
        if fault.errno in (errno.ENOENT, errno.ENOTDIR, errno.ELOOP):
            return None
        raise
    return facts.st_size if stat.S_ISREG(facts.st_mode) else None


def _inside(directory: Path) -> list[Path]:
    """What lies in a directory, nothing if it is gone or none; a glob over several levels breaks off where one goes."""
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        return list(directory.iterdir())
    return []
