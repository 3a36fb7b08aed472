"""The store of one run: where parts lie, which are done, how they are read.

``<run>/store/<stage>/<part>/receipt.json`` and beside it one directory, named by the part's key, with the part's files;
in a directory or on object storage. Parts that are delivered lie there too, read-only, and get a second name in a
generation (`generations`). Only a simulated survey is written below the run directory itself and keeps nothing but its
receipt here. See FORMAT.md.
"""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fwclass.cost import cost_so_far, since
from fwclass.errors import StoreError
from fwclass.memory import peak_mib
from fwclass.store.arrays import PARQUET, ZARR
from fwclass.store.atomic import clear_staged, file_digest, from_json, names_below, to_json
from fwclass.store.bucket import Bucket, Remote, files_at
from fwclass.store.failures import Failures
from fwclass.store.generations import Generations
from fwclass.store.history import surplus
from fwclass.store.libraries import fingerprint
from fwclass.store.lookup import RECEIPT, Lookup, Name, part_key, receipt_key, units_by_part
from fwclass.store.objects import Mark
from fwclass.store.provenance import Provenance
from fwclass.store.receipts import Receipt, checked_meta, digest_of_outputs
from fwclass.store.refusals import LostRace
from fwclass.store.url import Url

NO_STAGES = ("staging", "failures", "params", "libraries", "history")
"""Directories of the store that hold no parts."""


