"""Files that were moved into the survey, and are still written by whoever brought them."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from fwclass.operate.schedule.ticks import Now

Mark = tuple[int, int, int, int]
"""Size [bytes], time of change and of its entry [ns], and inode of a file."""


def mark_of(path: Path) -> Mark | None:
    """None where there is no such file."""
    try:
        facts = path.stat(follow_symlinks=False)
    except OSError:
        return None
    regular = stat.S_ISREG(facts.st_mode)
    return (facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns, facts.st_ino) if regular else None


def writers(paths: Iterable[Path]) -> dict[Path, int]:
    """Process that has a file open for writing, by file: as far as the system tells, which is on this host, of one's
    own processes; root sees all."""
    wanted = {}
    for path in paths:
        try:
            facts = path.stat()
        except OSError:
            continue
        wanted[facts.st_dev, facts.st_ino] = path
    processes: dict[Path, int] = {}
    for process in Path("/proc").glob("[0-9]*") if wanted else ():
        try:
            handles = list(os.scandir(process / "fd"))
        except OSError:  # it has ended, or belongs to somebody else
            continue
        for handle in handles:
            try:
                facts = handle.stat()
                inode = facts.st_dev, facts.st_ino
                if inode in wanted and _writes(process / "fdinfo" / handle.name):
                    processes[wanted[inode]] = int(process.name)
            except OSError:
                continue
    return processes


def _writes(about: Path) -> bool:
    """By ``flags`` in octal (proc(5))."""
    flags = next((line.split()[1] for line in about.read_text().splitlines() if line.startswith("flags:")), "0")
    return int(flags, 8) & os.O_ACCMODE != os.O_RDONLY


@dataclass
class Watch:
    """Marks of files that were moved, and since when they are others. `settle` as in the section `schedule` [s]."""

    settle: float
    _marks: dict[Path, Mark] = field(default_factory=dict)
    _since: dict[Path, tuple[Mark, float]] = field(default_factory=dict)

    def begin(self, paths: Iterable[Path]) -> None:
        """They have just been moved."""
        for path in paths:
            mark = mark_of(path)
            if mark is not None:
                self._marks[path] = mark
                self._since.pop(path, None)

    def changed(self, now: Now, settled: bool = True) -> list[Path]:
        """Files that are others than when they were moved, or when they were last told here; only those that have not
        changed again for `settle`, unless `settled` is False."""
        others = []
        for path, known in list(self._marks.items()):
            mark = mark_of(path)
            if mark is None:  # it was taken away
                del self._marks[path]
            elif mark != known:
                before = self._since.get(path)
                if before is None or before[0] != mark:
                    before = self._since[path] = (mark, now.steady)
                if not settled or now.steady - before[1] >= self.settle:
                    self._marks[path] = mark
                    others.append(path)
        return others
