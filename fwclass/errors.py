"""Errors for the reader at 3 a.m.: what, where, expected, got, what to do next."""

from __future__ import annotations

import difflib
import errno
import json
import os
import re
import shlex
import shutil
import signal
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fwclass.redact import redacted

DONE, FAILED, USAGE, PARTIAL, QUALITY, INTERRUPTED = 0, 1, 2, 3, 4, 130
INTERRUPTS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end a command as Ctrl-C does: nothing half-written is left."""


_UNSEEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode's classes of characters that show as nothing, turn the text around them, or end a line."""


def is_control(character: str) -> bool:
    """Whether a character is an instruction to the terminal, which a reader does not see, or none (U+FFFF)."""
    code = ord(character)
    return unicodedata.category(character) in _UNSEEN or code & 0xFFFE == 0xFFFE or 0xFDD0 <= code <= 0xFDEF


def visible(text: object, keep: str = "") -> str:
    """`text` with every control character but those in `keep` written out (``\\x1b``): what a file holds must not
    colour, erase or rearrange what a terminal shows."""
    plain = str(text)
    if plain.isprintable():
        return plain
    return "".join(
        c if c in keep or not is_control(c) else c.encode("unicode_escape", "surrogatepass").decode() for c in plain
    )


class FwclassError(Exception):
    """A fault that the user can act on; the command line prints it without a traceback.

    Whatever comes from a file is in it with its control characters written out (`visible`).

    Parameters
    ----------
    what : one sentence, what is wrong.
    where : file, tile, part or configuration key.
    expected, got : the two values that disagree, as text.
    do : what to do next.

    Addresses in all of them are cut to scheme and host: the rest may be a secret.
    """

    exit_code = FAILED

    def __init__(self, what: str, *, where: object = "", expected: object = "", got: object = "", do: str = "") -> None:
        self.what, self.where, self.do = (
            visible(redacted(what), "\n\t"),
            visible(redacted(str(where))),
            visible(redacted(do), "\n\t"),
        )
        self.expected, self.got = (visible(redacted(str(text)), "\n\t") for text in (expected, got))
        super().__init__(self.message())

    def message(self) -> str:
        """The error as text: what, where, what was expected, what there was, what to do; a line each."""
        rows = [self.what]
        for label, text in (
            ("where", self.where),
            ("expected", self.expected),
            ("got", self.got),
            ("what to do", self.do),
        ):
            if text:  # of several lines the further ones are set in: none of a file passes for one of these labels
                rows.append(f"  {label}: " + text.replace("\n", "\n    "))
        return "\n".join(rows)

    def __reduce__(self) -> tuple[object, ...]:
        state = {"where": self.where, "expected": self.expected, "got": self.got, "do": self.do}
        return (_rebuild, (type(self), self.what, state))


def _rebuild(kind: type[FwclassError], what: str, state: dict[str, str]) -> FwclassError:
    return kind(what, **state)


class InputError(FwclassError):
    """A file or a datum from outside cannot be used."""


class ConfigError(FwclassError):
    """A configuration or a command line is wrong."""

    exit_code = USAGE


class StoreError(FwclassError):
    """The store is damaged, locked, or belongs to something else."""


class DamagedError(StoreError):
    """A file of the store is not what was written there."""


class LockedError(StoreError):
    """Another process is at work on the same directory."""


class PartialError(FwclassError):
    """Some parts failed; everything else was done."""

    exit_code = PARTIAL


class QualityError(FwclassError):
    """A quality threshold was missed."""

    exit_code = QUALITY


ACCEPT = "--accept-implausible (plausibility.accept=true) takes it as it is"


def refuse_unsound(
    said: Sequence[str], accepted: bool, what: str, where: object, expected: str, do: str, accept: str = ACCEPT
) -> None:
    """`QualityError` with the sentences `said` of what no sound input shows; nothing without any, or where they are
    accepted. What to do ends with how to `accept` it."""
    if said and not accepted:
        raise QualityError(what, where=where, expected=expected, got="; ".join(said), do=f"{do}; {accept}")


def refuse_named(
    facts: Mapping[str, Any] | None, ways: Iterable[tuple[str, str, str, str]], accepted: bool, where: object
) -> None:
    """`QualityError` of the first of some `ways` to be unsound that has a sentence among `facts`; nothing where they
    are accepted (plausibility.accept). A way: name among the facts, what is wrong, what was expected, what to do."""
    for name, what, expected, do in ways:
        said = [facts[name]] if facts and facts[name] else []
        refuse_unsound(said, accepted, what, where, expected, do)


def first_few(words: Sequence[str], most: int, between: str = ", ") -> str:
    """The first `most` of `words`, and how many there are beyond: ``a, b and 3 more``."""
    return between.join(words[:most]) + (f" and {len(words) - most} more" if len(words) > most else "")


def first_line(fault: BaseException) -> str:
    """What a library says of a fault, in a line; its kind where it says nothing."""
    return (str(fault).strip().splitlines() or [type(fault).__name__])[0][:200]