class Store:
    """Receipts and commits of one run; with `read_only` nothing is written there.

    With `lists` for who asks about all of it, and says what was made meanwhile (`forget`). One that is not `lasting`
    ends with its process: nothing is flushed, and no receipt tells what it was made with.
    """

    def __init__(
        self, location: Path | Remote, read_only: bool = False, lists: bool = False, lasting: bool = True
    ) -> None:
        self.read_only, self._lasting = read_only, lasting
        self._files = files_at(location)
        self._lookup = Lookup(self._files, lists)

    @property
    def root(self) -> Path:
        """The run directory; of a run on object storage that of its copies on this host."""
        return self._files.root

    @property
    def directory(self) -> Path:
        """Where the store lies on this host."""
        return self.root / "store"

    @property
    def failures(self) -> Failures:
        """The failures of parts."""
        return Failures(self._files)

    @property
    def generations(self) -> Generations:
        """What was delivered."""
        return Generations(self._files)

    @property
    def provenance(self) -> Provenance:
        """The parameters and libraries that parts were made with."""
        return Provenance(self._files, self._lookup)

    @property
    def where(self) -> Path | Url:
        """The run, for messages."""
        return self._files.where

    # what is there

    def receipt(self, stage: str, part: str) -> Receipt | None:
        """The part's receipt, or None; a damaged one says nothing, so that the part is made again."""
        entry = self._lookup.receipt((stage, part))
        return entry[0] if entry else None

    def look_up(self, names: Iterable[Name]) -> None:
        """Receipts of all these parts will be asked for: a store that is far away fetches them together."""
        self._lookup.look_up(names)

    def forget(self, name: Name) -> None:
        """The part was made, by whomever: what is remembered of it does not hold."""
        self._lookup.forget(name)

    def receipts(self, stage: str) -> Iterator[Receipt]:
        """Every receipt of a stage, by part."""
        parts = self._lookup.names(f"store/{stage}")
        self.look_up((stage, part) for part in parts)
        for part in parts:
            receipt = self.receipt(stage, part)
            if receipt is not None:
                yield receipt

    def parts(self) -> list[Name]:
        """Every (stage, part) of the store, done or not."""
        stages = [name for name in self._lookup.names("store") if name not in NO_STAGES]
        return [(stage, part) for stage in stages for part in self._lookup.names(f"store/{stage}")]

    def rows(self, stage: str, part: str) -> int:
        """Rows of a part as its receipt counts them, 0 without one."""
        receipt = self.receipt(stage, part)
        return int(receipt.meta["rows"]) if receipt else 0

    def done(self, stage: str, part: str, key: str) -> Receipt | None:
        """The receipt if the part is done under this key and all its files are there."""
        receipt = self.receipt(stage, part)
        if receipt is None or receipt.key != key or receipt.emptied:
            return None
        sizes = self._lookup.sizes(receipt)
        whole = all(sizes.get(name) == facts["bytes"] for name, facts in receipt.outputs.items())
        return receipt if whole else None

    def size_of(self, receipt: Receipt, name: str) -> int | None:
        """Bytes of a part's file as it lies there, None if it is gone."""
        return self._lookup.sizes(receipt).get(name)

    def damaged(self, receipt: Receipt) -> list[str]:
        """Files of a part that are gone or whose bytes are not those that were written: all of them are read. None of
        one that was emptied."""
        if receipt.emptied:
            return []
        unit = self._files.unit(receipt)
        keys = {name: f"{unit}/{name}" if unit else name for name in receipt.outputs}
        sizes = self._lookup.sizes(receipt)
        digests = self._files.digests({keys[n]: s for n, s in sizes.items() if s == receipt.outputs[n]["bytes"]})
        return [n for n, facts in receipt.outputs.items() if digests.get(keys[n]) != facts["digest"]]

    def base(self, receipt: Receipt) -> Path:
        """The directory that the receipt's outputs are relative to."""
        return self.root / self._files.unit(receipt)

    def path(self, stage: str, part: str, name: str) -> Path:
        """A file or directory of a finished part, on this host, whose bytes are those that were written.

        Every file of a part is read through here. Each is held to the digest in the receipt, once in this process and
        again if it looks changed: `DamagedError`.
        """
        receipt = self.receipt(stage, part)
        if receipt is None:
            raise StoreError(
                "a part that others need is not done",
                where=f"{stage}/{part} in {self.where}",
                do="run again; the missing parts are made",
            )
        if receipt.emptied:
            raise StoreError(
                "the files of a part were removed to save room",
                where=f"{stage}/{part} in {self.where}",
                do="run again with --set run.keep_intermediate=true: they are made anew",
            )
        unit = self._files.unit(receipt)
        self._files.fetch(unit, {f"{name}{rest}": f for rest, f in receipt.files(name).items()})
        return Path(f"{self.root}/{unit}/{name}")  # a third of the time of joining them one by one

    def arrays_name(self, stage: str, part: str, name: str) -> str:
        """The file or directory of a part that holds the arrays `name`."""
        receipt = self.receipt(stage, part)
        small = f"{name}{PARQUET}"
        return small if receipt is not None and small in receipt.outputs else f"{name}{ZARR}"

    def arrays_path(self, stage: str, part: str, name: str) -> Path:
        """As `path`, of the arrays `name`."""
        return self.path(stage, part, self.arrays_name(stage, part, name))

    # making a part

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
        """Do `work` in a staged directory, bring its files to their place, write the receipt, collect what it replaces.

        `work` gets the directory and returns the part's meta. With ``place="deliver"`` the files are made read-only, as
        they are to be linked into a generation; with ``place="run"`` they go to the same relative paths below the run
        directory, one rename each. `version` and `params` are what `key` was made of; they are kept
        so that it can be told later why a part is stale.

        On object storage `LostRace` if the receipt is not the one any more that was there before, or the run has lost
        its lock: nothing names the uploaded files then.
        """
        if place == "run" and self._files.far:
            raise StoreError(
                "files of a run directory itself cannot lie on object storage",
                where=self.where,
                do="fwclass simulate CONF --out DIR, copy DIR to object storage, and set survey.directory to it",
            )
        began, before = time.perf_counter(), cost_so_far()
        old = self._lookup.receipt((stage, part))
        with self._files.making(stage, part) as (directory, check):
            meta = checked_meta(stage, work(directory))
            worked = time.perf_counter()
            outputs = self._finish(directory, f"{stage}/{part}", place == "deliver")
            check()
            receipt = Receipt(
                stage=stage,
                part=part,
                key=key,
                inputs=dict(inputs),
                outputs=outputs,
                place=place,
                meta=meta,
                digest=digest_of_outputs(outputs, meta),
                version=version,
                params="" if params is None else self.provenance.keep("params", params),
                libraries=self.provenance.keep("libraries", dict(fingerprint())) if self._lasting else "",
            )
            self._files.put_part(receipt, directory)
        ended = time.perf_counter()
        receipt = replace(
            receipt,
            seconds=round(ended - began, 4),
            keeping=round(ended - worked, 4),
            cost=since(before),
            peak_mib=round(peak_mib(), 1),
        )
        self._files.check()
        receipt = self._put_receipt(receipt, old[1] if old else None)
        self._files.collect(receipt, old[0] if old else None)
        return receipt

    def _finish(self, directory: Path, name: str, delivered: bool) -> dict[str, dict[str, Any]]:
        """Make the files below `directory` last, as outputs of the part `name`; their sizes and digests."""
        outputs = {}
        for file in names_below(directory):
            path = directory / file
            facts = os.lstat(path)
            if stat.S_ISLNK(facts.st_mode):
                raise StoreError(
                    "a part's files are its own",
                    where=f"{name}: {file}",
                    expected="a file: those of a delivery are made read-only and belong to it",
                    got="a link",
                    do="copy the file",
                )
            if self._lasting:
                self._files.finish(path, delivered)
            outputs[file] = {"bytes": facts.st_size, "digest": file_digest(path)}
        return outputs

    def _put_receipt(self, receipt: Receipt, mark: Mark | None) -> Receipt:
        """The receipt as it was written; that of a twin of this task, which made the same, if it was first."""
        name = receipt.stage, receipt.part
        key, text = receipt_key(*name), receipt.to_text()
        try:
            own = self._files.put_new(key, text) if mark is None else self._files.put_over(key, text, mark)
        except LostRace:
            self.forget(name)
            twin = self.receipt(*name)
            if twin is None or (twin.key, twin.digest) != (receipt.key, receipt.digest):
                raise
            return twin
        self._lookup.wrote(name, receipt, own, text.encode())
        return receipt

    # small pieces of plain data

    def keep(self, name: str, value: Any) -> None:
        """Write a small piece of plain data, ``store/<name>``."""
        self._files.put(f"store/{name}", to_json(value))

    def recall(self, name: str) -> Any:
        """What was kept under this name, None if nothing was; `DamagedError` where it is no plain data any more."""
        data = self._files.get(f"store/{name}")
        return from_json(data[0], self.where / "store" / name) if data else None

    # what goes

    def remove(self, stage: str, part: str) -> None:
        """Remove a part, its receipt first: from then on it is not done, whatever happens to the rest."""
        receipt = self.receipt(stage, part)
        self._files.delete([receipt_key(stage, part)])
        self.forget((stage, part))
        if receipt is not None and receipt.place == "run":
            self._files.delete_outputs(receipt.outputs)
        self._files.delete_below(part_key(stage, part), RECEIPT)

    def remove_all(self, names: Iterable[Name]) -> None:
        """Remove parts, so that no power cut brings one back."""
        gone = list(names)
        for stage, part in gone:
            self.remove(stage, part)
        for stage in sorted({stage for stage, _ in gone}):
            self._files.flush(f"store/{stage}")

    def empty(self, names: Iterable[Name]) -> int:
        """Remove the files of parts and keep their receipts, which say so from before the first is gone; how many."""
        count = 0
        for name in names:
            entry = self._lookup.receipt(name)
            if entry is None or entry[0] is None or entry[0].emptied or entry[0].place != "store":
                continue
            receipt = replace(entry[0], emptied=True)
            self._put_receipt(receipt, entry[1])
            self._files.delete_below(self._files.unit(receipt), RECEIPT)
            count += 1
        return count

    def forget_others(self, stage: str, parts: Iterable[str]) -> list[str]:
        """All `parts` of `stage` are done: remove others, with what they delivered, and what any said when it failed;
        return the names of those that are gone."""
        self._files.check()
        gone = sorted(set(self._lookup.names(f"store/{stage}")) - set(parts))
        for part in gone:
            self.remove(stage, part)
        self.failures.forget(stage, self._lookup.names(f"store/failures/{stage}"))
        return gone

    def under_way(self) -> dict[Name, float]:
        """When each part (stage, part) that is being made was begun [s since the epoch].

        A killed worker leaves its mark until the run ends: a part may stand here that has failed since.
        """
        return self._files.under_way()

    def clear_staged(self, stage: str, part: str) -> bool:
        """Remove what a lost worker left of one part; whether there was something, so that the part had begun."""
        staged = list((self.directory / "staging").glob(f"*/{stage}/{part}"))
        for path in staged:
            clear_staged(path.parent.parent)
        return bool(staged)

    def clear_staging(self) -> None:
        """Remove what an interrupted writer left behind (only the holder of the lock calls this)."""
        self.sweep()
        self.generations.clear_pending()
        if isinstance(self._files, Bucket):
            self._files.clear_copies()
            self._clear_orphans()

    def sweep(self) -> None:
        """Remove what killed workers left of parts, when a run has ended or before it begins."""
        self._files.sweep()

    def _clear_orphans(self) -> None:
        """Remove objects that no receipt names, marks of writers, and what the history has too much."""
        keys = self._lookup.all()
        gone = [*surplus(keys), *(key for key in keys if key.startswith("store/staging/"))]
        parts = dict(units_by_part(keys, NO_STAGES))
        self.look_up(parts)
        for name, units in parts.items():
            receipt = self.receipt(*name)
            named = self._files.unit(receipt) if receipt else ""
            gone += [key for unit, below in units.items() if unit != named for key in below]
        self._files.check()
        self._files.delete(gone)
        self._lookup.clear_copies()
