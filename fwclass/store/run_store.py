"""The store of one run directory: where parts lie, which are done, how they are read.

``<run>/store/<stage>/<part>/receipt.json`` and beside it one directory, named by the part's key, with the part's files.
Parts that are delivered lie there too, read-only, and get a second name in a generation (`generations`). Only a
simulated survey is written below the run directory itself and keeps nothing but its receipt here. See FORMAT.md.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import psutil

from fwclass.cost import since, spent
from fwclass.errors import DamagedError, StoreError
from fwclass.paths import below, name_fault
from fwclass.store.atomic import (
    clear_staged,
    digest_of,
    file_digest,
    files_below,
    move_into_place,
    read_json,
    staged,
    sync,
    watched,
    write_json,
    write_text,
)
from fwclass.store.digests import check_file, remember
from fwclass.store.failures import Failures
from fwclass.store.generations import Generations
from fwclass.store.libraries import fingerprint, known
from fwclass.store.receipts import Receipt, digest_of_outputs
from fwclass.store.url import Url

MIB = 1 << 20
RECEIPT = "receipt.json"

NO_STAGES = ("staging", "failures", "params", "libraries")
"""Directories of the store that hold no parts."""


@dataclass(frozen=True)
class Store:
    """Paths, receipts and commits below one run directory `root`; with `read_only` nothing is written there."""

    root: Path
    read_only: bool = False

    @property
    def directory(self) -> Path:
        return self.root / "store"

    @property
    def failures(self) -> Failures:
        return Failures(self.directory / "failures")

    @property
    def generations(self) -> Generations:
        return Generations(self.root)

    @property
    def where(self) -> Path | Url:
        """The run, for messages."""
        return self.root

    def _part(self, stage: str, part: str) -> Path:
        fault = name_fault(stage) or name_fault(part)
        if fault:
            raise StoreError("this cannot be the name of a part", where=self.root, got=f"{stage!r}/{part!r}: {fault}")
        return self.directory / stage / part

    def receipt(self, stage: str, part: str) -> Receipt | None:
        """The part's receipt, or None; a damaged one says nothing, so that the part is made again."""
        path = self._part(stage, part) / RECEIPT
        return self._read(path)

    def look_up(self, names: Iterable[tuple[str, str]]) -> None:
        """Receipts of all these parts will be asked for: a store that is far away fetches them together."""

    def forget(self, name: tuple[str, str]) -> None:
        """The part was made, by whomever: what is remembered of it does not hold."""

    def receipts(self, stage: str) -> Iterator[Receipt]:
        """Every receipt of a stage, by part."""
        directory = self.directory / stage
        for path in sorted(directory.glob("*/receipt.json")):
            receipt = self._read(path)
            if receipt is not None:
                yield receipt

    def _read(self, path: Path) -> Receipt | None:
        """The receipt in `path`, of the part whose directory it lies in; None for none, or a damaged one."""
        try:
            facts = os.stat(path)  # noqa: PTH116
            receipt = _parsed(str(path), facts.st_mtime_ns, facts.st_size, facts.st_ino)
        except (FileNotFoundError, NotADirectoryError, DamagedError):
            return None
        if (receipt.stage, receipt.part) != (path.parent.parent.name, path.parent.name):
            raise StoreError(
                "a receipt of another part",
                where=path,
                expected=f"{path.parent.parent.name}/{path.parent.name}",
                got=f"{receipt.stage}/{receipt.part}",
                do="remove the file; the part is made anew",
            )
        return receipt

    def parts(self) -> list[tuple[str, str]]:
        """Every (directory, part) below the store, done or not."""
        return sorted((stage.name, p.name) for stage in _inside(self.directory) for p in _inside(stage))

    def done(self, stage: str, part: str, key: str) -> Receipt | None:
        """The receipt if the part is done under this key and all its files are there."""
        receipt = self.receipt(stage, part)
        if receipt is None or receipt.key != key:
            return None
        base = self.base(receipt)
        whole = all(_size(f"{base}/{name}") == facts["bytes"] for name, facts in receipt.outputs.items())
        return receipt if whole else None

    def size_of(self, receipt: Receipt, name: str) -> int | None:
        """Bytes of a part's file as it lies there, None if it is gone."""
        return _size(f"{self.base(receipt)}/{name}")

    def damaged(self, receipt: Receipt) -> list[str]:
        """Files of a part that are gone or whose bytes are not those that were written: all of them are read."""
        base = self.base(receipt)
        paths = {name: base / name for name in receipt.outputs}
        return [n for n, p in paths.items() if not p.is_file() or file_digest(p) != receipt.outputs[n]["digest"]]

    def remove(self, stage: str, part: str) -> None:
        """Remove a part, its receipt first: from then on it is not done, whatever happens to the rest."""
        receipt = self.receipt(stage, part)
        (self._part(stage, part) / RECEIPT).unlink(missing_ok=True)
        self.forget((stage, part))
        if receipt is not None and receipt.place == "run":
            for name in receipt.outputs:
                below(self.root, name).unlink(missing_ok=True)
        shutil.rmtree(self._part(stage, part), ignore_errors=True)

    def remove_all(self, names: Iterable[tuple[str, str]]) -> None:
        """Remove parts, so that no power cut brings one back."""
        gone = list(names)
        for stage, part in gone:
            self.remove(stage, part)
        for stage in sorted({stage for stage, _ in gone}):
            sync(self.directory / stage)

    def base(self, receipt: Receipt) -> Path:
        """The directory that the receipt's outputs are relative to."""
        return self.root if receipt.place == "run" else self._part(receipt.stage, receipt.part) / receipt.key

    def path(self, stage: str, part: str, name: str) -> Path:
        """A file or directory of a finished part, whose bytes are those that were written.

        Every file of a part is read through here. Each is held to the digest in the receipt, once in this process and
        again if it looks changed: `DamagedError`.
        """
        receipt = self.receipt(stage, part)
        if receipt is None:
            raise StoreError(
                "a part that others need is not done",
                where=f"{stage}/{part} in {self.root}",
                do="run again; the missing parts are made",
            )
        path = self.base(receipt) / name
        for rest, facts in receipt.files(name).items():
            check_file(f"{path}{rest}", str(facts["digest"]))
        return path

    def commit(
        self,
        stage: str,
        part: str,
        key: str,
        inputs: Mapping[str, str],
        place: str,
        work: Callable[[Path], Mapping[str, Any]],
        version: int | None = None,
        params: Any = None,
    ) -> Receipt:
        """Do `work` in a staged directory, flush, rename, write the receipt, collect what it replaces.

        `work` gets the directory and returns the part's meta. With ``place="deliver"`` the files are made read-only, as
        they are to be linked into a generation; with ``place="run"`` they go to the same relative paths below the run
        directory, one rename each. `version` and `params` are what `key` was made of; they are kept
        so that it can be told later why a part is stale.
        """
        began, before = time.perf_counter(), spent()
        own, old = self._part(stage, part), self.receipt(stage, part)
        with staged(self.directory / "staging", stage, part) as directory, watched(directory) as check:
            meta = dict(work(directory))
            worked = time.perf_counter()
            outputs = {}
            for path in files_below(directory):
                if place == "deliver":
                    path.chmod(0o444)
                sync(path)
                name = path.relative_to(directory).as_posix()
                outputs[name] = {"bytes": path.stat().st_size, "digest": file_digest(path)}
            check()
            if place == "run":
                for name in outputs:
                    move_into_place(directory / name, below(self.root, name))
            else:  # `done` looks at every file: names that a power cut took are noticed, and the part is made again
                move_into_place(directory, own / key, flush=False)
        receipt = Receipt(
            stage=stage,
            part=part,
            key=key,
            inputs=dict(inputs),
            outputs=outputs,
            place=place,
            meta=meta,
            digest=digest_of_outputs(outputs, meta),
            seconds=round(time.perf_counter() - began, 4),
            keeping=round(time.perf_counter() - worked, 4),
            cost=since(before),
            peak_mib=round(peak_mib(), 1),
            version=version,
            params=self._keep_params(params),
            libraries=self._keep_once("libraries", dict(fingerprint())),
        )
        base = self.base(receipt)
        for name, facts in outputs.items():
            remember(base / name, str(facts["digest"]))
        write_text(own / RECEIPT, receipt.to_text(), flush=False)  # its seal tells whether it is whole
        with contextlib.suppress(OSError):  # it is done, whatever is left beside it
            self.failures.clear(stage, part)
            self._collect(receipt, old)
        return receipt

    def keep(self, name: str, value: Any) -> None:
        """Write a small piece of plain data, ``store/<name>``."""
        write_json(self.directory / name, value)

    def recall(self, name: str) -> Any:
        """What was kept under this name, None if nothing was."""
        path = self.directory / name
        return read_json(path) if path.exists() else None

    def _keep_params(self, params: Any) -> str:
        """Keep parameters once for all parts that have them; their digest, empty for None."""
        return "" if params is None else self._keep_once("params", params)

    def _keep_once(self, kind: str, value: Any) -> str:
        """Keep what many receipts name, ``store/<kind>/<digest>.json``, once; its digest."""
        digest = digest_of(value)
        path = self.directory / kind / f"{digest}.json"
        if not path.exists():
            write_json(path, value)
        return digest

    def _kept(self, kind: str, digest: str) -> Any:
        """What receipts name by `digest`; None where it was not recorded, or is damaged."""
        try:
            return self.recall(f"{kind}/{digest}.json") if digest else None
        except (DamagedError, ValueError, RecursionError):
            return None

    def params(self, receipt: Receipt) -> Any:
        """The parameters that a part was made with, as plain data; None where they were not recorded."""
        return self._kept("params", receipt.params)

    def libraries(self, receipt: Receipt) -> Mapping[str, str] | None:
        """What a part was made with (`libraries.fingerprint`); None where that is not known."""
        return self.fingerprint(receipt.libraries)

    def fingerprint(self, digest: str) -> Mapping[str, str] | None:
        """What receipts name by `digest`."""
        return known(digest, lambda: self._kept("libraries", digest))

    def fingerprints(self) -> list[Mapping[str, str]]:
        """Every fingerprint that was kept."""
        found = (self.fingerprint(d) for d in self._digests("libraries"))
        return [f for f in found if f is not None]

    def _digests(self, kind: str) -> list[str]:
        return sorted(p.stem for p in (self.directory / kind).glob("[!.]*.json"))

    def _collect(self, receipt: Receipt, old: Receipt | None) -> None:
        """Remove what no receipt names any more."""
        if receipt.place == "run":
            for name in set(old.outputs if old else ()) - set(receipt.outputs):
                below(self.root, name).unlink(missing_ok=True)
            return
        for path in self._part(receipt.stage, receipt.part).iterdir():
            if path.is_dir() and path.name != receipt.key:
                shutil.rmtree(path, ignore_errors=True)
            elif path.name.startswith("."):  # a receipt whose writer was killed
                path.unlink(missing_ok=True)

    def forget_others(self, stage: str, parts: Iterable[str]) -> list[str]:
        """All `parts` of `stage` are done: remove others, with what they delivered, and what any said when it failed;
        return the names of those that are gone."""
        keep = set(parts)
        directory = self.directory / stage
        gone = sorted(p.name for p in directory.iterdir() if p.name not in keep) if directory.is_dir() else []
        for part in gone:
            self.remove(stage, part)
        self.failures.forget_others(stage, ())
        return gone

    def under_way(self) -> dict[tuple[str, str], float]:
        """When each part (stage, part) that has a staged directory was begun [s since the epoch].

        A killed worker leaves its directory until the run ends: a part may stand here that has failed since.
        """
        found: dict[tuple[str, str], float] = {}
        for path in (
            p for own in _inside(self.directory / "staging") for stage in _inside(own) for p in _inside(stage)
        ):
            with contextlib.suppress(FileNotFoundError):  # it has ended meanwhile
                name = (path.parent.name, path.name)
                found[name] = max(path.parent.stat().st_mtime, found.get(name, 0.0))
        return found

    def clear_staged(self, stage: str, part: str) -> bool:
        """Remove what a lost worker left of one part; whether there was something, so that the part had begun."""
        left = list((self.directory / "staging").glob(f"*/{stage}/{part}"))
        for path in left:
            clear_staged(path.parent.parent)
        return bool(left)

    def clear_staging(self) -> None:
        """Remove what an interrupted writer left behind (only the holder of the lock calls this)."""
        self.sweep()
        self.generations.clear_pending()

    def sweep(self) -> None:
        """Remove what killed workers left of parts, when a run has ended or before it begins."""
        for path in (self.directory / "staging").glob("*"):
            clear_staged(path)
        shutil.rmtree(self.directory / "staging", ignore_errors=True)
        for path in (p for d in ("", "params", "libraries") for p in (self.directory / d).glob(".*")):  # half-written
            path.unlink(missing_ok=True)


