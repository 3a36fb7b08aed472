"""Progress on the terminal (standard error): live bars for a person, plain lines elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from fwclass.run.part import Outcome


class Display:
    """One bar per stage, or one line per finished stage where no person looks on."""

    def __init__(self) -> None:
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)
        self._bars = Progress(
            TextColumn("{task.description:<12}"), BarColumn(bar_width=30), MofNCompleteColumn(),
            TextColumn("{task.fields[part]:<14}"), TimeElapsedColumn(), console=self.console, transient=False,
        )  # fmt: skip
        self._live = self.console.is_terminal
        self._rows: dict[str, TaskID] = {}
        self._left: dict[str, int] = {}
        self._counts: dict[str, dict[str, int]] = {}
        self._told: set[str] = set()

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
        self.console.print(text, markup=False)

    def expect(self, stages: Mapping[str, int]) -> None:
        """So many more parts of each stage are to come."""
        for stage, more in stages.items():
            self._left[stage] = self._left.get(stage, 0) + more
            self._counts.setdefault(stage, {})
        if self._live:
            for stage, n in self._left.items():
                if stage not in self._rows and n:
                    self._rows[stage] = self._bars.add_task(stage, total=0, part="")
                if stage in self._rows:
                    done = sum(self._counts[stage].values())
                    self._bars.update(self._rows[stage], total=done + n)

    def ended(self, outcome: Outcome) -> None:
        counts = self._counts[outcome.stage]
        counts[outcome.status] = counts.get(outcome.status, 0) + 1
        self._left[outcome.stage] -= 1
        if self._live:
            self._bars.update(self._rows[outcome.stage], advance=1, part=outcome.part)
        elif self._left[outcome.stage] == 0:
            text = ", ".join(f"{n} {status}" for status, n in sorted(counts.items()))
            self.say(f"{outcome.stage:<12} {text}")
        if outcome.status == "failed":
            told = outcome.message in self._told
            self._told.add(outcome.message)
            self.say(f"FAILED {outcome.stage}/{outcome.part}: {'as above' if told else outcome.message}")
