"""What parts were made with: parameters and libraries, each kept once for all the receipts that name it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fwclass.errors import DamagedError
from fwclass.store.atomic import digest_of, from_json, to_json
from fwclass.store.bucket import Files
from fwclass.store.libraries import fingerprint_under
from fwclass.store.lookup import Lookup
from fwclass.store.receipts import Receipt


@dataclass(frozen=True)
class Provenance:
    """``store/params/<digest>.json`` and ``store/libraries/<digest>.json``."""

    files: Files
    lookup: Lookup

    def keep(self, kind: str, value: Any) -> str:
        """Keep a `value` of "params" or "libraries" unless it is there; the digest that names it."""
        digest = digest_of(value)
        self.files.put_once(f"store/{kind}/{digest}.json", lambda: to_json(value))
        return digest

    def params(self, receipt: Receipt) -> Any:
        """The parameters that a part was made with, as plain data; None where they were not recorded."""
        return self._read("params", receipt.params)

    def libraries(self, receipt: Receipt) -> Mapping[str, str] | None:
        """The libraries that a part was made with (`libraries.fingerprint`); None where that is not known."""
        return self.fingerprint(receipt.libraries)

    def fingerprint(self, digest: str) -> Mapping[str, str] | None:
        """The libraries that receipts name by `digest`."""
        return fingerprint_under(digest, lambda: self._read("libraries", digest))

    def fingerprints(self) -> list[Mapping[str, str]]:
        """Every set of libraries that was kept."""
        names = [n for n in self.lookup.names("store/libraries") if n.endswith(".json")]
        fingerprints = (self.fingerprint(name.removesuffix(".json")) for name in names)
        return [f for f in fingerprints if f is not None]

    def _read(self, kind: str, digest: str) -> Any:
        """The value that receipts name by `digest`; None where it was not recorded, or is damaged."""
        key = f"store/{kind}/{digest}.json"
        data = self.files.get(key) if digest else None
        try:
            return from_json(data[0], self.files.where / key) if data else None
        except DamagedError:
            return None
