"""Progress on the terminal (standard error): live bars for a person, plain lines at a bounded rate elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from fwclass.compiling import ONCE
from fwclass.errors import visible
from fwclass.run.part import Outcome

PERIOD = 30.0
"""Seconds between two plain lines about stages under way."""

TOLD = 20
"""Failed parts of a stage that are told as they fail; `fwclass status` lists all."""


@dataclass
class _Stage:
    """Parts of one stage: those still expected, and what became of the others."""

    left: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    began: float | None = None
    worked: float = 0.0
    row: TaskID | None = None

    @property
    def ended(self) -> int:
        return sum(self.counts.values())

    @property
    def failed(self) -> int:
        return self.counts.get("failed", 0)

    def pace(self, now: float, workers: int) -> str:
        """Parts a second, what is left at that rate, and what failed.

        Where the workers were at other stages for more than half of the time, the rate is what all of them would do.
        """
        ended = self.counts.get("computed", 0) + self.failed
        took = now - self.began if self.began is not None else 0.0
        alone = self.worked / max(1, workers)
        took = alone if 0.0 < alone < took / 2 else took
        words = []
        if ended > 1 and took > 0:
            rate = ended / took
            words.append(f"{rate:.1f}/s" if rate >= 1 else f"{60 * rate:.1f}/min")
            words += [f"{span(self.left / rate)} left"] if self.left else []
        words += [f"{self.failed} failed"] if self.failed else []
        return ", ".join(words)


def span(seconds: float) -> str:
    """A time to wait, in words."""
    if seconds < 99:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


class Display:
    """Bars of the stages under way and one for all, or a line per finished stage and now and then one between, where
    no person looks on.

    `workers`: processes at work, 0 for this one; `clock` tells seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)
        self.workers = 0
        self._clock = clock
        self._bars = Progress(
            TextColumn("{task.description:<16}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[pace]}"),
            console=self.console,
            transient=True,
        )
        self._live = self.console.is_terminal
        self._stages: dict[str, _Stage] = {}
        self._all: TaskID | None = None
        self._spoke = clock()
        self._messages: set[str] = set()
        self._compiling: set[str] = set()
        self._compiled = False

    def __enter__(self) -> Display:
        if self._live:
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live:
            self._bars.stop()

    def say(self, text: str) -> None:
        """Print lines; characters that would move the terminal come out as escapes."""
        self.console.print(visible(text, keep="\n"), markup=False)

    def expect(self, stages: Mapping[str, int]) -> None:
        """So many more parts of each stage are to come, each told by `ended`."""
        for stage, more in stages.items():
            self._stages.setdefault(stage, _Stage()).left += more
        if self._live:
            total = sum(s.ended + s.left for s in self._stages.values())
            if self._all is None:
                self._all = self._bars.add_task("all", total=total, pace=self._at_work())
            self._bars.update(self._all, total=total)

    def ended(self, outcome: Outcome) -> None:
        """A part has ended in one way or another."""
        stage, now = self._stages[outcome.stage], self._clock()
        stage.counts[outcome.status] = stage.counts.get(outcome.status, 0) + 1
        stage.left -= 1
        stage.worked += outcome.seconds
        if stage.began is None and outcome.status in ("computed", "failed"):
            stage.began = now - outcome.seconds
        if self._live:
            self._draw(outcome.stage, stage, now)
        if stage.left == 0:
            text = ", ".join(f"{n} {status}" for status, n in sorted(stage.counts.items()))
            self.say(f"{outcome.stage:<16} {text}")
        elif not self._live and now - self._spoke >= PERIOD:
            self._spoke = now
            self.say("\n".join(self._under_way(now)))
        if outcome.status == "failed":
            self._tell(outcome, stage)
        elif outcome.lost:
            self.say(f"{outcome.stage}/{outcome.part} {outcome.status} after {outcome.lost[-1]}")

    def compiling(self, worker: str, begins: bool) -> None:
        """A worker, or this process (""), compiles kernels, or waits for another that does; or that is over."""
        (self._compiling.add if begins else self._compiling.discard)(worker)
        if self._live and self._all is not None:
            self._bars.update(self._all, pace=self._at_work())
        elif begins and not self._compiled:
            self.say(f"{'compiling':<16} for this machine, once; `fwclass compile` makes all kernels ahead")
        self._compiled |= begins

    def _draw(self, name: str, stage: _Stage, now: float) -> None:
        """Bars of stages that have begun and not ended; a stage that has ended is a line above them."""
        if stage.row is None:
            stage.row = self._bars.add_task(name, total=None, pace="")
        self._bars.update(
            stage.row,
            completed=stage.ended,
            total=stage.ended + stage.left,
            pace=stage.pace(now, self.workers),
            visible=stage.left > 0,
        )
        if self._all is not None:
            self._bars.update(self._all, advance=1, pace=self._at_work())

    def _at_work(self) -> str:
        where = f"{self.workers} workers" if self.workers else "in this process"
        return f"{where}, {ONCE}" if self._compiling else where

    def _under_way(self, now: float) -> list[str]:
        rows = []
        for name, s in self._stages.items():
            if s.left and s.ended:
                pace = s.pace(now, self.workers)
                rows.append(f"{name:<16} {s.ended} of {s.ended + s.left}" + (f", {pace}" if pace else ""))
        return rows

    def _tell(self, outcome: Outcome, stage: _Stage) -> None:
        if stage.failed > TOLD:
            if stage.failed == TOLD + 1:
                self.say(f"FAILED {outcome.stage}: more than {TOLD} parts; the others are counted, not told")
            return
        known = outcome.message in self._messages
        self._messages.add(outcome.message)
        self.say(f"FAILED {outcome.stage}/{outcome.part}: {'as above' if known else outcome.message}")
