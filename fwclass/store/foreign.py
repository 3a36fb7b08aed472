"""Files from outside: their digests, and whether they still are what was digested."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fwclass.errors import InputError
from fwclass.store.atomic import file_digest


@dataclass(frozen=True)
class Foreign:
    """A file from outside that enters a part's key as `name` with the `digest` of its bytes.

    `path`, `size` [bytes] and `changed` (modification time [ns since the epoch], for equality alone) tell later
    whether the digest still holds; without `path` nothing is looked at.
    """

    name: str
    digest: str
    path: Path | None = None
    size: int = 0
    changed: int = 0

    def check(self) -> None:
        """`InputError` if the file is another one than the one whose digest was taken."""
        if self.path is None:
            return
        try:
            facts = self.path.stat()
        except OSError as fault:
            raise InputError(
                "a file that is being read went away while the run was under way", where=self.path, got=fault.strerror,
                do="bring it back and run the same again; what is done is kept",
            ) from fault  # fmt: skip
        if (facts.st_size, facts.st_mtime_ns) != (self.size, self.changed):
            same = "the same size, changed later" if facts.st_size == self.size else f"{facts.st_size} bytes"
            raise InputError(
                "a file that is being read was changed while the run was under way", where=self.path,
                expected=f"{self.size} bytes, as when the run began", got=same,
                do="when it is whole again, run the same again; what is done is kept",
            )  # fmt: skip


def digested(path: Path) -> str:
    """Digest of a file's bytes; `InputError` if it changes meanwhile."""
    facts = path.stat()
    digest = file_digest(path)
    Foreign(path.name, digest, path, facts.st_size, facts.st_mtime_ns).check()
    return digest
