"""Files from outside: their digests, and whether they still are what was digested."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fwclass.errors import InputError
from fwclass.store.digests import Looks, digest_now, looks


@dataclass(frozen=True)
class ExternalFile:
    """A file from outside that enters a part's key as `name` with the `digest` of its bytes.

    `path` and `looks` (`digests.looks`) tell later whether the digest still holds; without `path` nothing is looked at.
    """

    name: str
    digest: str
    path: Path | None = None
    looks: Looks = (0, 0, 0)

    def check(self) -> None:
        """`InputError` if the file is another one than the one whose digest was taken.

        Where nothing but the time of its entry is another (it got a second name, other permissions, or other bytes
        and its old time), the bytes tell.
        """
        if self.path is None:
            return
        try:
            now = looks(self.path)
            if now == self.looks or (now[:2] == self.looks[:2] and digest_now(self.path) == self.digest):
                return
        except OSError as fault:
            raise InputError(
                "a file that is being read went away while the run was under way",
                where=self.path,
                got=fault.strerror,
                do="bring it back and run the same again; what is done is kept",
            ) from fault
        raise changed_file(self.path, self.looks, now)


def changed_file(path: Path, before: Looks, now: Looks) -> InputError:
    """The fault of a file that is not the one any more that it was when the run began."""
    return InputError(
        "a file that is being read was changed while the run was under way",
        where=path,
        expected=f"{before[0]} bytes, as when the run began",
        got="the same size, changed later" if now[0] == before[0] else f"{now[0]} bytes",
        do="when it is whole again, run the same again; what is done is kept",
    )


def digest_file(path: Path) -> str:
    """Digest of a file's bytes; `InputError` if it changes meanwhile."""
    before = looks(path)
    digest = digest_now(path)
    ExternalFile(path.name, digest, path, before).check()
    return digest
