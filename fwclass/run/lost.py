"""What becomes of a part whose worker was lost: killed, crashed, or out of memory.

The scheduler cannot tell which of a worker's parts ended it, nor whether any did. A part that had not begun is
innocent and is handed over again. One that had begun is tried again among others; when that befalls it too often, or
when its worker grew beyond its memory, it is tried with nothing else running, in smaller pieces. If its worker is lost
then too, it is the part.
"""

from __future__ import annotations

import dataclasses
import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fwclass.errors import FwclassError
from fwclass.run.logs import log_attempt
from fwclass.run.part import Name, Outcome
from fwclass.store.run_location import RunLocation
from fwclass.store.run_store import Store

MEMORY = "its worker grew beyond its memory"
TIME = "it took longer than run.part_hours"

ALARM = int(getattr(signal, "SIGALRM", 0))
"""What ends a worker whose part takes too long (`limit`)."""

Verdict = Literal["again", "alone", "failed"]


@dataclass
class Losses:
    """Workers lost under the parts of the run at `location`.

    `retries`: times that a part is tried again among others; as often alone, unless its worker wanted memory.
    """

    location: RunLocation
    retries: int
    _causes: dict[Name, list[str]] = field(default_factory=dict)
    _alone: dict[Name, int] = field(default_factory=dict)
    _idle: dict[Name, int] = field(default_factory=dict)

    def lost(self, name: Name, cause: str, alone: bool, together: bool = False) -> Verdict:
        """A worker that had the part was lost, by `cause`; what to do with the part. Its log tells it.

        `alone`: nothing else ran. `together`: the worker had other parts to make after it, or before it.
        """
        if isinstance(self.location, Path):
            begun = Store(self.location).clear_staged(*name)
        else:  # who stages elsewhere is not seen: of several any may have been begun
            begun = not together
        if not begun and not alone:  # innocent, unless what is loaded to begin it is already too much
            self._idle[name] = self._idle.get(name, 0) + 1
            often = cause.startswith(MEMORY) and self._idle[name] > max(1, self.retries)
            return "alone" if often else "again"
        causes = self._causes.setdefault(name, [])
        causes.append(cause)
        log_attempt(self.location, *name, {"status": "lost", "message": cause})
        if cause.startswith(TIME):
            return "failed"
        if alone:
            self._alone[name] = self._alone.get(name, 0) + 1
            over = cause.startswith(MEMORY) or self._alone[name] > self.retries
            return "failed" if over else "again"
        return "alone" if cause.startswith(MEMORY) or len(causes) > self.retries else "again"

    def message(self, name: Name) -> str:
        """For the user, of a part that is given up."""
        causes = self._causes.get(name, [""])
        if causes[-1].startswith(TIME):
            fault = FwclassError(
                "the part was ended",
                where="/".join(name),
                got=causes[-1],
                do="look for points crowded in one place, or a damaged file (`fwclass info`); if the part is only "
                "large, raise run.part_hours or make tiles smaller (tile.size): no result changes",
            )
            return str(fault)
        memory = causes[-1].startswith(MEMORY)
        more = "give workers more memory (run.worker_memory_gib) or make tiles smaller (tile.size): no result changes"
        crash = (
            "see the part's log and the system's (`dmesg` tells what was killed for want of memory), then run it alone"
        )
        fault = FwclassError(
            f"the worker was lost {len(causes)} times, the last time with nothing else running",
            where="/".join(name),
            got=causes[-1],
            do=more if memory else crash,
        )
        return str(fault)

    def with_causes(self, outcome: Outcome) -> Outcome:
        """The outcome with the causes for which workers were lost before."""
        causes = self._causes.get((outcome.stage, outcome.part))
        return dataclasses.replace(outcome, lost=tuple(causes)) if causes else outcome


def cause_of(bytes_held: int | None, limit_gib: float | None, exit_code: int | None) -> str:
    """Why a worker ended, in words: what it held when its nanny ended it, the limit it had, and its exit code."""
    if bytes_held is not None:
        of = f", of {limit_gib:g} GiB" if limit_gib is not None else ""
        return f"{MEMORY}: {bytes_held / 2**30:.2f} GiB held{of}"
    if exit_code is None:
        return "its worker was lost, it is not known why"
    if exit_code >= 0:
        return f"its worker ended with exit code {exit_code}"
    if exit_code == -ALARM:
        return f"{TIME}, and its worker was ended"
    name = signal.Signals(-exit_code).name if -exit_code in signal.valid_signals() else "an unknown signal"
    meaning = (
        {
            signal.SIGKILL: ": by hand, or by the system for want of memory",
            signal.SIGBUS: ": a file was truncated while it was read, or the disk is full or broken",
            signal.SIGSEGV: ": a fault of the program",
        }.get(signal.Signals(-exit_code), "")
        if -exit_code in signal.valid_signals()
        else ""
    )
    return f"its worker was ended by signal {-exit_code}, {name}{meaning}"
