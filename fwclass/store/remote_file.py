"""Files of a survey: on a path that every host sees, or on object storage, from where a host fetches what it reads."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from fwclass.errors import InputError, StoreError, first_line
from fwclass.paths import BESIDE, path_matches
from fwclass.store.atomic import digest_of
from fwclass.store.digests import looks
from fwclass.store.objects import Download, StoredObject, objects_at
from fwclass.store.params import StoreParams
from fwclass.store.refusals import LostRace
from fwclass.store.scratch import scratch_of
from fwclass.store.url import Url


@dataclass(frozen=True)
class RemoteFile:
    """A file on object storage with the objects beside it that belong to it, or a directory, as a run found them.

    `url`: of the file or directory. `held`: (path relative to what the file lies in, bytes, e-tag) of every object.
    """

    url: Url
    held: tuple[tuple[str, int, str], ...]
    params: StoreParams

    def __str__(self) -> str:
        return str(self.url)

    @property
    def name(self) -> str:
        """The object's name, as of a path."""
        return self.url.name

    @property
    def stem(self) -> str:
        """The name without its ending."""
        return Path(self.name).stem

    def fetched(self, digests: Mapping[str, str]) -> Path:
        """The file, or directory, on this host's disk, with those that belong to it.

        `InputError`: an object is not the one any more that the run found, or its bytes do not have the digest that
        `digests` has for its name.
        """
        scratch = scratch_of(self.params)
        unit = f"outside/{digest_of([self.url, self.held])}"
        files = {n: Download(n, size, scratch.root / unit / n, mark or None) for n, size, mark in self.held}
        known = {n: digests[Path(n).name] for n in files if Path(n).name in digests}
        try:
            scratch.need(objects_at(self.url.parent, self.params), unit, files, known)
        except (LostRace, FileNotFoundError) as fault:
            raise self._changed(fault) from fault
        except StoreError as fault:
            if "is not what was written" in fault.what:
                raise self._changed(fault) from fault
            raise
        return scratch.root / unit / self.name

    def _changed(self, fault: Exception) -> InputError:
        return InputError(
            "a file of the survey was changed or removed while the run was under way",
            where=self.url,
            got=first_line(fault),
            do="run the same again: the parts that the file touches are made anew",
        )


Location = Path | RemoteFile


def local(location: Location, digests: Mapping[str, str] | None = None) -> Path:
    """`location` on this host; fetched if it lies on object storage, and checked against the `digests` of its files."""
    return location.fetched(digests or {}) if isinstance(location, RemoteFile) else location


def seen_as(path: Path, location: Location | None = None) -> tuple[str, list[int | str]]:
    """Name of a file, and what tells without reading it whether it is another: its `looks` and inode; of a copy from
    object storage the object's address, its bytes and e-tag, whatever host it was copied to."""
    if isinstance(location, RemoteFile):
        size, mark = next((size, mark) for name, size, mark in location.held if name == path.name)
        return str(location.url.parent / path.name), [size, mark]
    return str(path), [*looks(path), path.stat().st_ino]


def find_remote(pattern: str, directory: Url, params: StoreParams) -> list[RemoteFile]:
    """Files below `directory` that match `pattern` (``*``, ``?``, ``[…]``, ``**/``), with what belongs to them."""
    fixed = re.match(r"(?:[^*?\[/]+/)*", pattern)
    below = fixed[0].strip("/") if fixed else ""
    objects = list(objects_at(directory, params).list(below))
    wanted = pattern.split("/")
    matching = (h for h in objects if path_matches(h.key.split("/"), wanted, hidden=True))
    return [_with_beside(h, objects, directory, params) for h in matching]


def directory_outside(url: Url, params: StoreParams) -> RemoteFile:
    """A whole directory (a model)."""
    objects = list(objects_at(url.parent, params).list(url.name))
    return RemoteFile(url, tuple((h.key, h.size, h.mark.e_tag or "") for h in objects), params)


def _with_beside(one: StoredObject, objects: Iterable[StoredObject], directory: Url, params: StoreParams) -> RemoteFile:
    path, _, name = one.key.rpartition("/")
    stem = Path(name).stem.lower()
    own = []
    for other in objects:
        there, _, called = other.key.rpartition("/")
        if there == path and (called == name or (Path(called).stem.lower() == stem and _goes_with(name, called))):
            own.append((called, other.size, other.mark.e_tag or ""))
    return RemoteFile(directory / one.key, tuple(own), params)


def _goes_with(name: str, other: str) -> bool:
    return Path(other).suffix.lower() in BESIDE.get(Path(name).suffix.lower(), ())
