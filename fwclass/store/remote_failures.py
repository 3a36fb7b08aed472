"""Failures of a run on object storage: as `Failures`, one object for every part that failed."""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass

from fwclass.errors import StoreError
from fwclass.store.failures import Failure
from fwclass.store.objects import Objects

_BELOW = "store/failures"


@dataclass(frozen=True)
class RemoteFailures:
    """``store/failures/<stage>/<part>.json``."""

    objects: Objects

    def record(self, failure: Failure) -> None:
        """Keep a failure. Where even that cannot be written it is left: the run itself has told it."""
        with suppress(StoreError):
            self.objects.put(f"{_BELOW}/{failure.stage}/{failure.part}.json", json.dumps(asdict(failure)).encode())

    def clear(self, stage: str, part: str) -> None:
        """The part is made."""
        self.objects.delete([f"{_BELOW}/{stage}/{part}.json"])

    def all(self) -> dict[tuple[str, str], tuple[Failure, float]]:
        """Every failure by (stage, part), with the time it was written [s since the epoch, the server's]."""
        listed = list(self.objects.list(_BELOW))
        found = {}
        for held, data in zip(listed, self.objects.many([held.key for held in listed]), strict=True):
            if data is None:
                continue  # made meanwhile
            try:
                failure = Failure(**json.loads(data[0]))
            except (json.JSONDecodeError, UnicodeDecodeError, TypeError) as fault:
                where = self.objects.url / held.key
                raise StoreError("not a failure", where=where, got=fault, do="remove the object") from fault
            found[failure.stage, failure.part] = failure, held.written
        return found

    def forget_others(self, stage: str, keep: Iterable[str]) -> None:
        """Remove failures of parts of `stage` that the plan no longer has."""
        names = {f"{_BELOW}/{stage}/{part}.json" for part in keep}
        self.objects.delete(held.key for held in self.objects.list(f"{_BELOW}/{stage}") if held.key not in names)
