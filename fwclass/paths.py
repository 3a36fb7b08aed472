"""Names from outside that become paths (a receipt's, a source file's): none may lead out of its directory."""

from __future__ import annotations

from pathlib import Path

from fwclass.errors import InputError, is_control

MOST_BYTES = 200
"""Of a name; file systems take 255, and endings are still to come."""


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


def below(directory: Path, name: str) -> Path:
    """``directory / name``, which lies below `directory` whatever links there are on the way.

    Raises
    ------
    InputError
        `name` is absolute, leads elsewhere, or cannot be a file's name; or a link below `directory` leads out of it.
    """
    fault = relative_fault(name)
    path = directory / name if not fault else directory
    if not fault and not path.parent.resolve().is_relative_to(directory.resolve()):
        fault = f"a link on the way leads to {path.parent.resolve()}"
    if fault:
        raise InputError(
            "a name leads out of the directory that it belongs to", where=directory,
            expected="a name of a file below it, without links to elsewhere", got=f"{name!r}: {fault}",
            do="remove what has that name, or give the file another one",
        )  # fmt: skip
    return path
