"""A run on object storage, written to: parts are uploaded, and each is done by one conditional write: its receipt."""

from __future__ import annotations

import json
import os
import shutil
import socket
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fwclass.cost import since, spent
from fwclass.errors import StoreError
from fwclass.store.atomic import digest_of, file_digest, files_below, staged
from fwclass.store.digests import remember
from fwclass.store.libraries import fingerprint
from fwclass.store.objects import Mark
from fwclass.store.receipts import Receipt, digest_of_outputs
from fwclass.store.refusals import LostRace
from fwclass.store.remote_history import surplus
from fwclass.store.remote_lock import check_token
from fwclass.store.remote_read import RemoteReader, key_of_receipt, unit_of
from fwclass.store.run_store import NO_STAGES, RECEIPT, peak_mib

_kept: set[tuple[str, str]] = set()
"""Parameters and libraries that this process has written: (address, digest)."""


@dataclass(frozen=True)
class RemoteStore(RemoteReader):
    """As `Store`, of a run on object storage."""

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
        """Do `work` in a directory of this host, upload its files, then write the receipt if nobody else did meanwhile.

        As `Store.commit`; all places are the store. `LostRace` if the receipt is not the one any more that was there
        before, or the run has lost its lock: nothing names the uploaded files then.
        """
        if place == "run":
            raise StoreError(
                "files of a run directory itself cannot lie on object storage",
                where=self.where,
                do="fwclass simulate CONF --out DIR, copy DIR to object storage, and set survey.directory to it",
            )
        began, before = time.perf_counter(), spent()
        old = self._held(stage, part)
        with self._marked(stage, part), staged(self.root / "store" / "staging", stage, part) as directory:
            meta = dict(work(directory))
            worked = time.perf_counter()
            outputs = {
                p.relative_to(directory).as_posix(): {"bytes": p.stat().st_size, "digest": file_digest(p)}
                for p in files_below(directory)
            }
            receipt = Receipt(
                stage=stage,
                part=part,
                key=key,
                inputs=dict(inputs),
                outputs=outputs,
                place=place,
                meta=meta,
                digest=digest_of_outputs(outputs, meta),
                peak_mib=round(peak_mib(), 1),
                version=version,
                params=self._keep_params(params),
                libraries=self._keep_once("libraries", dict(fingerprint())),
            )
            self._upload(receipt, directory)
        ended = time.perf_counter()
        receipt = replace(
            receipt, seconds=round(ended - began, 4), keeping=round(ended - worked, 4), cost=since(before)
        )
        self._check_token()
        receipt = self._written(receipt, old[1] if old else None)
        self._clear(receipt, old[0] if old else None)
        return receipt

    def _upload(self, receipt: Receipt, directory: Path) -> None:
        unit = unit_of(receipt)
        target = self.root / unit
        target.parent.mkdir(parents=True, exist_ok=True)
        self.remote.scratch.drop(f"{self.root.name}/{unit}")
        directory.replace(target)
        self.remote.scratch.adopt(f"{self.root.name}/{unit}", sum(int(f["bytes"]) for f in receipt.outputs.values()))
        for name, facts in receipt.outputs.items():
            remember(target / name, str(facts["digest"]))
        self.objects.put_files({f"{unit}/{name}": target / name for name in receipt.outputs})

    def _written(self, receipt: Receipt, mark: Mark | None) -> Receipt:
        """The receipt, by a conditional write; that of a twin of this task, which made the same, if it was first."""
        data = receipt.to_text().encode()
        key = key_of_receipt(receipt.stage, receipt.part)
        try:
            made = self.objects.put_new(key, data) if mark is None else self.objects.put_over(key, data, mark)
        except LostRace:
            self.forget((receipt.stage, receipt.part))
            twin = self._held(receipt.stage, receipt.part)
            if twin is None or twin[0] is None or (twin[0].key, twin[0].digest) != (receipt.key, receipt.digest):
                raise
            return twin[0]
        self._remember((receipt.stage, receipt.part), receipt, made, data)
        return receipt

    def _check_token(self) -> None:
        if self.remote.token:
            check_token(self.objects, self.remote.token)

    def _clear(self, receipt: Receipt, old: Receipt | None) -> None:
        gone = [f"store/{below}" for below in _besides(receipt.stage, receipt.part)]
        if old is not None and unit_of(old) != unit_of(receipt):
            gone += [f"{unit_of(old)}/{name}" for name in old.outputs]
        self.objects.delete(gone)

    @contextmanager
    def _marked(self, stage: str, part: str) -> Iterator[None]:
        """While the part is made, an object tells that it is; it goes when the part is committed, or has failed."""
        self.keep(_besides(stage, part)[0], {"host": socket.gethostname(), "pid": os.getpid()})
        try:
            yield
        except BaseException:
            with suppress(StoreError):  # the next holder of the lock removes it
                self.objects.delete([f"store/{_besides(stage, part)[0]}"])
            raise

    def keep(self, name: str, value: Any) -> None:
        self.objects.put(f"store/{name}", json.dumps(value, sort_keys=True, indent=1, allow_nan=False).encode())

    def _keep_once(self, kind: str, value: Any) -> str:
        digest = digest_of(value)
        if (self.where, digest) not in _kept:
            self.keep(f"{kind}/{digest}.json", value)
            _kept.add((self.where, digest))
        return digest

    def forget_others(self, stage: str, parts: Iterable[str]) -> list[str]:
        self._check_token()
        keep = set(parts)
        gone = sorted({part for of, part in self.parts() if of == stage} - keep)
        for part in gone:
            self.remove(stage, part)
        self.objects.delete(key for key in self._all() if key.startswith(f"store/failures/{stage}/"))
        return gone

    def remove(self, stage: str, part: str) -> None:
        """As `Store.remove`."""
        every = [held.key for held in self.objects.list(f"store/{stage}/{part}")]
        self.objects.delete(k for k in every if k.endswith(f"/{RECEIPT}"))
        self.objects.delete(k for k in every if not k.endswith(f"/{RECEIPT}"))
        self.forget((stage, part))

    def remove_all(self, names: Iterable[tuple[str, str]]) -> None:
        for stage, part in names:
            self.remove(stage, part)

    def sweep(self) -> None:
        """What killed workers left is removed when the next run begins: to find it, everything is listed."""

    def clear_staging(self) -> None:
        """Remove what interrupted writers left: marks, and objects that no receipt names (for the lock's holder); and
        what the history has too much."""
        shutil.rmtree(self.root / "store" / "staging", ignore_errors=True)
        self.generations.clear_pending()
        marks, below = surplus(self._all()), _by_unit(self._all())
        for key in self._all():
            if key.startswith("store/staging/"):
                marks.append(key)
        self.look_up(below)
        for name, units in below.items():
            receipt = self.receipt(*name)
            named = unit_of(receipt) if receipt else ""
            marks += [k for unit, keys in units.items() if unit != named for k in keys]
        self._check_token()
        self.objects.delete(marks)
        self._forget_copies()


def _by_unit(keys: Iterable[str]) -> dict[tuple[str, str], dict[str, list[str]]]:
    """Keys of parts' files by (stage, part) and directory."""
    found: dict[tuple[str, str], dict[str, list[str]]] = {}
    for key in keys:
        words = key.split("/")
        if len(words) > 4 and words[1] not in NO_STAGES:
            found.setdefault((words[1], words[2]), {}).setdefault("/".join(words[:4]), []).append(key)
    return found


def _besides(stage: str, part: str) -> tuple[str, str]:
    """What lies beside a receipt until the part is made: the mark of its making, and what it said when it failed."""
    return f"staging/{stage}/{part}", f"failures/{stage}/{part}.json"
