"""Complete files go from the inbox into the survey; what they replace is kept."""

from __future__ import annotations

import errno
import os
import shutil
import time
import uuid
from pathlib import Path
from typing import Any

from fwclass.operate.schedule.inbox import InboxDelivery
from fwclass.operate.schedule.source_directories import REPLACED, WAVES, SourceDirectories
from fwclass.operate.schedule.watch import mark_of
from fwclass.paths import WAVEFORM_ENDINGS
from fwclass.store.atomic import sync


def take(delivery: InboxDelivery, inbox: Path, sources: SourceDirectories, keep: int) -> dict[str, Any]:
    """Move a delivery into the survey; the facts of it. Who calls holds the run directory, so that no run reads it.

    Files of the strip that are there already go to ``<inbox>/replaced/<time>/`` first; of each name the newest `keep`
    stay; links there are not followed. Cut off at any moment, the rest is done at the next look: the points are moved
    last, and the survey has no strip without them. `OSError` where a file cannot be moved.
    """
    delivery.target.mkdir(parents=True, exist_ok=True)
    old = [p for p in _there(delivery, sources) if p.name not in _ahead(delivery, sources)]
    moved = []
    if old:
        _check_no_link(inbox / REPLACED)
        aside = _new_directory(inbox / REPLACED)
        for path in old:
            move(path, aside / path.name)
            moved.append(str((aside / path.name).relative_to(inbox)))
    size = sum(p.stat().st_size for p in delivery.files)
    for path in delivery.files:
        move(path, delivery.target / path.name)
    for marker in delivery.markers:
        marker.unlink(missing_ok=True)
    for path in old:
        prune(inbox / REPLACED, path.name, keep)
    return {"name": delivery.name, "bytes": size, "to": str(delivery.target), "replaced": moved}


def _there(delivery: InboxDelivery, sources: SourceDirectories) -> list[Path]:
    """The strip's files in the survey: sources of the same stem, points first, and their waveforms."""
    head = delivery.files[-1]
    same = [p for p in sorted(delivery.target.iterdir()) if p.is_file() and p.stem.lower() == head.stem.lower()]
    heads = [p for p in same if p.suffix.lower() in WAVEFORM_ENDINGS and (sources.finds(p) or p.name == head.name)]
    return heads + [p for p in same if p.suffix.lower() in WAVES]


def _ahead(delivery: InboxDelivery, sources: SourceDirectories) -> set[str]:
    """Waveforms that lie in the survey without points: they came by a move that was cut off, and belong to the delivery
    where it has none itself."""
    there = _there(delivery, sources)
    if any(p.suffix.lower() in WAVEFORM_ENDINGS for p in there) or len(delivery.files) > 1:
        return set()
    return {p.name for p in there}


def move(source: Path, target: Path) -> None:
    """Rename; to another file system copy beside, flush, compare the size, rename, and only then remove the source."""
    if target.exists() or target.is_symlink():
        raise FileExistsError(errno.EEXIST, "a file is in the way", str(target))
    try:
        source.rename(target)
    except OSError as fault:
        if fault.errno != errno.EXDEV:
            raise
        _copy(source, target)
        source.unlink()
    sync(target.parent)
    sync(source.parent)


def _copy(source: Path, target: Path) -> None:
    beside = target.with_name(f".{target.name}.{uuid.uuid4().hex}")
    before = mark_of(source)
    try:
        shutil.copyfile(source, beside)
        shutil.copystat(source, beside)
        sync(beside)
        if beside.stat().st_size != source.stat().st_size:
            raise OSError(errno.EIO, "the copy has another size", str(source))
        if mark_of(source) != before:  # what is still to come would go to a file that is removed
            raise OSError(errno.EAGAIN, "it was written to while it was copied", str(source))
        beside.rename(target)
    finally:
        beside.unlink(missing_ok=True)


def _new_directory(directory: Path) -> Path:
    """A new directory named by the time (UTC), in order also where several are made in a second."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    for number in range(10_000):
        path = directory / f"{stamp}-{number:04d}"
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        return path
    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(directory / stamp))


def _check_no_link(directory: Path) -> None:
    if directory.is_symlink():
        raise OSError(errno.ELOOP, "a link stands where replaced files are kept", str(directory))


def prune(directory: Path, name: str, keep: int) -> None:
    """Of the older versions of the file `name` the newest `keep` stay; what lies behind a link is none of them."""
    _check_no_link(directory)
    own = [path for path in directory.iterdir() if path.is_dir() and not path.is_symlink()]
    versions = sorted(path / name for path in own if (path / name).is_symlink() or (path / name).is_file())
    for path in versions[: max(0, len(versions) - keep)]:
        path.unlink()
        if not any(path.parent.iterdir()):
            path.parent.rmdir()