@lru_cache(maxsize=4096)
def _parsed(path: str, changed: int, size: int, inode: int) -> Receipt:
    """The receipt in a file as it stands there; a worker asks for those of a tile's neighbours again and again."""
    return Receipt.from_json(read_json(Path(path)), path)


REMEMBERED = 20_000
"""Receipts that `SeenStore` keeps; of a tile of 100 m the digests of squares alone are 3 KB."""


@dataclass(frozen=True)
class SeenStore(Store):
    """A store whose receipts are read once, for who alone knows when they change and says so (`forget`)."""

    _seen: dict[tuple[str, str], Receipt | None] = field(default_factory=dict, compare=False)

    def receipt(self, stage: str, part: str) -> Receipt | None:
        name = (stage, part)
        if name not in self._seen:
            if len(self._seen) >= REMEMBERED:
                self._seen.pop(next(iter(self._seen)))
            self._seen[name] = super().receipt(stage, part)
        return self._seen[name]

    def forget(self, name: tuple[str, str]) -> None:
        """The part was made, by whomever."""
        self._seen.pop(name, None)


def _size(path: str) -> int | None:
    """Bytes of a file, None where there is none."""
    try:
        facts = os.stat(path)  # noqa: PTH116 (half the time of Path.stat, for every file of a run)
    except (FileNotFoundError, NotADirectoryError):
        return None
    return facts.st_size if stat.S_ISREG(facts.st_mode) else None


def _inside(directory: Path) -> list[Path]:
    """What lies in a directory, nothing if it is gone or none; a glob over several levels breaks off where one goes."""
    try:
        return list(directory.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return []


def peak_mib() -> float:
    """Highest resident memory of this process so far [MiB]; where the system does not tell, the present one.

    Not `getrusage`: a process begins there with the peak of the one that started it, so that the workers of a large
    program would all look large.
    """
    try:
        told = re.search(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    except OSError:
        told = None
    if told:
        return int(told[1]) * 1024 / MIB
    memory = psutil.Process(os.getpid()).memory_info()
    return float(getattr(memory, "peak_wset", memory.rss)) / MIB
