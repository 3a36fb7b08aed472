"""Second names of files, and links, in a directory."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from fwclass.errors import StoreError
from fwclass.store.atomic import sync


def link(source: Path, target: Path) -> None:
    """Give a finished file a second name; a copy where the file system has no hard links (or no more of them)."""
    try:
        os.link(source, target)
    except FileNotFoundError as fault:
        raise StoreError(
            "a part's file is gone", where=source, got=fault, do="run again; the missing parts are made"
        ) from fault
    except OSError:
        shutil.copy2(source, target)
        sync(target)


def leads_to(path: Path, target: Path) -> bool:
    """Whether `path` is a link to `target`, as it is written in it."""
    return path.is_symlink() and path.readlink() == target


def link_to(path: Path, target: Path) -> None:
    """Make `path` a link to `target`, in place of the link that it was."""
    beside = path.with_name(f".{path.name}.link")
    beside.unlink(missing_ok=True)
    if leads_to(path, target):
        return
    beside.symlink_to(target)
    beside.replace(path)


def same_file(path: Path, other: Path) -> bool:
    """Whether both are names of one file; not where one is gone."""
    try:
        return path.samefile(other)
    except OSError:
        return False