def several(count: int, noun: str) -> str:
    """``1 tile``, ``2 tiles``, ``1,000 tiles``."""
    return f"{count:,} {noun}{'s' * (count != 1)}"


def nearest(word: str, known: Iterable[str]) -> str:
    """`did you mean …?` for an unknown name, or the list of known ones."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=1)
    return f"did you mean {close[0]!r}?" if close else "known: " + ", ".join(names)


_PLAIN = re.compile(r"[A-Za-z_/][\w/.-]*")


def set_words(key: str, value: object) -> str:
    """``--set key=value`` as it can be given to a shell: a text from a file would else be its next command. A text is
    written as YAML reads it, a mapping with its one key; other values as they are."""

    def written(text: object) -> str:
        plain = not isinstance(text, str) or (_PLAIN.fullmatch(text) and text.lower() not in _NO_TEXTS)
        return str(text) if plain else json.dumps(text)

    if isinstance(value, Mapping):
        value = "{" + ", ".join(f"{written(k)}: {v}" for k, v in value.items()) + "}"
    else:
        value = written(value)
    return f"--set {shlex.quote(f'{key}={value}')}"


_NO_TEXTS = {"null", "true", "false", "yes", "no", "on", "off", "y", "n", "nan"}
"""Words that YAML takes for something else."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What a write says where nothing more can be written: disk full, quota used up, file larger than is allowed."""

_LEAST = 1 << 16
"""Bytes free, below which a fault while writing is put down to a full disk: some libraries do not say why."""


def is_interrupt(fault: BaseException) -> bool:
    """Whether Ctrl-C lies behind a fault: compiled code tells it by a `SystemError`."""
    return any(isinstance(one, KeyboardInterrupt) for one in _behind(fault))


def _behind(fault: BaseException) -> list[BaseException]:
    """A fault and what it came from; one may have been raised from itself."""
    chain: list[BaseException] = []
    cause: BaseException | None = fault
    while cause is not None and cause not in chain:
        chain.append(cause)
        cause = cause.__cause__ or cause.__context__
    return chain


def full_or(fault: Exception, where: Path) -> Exception:
    """`fault`, or the `OSError` of the full disk that lies behind it; `where` is a place on the disk written to."""
    for cause in _behind(fault):
        if isinstance(cause, OSError) and cause.errno in FULL:
            return cause if cause.filename else OSError(cause.errno, os.strerror(cause.errno), str(where))
        for code in FULL:
            if os.strerror(code) in str(cause):
                return OSError(code, os.strerror(code), str(where))
    system = isinstance(fault, OSError) and fault.errno is not None
    if not system and where.exists() and shutil.disk_usage(where).free < _LEAST:
        return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(where))
    return fault


def _disk(where: str) -> str:
    """The disk that a path lies on, and what is free there."""
    path = Path(where).absolute()
    while not path.exists() and path != path.parent:
        path = path.parent
    usage = shutil.disk_usage(path)
    while not path.is_mount() and path != path.parent:
        path = path.parent
    return f"disk {path}: {usage.free / 2**20:.1f} of {usage.total / 2**20:.1f} MiB free now"


_UNFINISHED = re.compile(r"(^|/)\.([^/]+)\.(?:[0-9a-f]{32}|\w+-\d+\.part(?:\.[^/.]+)?)(?=/|$)")
"""A file under the name that it has until it is whole (`publish.files.written_whole`, `store.atomic`)."""


def memory_error(fault: MemoryError) -> FwclassError:
    """Memory that the operating system or a limit refuses, in words for the user."""
    return FwclassError(
        "memory ran out",
        got=visible(first_line(fault)),
        do="free some, raise the limit, or make less at a time (tile.size, --workers), then run the same command "
        "again; what is done is kept",
    )


def system_error(fault: OSError, where: object = "") -> FwclassError:
    """A refusal of the operating system (no such place, no permission, disk full) in words for the user."""
    place = _UNFINISHED.sub(r"\1\2", str(fault.filename or where))
    if fault.errno in FULL:
        words = {
            errno.ENOSPC: ("the disk is full", "free some space"),
            errno.EDQUOT: ("the quota of disk space is used up", "free some space, or ask for more"),
            errno.EFBIG: ("a file may not grow that large", "raise the limit (`ulimit -f`), or choose another disk"),
        }[fault.errno]
        return FwclassError(
            words[0],
            where=place,
            got=_disk(place) if place else "",
            do=f"{words[1]}, then run the same command again; what is done is kept",
        )
    advice = {
        errno.EACCES: "choose a place that you may write to, or change its permissions",
        errno.EPERM: "choose a place that you may write to, or change its permissions",
        errno.EROFS: "choose a place that can be written to",
        errno.ENOENT: "check the path",
        errno.ENOTDIR: "check the path: one of its directories is a file",
        errno.EEXIST: "check the path: there is a file where a directory is wanted",
    }
    return FwclassError(
        fault.strerror or type(fault).__name__,
        where=place,
        do=advice.get(fault.errno or 0, "check the disk and the path, then run the same command again"),
    )
