"""Errors for the reader at 3 a.m.: what, where, expected, got, what to do next."""

from __future__ import annotations

import difflib
import errno
import unicodedata
from collections.abc import Iterable

from fwclass.redact import redacted

DONE, FAILED, USAGE, PARTIAL, QUALITY, INTERRUPTED = 0, 1, 2, 3, 4, 130


_UNSEEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode's classes of characters that show as nothing, turn the text around them, or end a line."""


def is_control(character: str) -> bool:
    """It has no shape of its own: a terminal obeys it, and a reader does not see it."""
    return unicodedata.category(character) in _UNSEEN


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

    def __init__(
        self,
        what: str,
        *,
        where: object = "",
        expected: object = "",
        got: object = "",
        do: str = "",
    ) -> None:
        self.what, self.where, self.do = (
            visible(redacted(what), "\n\t"), visible(redacted(str(where))), visible(redacted(do), "\n\t"),
        )  # fmt: skip
        self.expected, self.got = (visible(redacted(str(text)), "\n\t") for text in (expected, got))
        super().__init__(self.message())

    def message(self) -> str:
        rows = [self.what]
        for label, text in (
            ("where", self.where),
            ("expected", self.expected),
            ("got", self.got),
            ("what to do", self.do),
        ):
            if text:
                rows.append(f"  {label}: {text}")
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


class LockedError(StoreError):
    """Another process is at work on the same directory."""


class PartialError(FwclassError):
    """Some parts failed; everything else was done."""

    exit_code = PARTIAL


class QualityError(FwclassError):
    """A quality threshold was missed."""

    exit_code = QUALITY


def nearest(word: str, known: Iterable[str]) -> str:
    """`did you mean …?` for an unknown name, or the list of known ones."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=1)
    return f"did you mean {close[0]!r}?" if close else "known: " + ", ".join(names)


def system_error(fault: OSError, where: object = "") -> FwclassError:
    """A refusal of the operating system (no such place, no permission, disk full) in words for the user."""
    advice = {
        errno.ENOSPC: "free some space, then run the same command again; what is done is kept",
        errno.EACCES: "choose a place that you may write to, or change its permissions",
        errno.EPERM: "choose a place that you may write to, or change its permissions",
        errno.EROFS: "choose a place that can be written to",
        errno.ENOENT: "check the path",
        errno.ENOTDIR: "check the path: one of its directories is a file",
        errno.EEXIST: "check the path: there is a file where a directory is wanted",
    }
    return FwclassError(
        fault.strerror or type(fault).__name__,
        where=fault.filename or where,
        do=advice.get(fault.errno or 0, "check the disk and the path, then run the same command again"),
    )
