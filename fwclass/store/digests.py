"""Files of the store held to the digests of their bytes: a process reads each once, and again when it looks changed."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from fwclass.cost import counted
from fwclass.errors import DamagedError, StoreError
from fwclass.store.atomic import file_digest

REMEMBERED = 1 << 16
"""Files whose digest a process remembers, some 20 MB; the one remembered longest goes first."""

MEND = (
    "give `--verify` to the same `fwclass run`: it removes what is damaged with all that was made from it, and makes "
    "that anew"
)

Looks = tuple[int, int, int]
"""Size [bytes], when the bytes and when anything of the file was changed [ns since the epoch, for equality alone]. The
second time no program can set. The inode, which tells files that changed places (`remote_file.seen_as` asks for it of
sources), is not among them: some network file systems number a file anew whenever they are asked."""

_known: dict[str, tuple[Looks, str]] = {}
_guard = threading.Lock()


def digest_now(path: Path | str) -> str:
    """Digest of a file's bytes; they are not read where this process has, and the file looks as it did then."""
    entry = _known.get(str(path))
    now = looks(path)
    if entry is not None and entry[0] == now:
        return entry[1]
    with counted("checking"):
        digest = file_digest(Path(path))
    _remember(str(path), now, digest)
    return digest


def remember(path: Path | str, digest: str) -> None:
    """This process has just written or read the file, and it lies where it stays."""
    _remember(str(path), looks(path), digest)


def check_file(path: str, digest: str) -> None:
    """`DamagedError` where a file of a finished part has other bytes, `StoreError` where it is gone."""
    try:
        got = digest_now(path)
    except (FileNotFoundError, NotADirectoryError) as fault:
        raise StoreError(
            "a file of a finished part is gone", where=path, do="run again; the missing parts are made"
        ) from fault
    if got != digest:
        raise DamagedError(
            "a file of a finished part is not what was written (`fwclass run … --verify` mends it)",
            where=path,
            expected=f"bytes of digest {digest}",
            got=f"bytes of digest {got}",
            do=MEND,
        )


def looks(path: Path | str) -> Looks:
    """What tells without reading whether a file is another one."""
    facts = os.stat(path)  # noqa: PTH116 (half the time of Path.stat, for every file that a part reads)
    return facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns


def _remember(path: str, now: Looks, digest: str) -> None:
    with _guard:
        if len(_known) >= REMEMBERED:
            _known.pop(next(iter(_known)))
        _known[path] = now, digest
