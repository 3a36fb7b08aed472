"""Digests of the files that a run reads from outside, remembered from one run to the next."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fwclass.conf import Config
from fwclass.errors import DamagedError, visible
from fwclass.formats import vector
from fwclass.store.atomic import digest_of
from fwclass.store.digests import Looks, looks
from fwclass.store.external_file import ExternalFile, changed_file, digest_file
from fwclass.store.remote_file import Location, RemoteFile, seen_as
from fwclass.store.run_store import Store
from fwclass.store.seal import seal, unseal
from fwclass.store.url import Url
from fwclass.survey.files import find_files

_INPUTS, _DELIVERED = "inputs.json", "delivered.json"
_MODEL = "model "
"""What names of models begin with, among those of files."""

_SETTINGS = "settings"

_SAVED_EVERY = 30.0
"""s of digests that an interruption may cost."""


class Digests:
    """Digests of foreign files, remembered by what they look like (`seen_as`) in ``store/inputs.json``.

    For a store that is only read, a file of a size that it has not under this name is not read: it is another one.
    `asked`: all files whose digests were asked for.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._known = _load(store)
        self.asked: list[ExternalFile] = []
        self._first: dict[Path, Looks] = {}
        self._read_only, self._changed, self._saved = store.read_only, False, time.monotonic()
        self._sizes = {(Path(path).name, facts[0]) for path, facts in self._known.items()}

    def find(self, patterns: Sequence[str], directory: Path | Url, setting: str, config: Config) -> list[Location]:
        """`find_files`; whatever is read of them before their digest is taken is of the bytes that have it."""
        places = find_files(patterns, directory, setting, config.path, config.store)
        files = [one for place in places if isinstance(place, Path) for one in vector.files_of(place)]
        self._first |= {path: looks(path) for path in files}
        return places

    def of(self, paths: Iterable[Path], place: Location | None = None) -> tuple[ExternalFile, ...]:
        """Every path with the digest of its bytes; files that look unchanged are not read again.

        `place`, if it is on object storage, is where the paths are copies from: who fetches them looks at their e-tags.
        `InputError` for one that was changed since it was found (`find`).
        """
        files = []
        for path in paths:
            name, now = seen_as(path, place)
            facts = self._known.get(name)
            if facts is None or facts[:-1] != now:
                facts = [*now, self._digest(path, int(now[0]))]
                self._known[name], self._changed = facts, True
            if isinstance(place, RemoteFile):
                files.append(ExternalFile(path.name, str(facts[-1])))
            else:
                size, changed, entered, _ = (int(n) for n in now)
                files.append(ExternalFile(path.name, str(facts[-1]), path, (size, changed, entered)))
                if self._first.get(path, files[-1].looks) != files[-1].looks:
                    raise changed_file(path, self._first[path], files[-1].looks)
        if time.monotonic() - self._saved > _SAVED_EVERY:
            self.save()
        self.asked += files
        return tuple(files)

    def of_copy(self, copy: Path, place: Path) -> tuple[ExternalFile, ...]:
        """As `of`, of the file at `place`, which is read as the `copy` that was made of it."""
        if copy == place:
            return self.of([place])
        file = ExternalFile(place.name, digest_file(copy), copy, looks(copy))
        self._known[str(place)], self._changed = [*seen_as(copy)[1], file.digest], True
        self.asked.append(file)
        return (file,)

    def of_model(self, place: Location, digest: str) -> None:
        """Remember a model that is read, by the digest that was taken of its files. Earlier runs remembered none: where
        the store is only read, and knows of none, it is not asked for."""
        name = f"{_MODEL}{place}"
        if self._read_only and not any(known.startswith(_MODEL) for known in self._known):
            return
        facts = [_MODEL, name, digest]
        self._changed |= self._known.get(name) != facts
        self._known[name] = facts
        self.asked.append(ExternalFile(visible(str(place)), digest))

    def of_settings(self, settings: Mapping[str, str]) -> None:
        """Remember what a run goes by, as a file is; the name tells which are others than those of the last run. Where
        the store is only read, and knows of none, as after earlier versions, they are not asked for."""
        kept = self._known.get(_SETTINGS, [_SETTINGS, {}, ""])[1]
        then = kept if isinstance(kept, dict) else {}
        facts = [_SETTINGS, dict(settings), digest_of(dict(settings))]
        if self._read_only and _SETTINGS not in self._known:
            return
        changed = sorted(key for key in {*then, *settings} if then.get(key) != settings.get(key))
        self.asked.append(ExternalFile(visible(f"the settings {', '.join(changed)}".strip()), str(facts[-1])))
        self._changed |= self._known.get(_SETTINGS) != facts
        self._known[_SETTINGS] = facts

    def save(self) -> None:
        """Remember what is new; called when all files are known, and now and then before."""
        if self._changed and not self._read_only:
            self._store.keep(_INPUTS, seal(self._known))
        self._changed, self._saved = False, time.monotonic()

    def _digest(self, path: Path, size: int) -> str:
        if self._read_only and (path.name, size) not in self._sizes:
            return f"not read: {path}"
        return digest_file(path)


def keep_delivered(store: Store, generation: str, files: Iterable[ExternalFile]) -> None:
    """Remember what a whole delivery was made of: later runs may read other files, and deliver less, or nothing."""
    facts = seal({"generation": generation, "digests": sorted({file.digest for file in files})})
    try:
        kept = store.recall(_DELIVERED)
    except DamagedError:
        kept = None
    if kept != facts:
        store.keep(_DELIVERED, facts)


def delivered_of(store: Store, generation: str) -> set[str]:
    """Digests of all foreign files, models and settings that a delivery was made of; of one by an earlier version of
    all that runs of this store have read."""
    try:
        facts = unseal(store.recall(_DELIVERED) or {})
        if facts.get("generation") == generation:
            return {str(digest) for digest in facts["digests"]}
    except (DamagedError, TypeError, ValueError, KeyError, AttributeError):
        pass
    return {str(facts[-1]) for facts in _load(store).values()}


def _load(store: Store) -> dict[str, Any]:
    """What was remembered; nothing where that is damaged, and all files are read again."""
    try:
        digests = unseal(store.recall(_INPUTS) or {})
    except (DamagedError, TypeError, ValueError):
        return {}
    return digests if all(isinstance(v, list) and len(v) >= 3 for v in digests.values()) else {}
