"""Names from outside that become paths (a receipt's, a source file's): none may lead out of its directory."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

from fwclass.errors import InputError, is_control

MOST_BYTES = 200
"""Of a name; file systems take 255, and endings are still to come."""

WAVEFORM_ENDINGS = {
    ".las": (".wdp", ".wdz"),
    ".laz": (".wdp", ".wdz"),
    ".pls": (".wvs", ".wvz"),
    ".plz": (".wvz", ".wvs"),
}
"""Endings of the file of waveforms that goes with a file of points or pulses; the usual one first."""


BESIDE = {**WAVEFORM_ENDINGS, ".shp": (".dbf", ".shx", ".prj", ".cpg")}
"""Endings of all files that are read together with one of this ending."""


def file_beside(path: Path, ending: str) -> Path | None:
    """``name.wdp`` beside ``name.las``, in any case of letters; None without one."""
    exact = path.with_suffix(ending)
    if exact.is_file():
        return exact
    namesakes = sorted(p for p in path.parent.iterdir() if p.name.lower() == exact.name.lower() and p.is_file())
    return namesakes[0] if namesakes else None


def files_read_with(path: Path) -> list[Path]:
    """`path`, and the files that are read with it: of its name with the endings `BESIDE`; those of a directory."""
    if path.is_dir():
        return sorted(p for p in path.iterdir() if p.is_file())
    if not path.is_file():
        return [path]
    endings = BESIDE.get(path.suffix.lower(), (*WAVEFORM_ENDINGS[".las"], *WAVEFORM_ENDINGS[".pls"]))
    return [path, *(beside for ending in endings if (beside := file_beside(path, ending)) is not None)]


def name_fault(name: object) -> str:
    """Why `name` cannot be the name of one file or directory; "" if it can."""
    if not isinstance(name, str) or not name:
        return "it is empty" if name == "" else "it is no text"
    if name in (".", ".."):
        return "it names another directory"
    if "/" in name or "\\" in name:
        return "it leads to another directory"
    if not name.isprintable() and any(map(is_control, name)):
        return "it has a character that cannot be seen"
    if len(name.encode("utf-8", "surrogatepass")) > MOST_BYTES:
        return f"it is longer than {MOST_BYTES} bytes"
    return ""


def relative_fault(name: object) -> str:
    """Why `name` cannot be a path below a directory, with ``/`` between its parts; "" if it can."""
    if not isinstance(name, str):
        return "it is no text"
    return next((fault for fault in map(name_fault, name.split("/")) if fault), "")


@lru_cache(maxsize=64)
def _real(directory: str) -> str:
    return os.path.realpath(directory)


def _links_below(directory: str, name: str) -> bool:
    """Whether a directory between `directory` and what has the relative `name` is a link: most are none, and to resolve
    the whole path takes three times as long."""
    at = directory.rstrip("/")
    for word in name.split("/")[:-1]:
        at = f"{at}/{word}"
        try:
            if stat.S_ISLNK(os.lstat(at).st_mode):
                return True
        except OSError:  # what is not there has nothing below it
            return False
    return False


def _is_below(parent: str, root: str, name: str, links: bool) -> bool:
    """Whether the directory `parent` of `name` is that of ``root/name``; with `links` anywhere below `root`."""
    if links:
        return parent == root or parent.startswith(f"{root.rstrip('/')}/")
    return parent == f"{root.rstrip('/')}/{name}".rpartition("/")[0]


def below(directory: Path, name: str, links: bool = True) -> Path:
    """``directory / name``, which lies below `directory` whatever links there are on the way; without `links` there
    are none.

    `InputError`: `name` is absolute, leads elsewhere, or cannot be a file's name; or a link below `directory` leads out
    of it.
    """
    fault = relative_fault(name)
    if not fault:
        path = directory / name
        if not _links_below(str(directory), name):
            return path
        # Path.resolve has a RuntimeError for links that lead in a ring: what opens them has better words
        parent = os.path.realpath(path.parent)
        if _is_below(parent, _real(str(directory)), name, links):
            return path
        _real.cache_clear()  # the directory itself may be elsewhere by now
        if _is_below(parent, _real(str(directory)), name, links):
            return path
        fault = f"a link on the way leads to {parent}"
    raise InputError(
        "a name leads out of the directory that it belongs to",
        where=directory,
        expected="a name of a file below it, without links to elsewhere",
        got=f"{name!r}: {fault}",
        do="remove what has that name, or give the file another one",
    )


def run_around(path: Path) -> Path | None:
    """The run directory whose store or delivery `path` lies in, whatever links lead there; None for none."""
    resolved = path.resolve()
    for own in (resolved, *resolved.parents):
        run = own.parent
        if own.name in ("store", "generations") and all((run / n).is_dir() for n in ("store", "generations")):
            return run
    return None


def open_below(directory: Path, name: str, flags: int) -> int:
    """A handle of ``directory / name``, a file on a disk that is no link: opened by `flags`, without waiting.

    `InputError`: as `below`; or it is a link, a pipe, a device or a socket. `OSError`: as `os.open`.
    """
    path, kind = below(directory, name), 0
    try:
        handle = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError:
        if not path.is_symlink():
            raise
    else:
        kind = stat.S_IFMT(os.fstat(handle).st_mode)
        if kind == stat.S_IFREG:
            return handle
        os.close(handle)
    raise InputError(
        "this is no file of the directory itself",
        where=path,
        expected="a file on a disk, or nothing",
        got="a link" if path.is_symlink() else _KINDS.get(kind, "something else"),
        do="remove it",
    )


def path_matches(parts: Sequence[str], pattern: Sequence[str], hidden: bool = False) -> bool:
    """Whether `glob` would find the path of `parts` by `pattern`; ``**`` stands for any number of directories.

    Names that begin with a dot match a pattern that does, or any if `hidden`. Takes time in proportion to the product
    of the two lengths, however many ``**`` there are.
    """
    places = _with_none(pattern, {0})
    for part in parts:
        shown = hidden or not part.startswith(".")
        step = {
            at if pattern[at] == "**" else at + 1
            for at in places
            if at < len(pattern) and (shown or pattern[at].startswith(".")) and _fits(part, pattern[at])
        }
        places = _with_none(pattern, step)
    return len(pattern) in places


def _fits(part: str, pattern: str) -> bool:
    return pattern == "**" or fnmatchcase(part, pattern)


def _with_none(pattern: Sequence[str], places: set[int]) -> set[int]:
    """`places` in a pattern, and those that follow where each ``**`` stands for no directory."""
    all_of_them = set(places)
    for at in places:
        while at < len(pattern) and pattern[at] == "**":
            at += 1
            all_of_them.add(at)
    return all_of_them


_KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


def strange_kind(path: str | Path) -> str:
    """What `path` is in words where it is neither file nor directory: whoever opens a pipe may wait for ever.

    "" for files, directories, and what is not there.
    """
    try:
        return _KINDS.get(stat.S_IFMT(os.stat(path).st_mode), "")  # noqa: PTH116 - a text of the command line
    except (OSError, ValueError):
        return ""


def _waits(handle: int) -> bool:
    """Whether a file that says that it is empty keeps its readers waiting, as the kernel's log below /proc does."""
    try:
        if not os.fstat(handle).st_size and os.read(handle, 1):
            os.lseek(handle, 0, os.SEEK_SET)
    except BlockingIOError:
        return True
    except OSError:  # whoever reads it is told
        pass
    return False


def open_sized(path: Path) -> tuple[BinaryIO, int]:
    """The file at `path`, open for reading, and its size [bytes]; `InputError` where it cannot be opened."""
    try:
        stream = open_regular(path)
    except OSError as error:
        raise InputError("cannot open the file", where=path, got=error, do="check the path and its rights") from error
    return stream, os.fstat(stream.fileno()).st_size


def open_regular(path: Path | str) -> BinaryIO:
    """Open a file for reading, without waiting.

    `InputError`: it is a pipe, a device or a socket. `OSError`: as `open`.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    kind = stat.S_IFMT(os.fstat(handle).st_mode)
    if kind == stat.S_IFREG and not _waits(handle):
        return os.fdopen(handle, "rb")
    os.close(handle)
    if kind == stat.S_IFDIR:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise InputError(
        "this is no file",
        where=path,
        expected="a file on a disk",
        got=_KINDS.get(kind, "something else"),
        do="name a file; what comes through a pipe has to be written to one first",
    )
