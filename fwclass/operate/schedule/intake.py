"""Deliveries on their way: told while they are incomplete, moved into the survey when they are whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fwclass.errors import LockedError
from fwclass.operate.schedule.delivery import take
from fwclass.operate.schedule.inbox import Inbox, InboxDelivery
from fwclass.operate.schedule.state import ScheduleState
from fwclass.operate.schedule.ticks import Now, now
from fwclass.operate.schedule.watch import Watch
from fwclass.store.lock import writer


@dataclass
class Intake:
    """An inbox, and what was said of it: nothing is said twice while it stays as it is."""

    inbox: Inbox
    root: Path
    state: ScheduleState
    say: Callable[[str], None]
    _reasons: dict[str, str] = field(default_factory=dict)
    _trouble: str = ""

    def __post_init__(self) -> None:
        self._watch = Watch(self.inbox.params.settle)

    def look_again(self, moment: Now, settled: bool = True) -> None:
        """Owe a run for files that were written to after they had been moved: what was run was not all of them.

        Those that still change are left for later, unless `settled` is False.
        """
        names = sorted({path.name for path in self._watch.changed(moment, settled)})
        if names:
            self.say(f"{', '.join(names)}: changed after the move into the survey: run again")
            self.state.owed = sorted({*self.state.owed, *names})

    def deliveries(self, moment: Now) -> tuple[InboxDelivery, ...]:
        """Those that are complete and wait for no other."""
        try:
            look = self.inbox.look(moment)
        except OSError as fault:
            self._tell_trouble(f"the inbox cannot be read: {fault.strerror or fault}")
            return ()
        if not look.complete:
            self._trouble = ""
        self.state.waiting = [{"name": w.name, "why": w.why} for w in look.waiting]
        reasons = {w.name: w.why for w in look.waiting}
        for name, why in reasons.items():
            if self._reasons.get(name) != why:
                self.say(f"{name}: waits: {why}")
        self._reasons = reasons
        return self.inbox.ready(look, moment)

    def deliver(self, deliveries: tuple[InboxDelivery, ...]) -> list[dict[str, Any]]:
        """Move files into the survey while no run reads it, and owe their run; the facts of those that were moved.

        What cannot be moved stays and is told: the next look tries again.
        """
        moved: list[dict[str, Any]] = []
        if not deliveries:
            return moved
        stuck: dict[str, str] = {}
        try:
            with writer(self.root):
                for delivery in deliveries:
                    owed = self.state.owed
                    self.state.owed = sorted({*owed, delivery.name})
                    self.state.write(now())  # before the move: a schedule that dies here still owes the run
                    try:
                        moved.append(self._take(delivery))
                    except OSError as fault:  # one that cannot be moved holds no other up
                        self.state.owed = owed
                        stuck[delivery.name] = f"cannot be moved: {fault.strerror or fault} ({fault.filename})"
        except LockedError:
            self._tell_trouble("files are complete, but a run is under way: they wait for its end")
            return moved
        except OSError as fault:
            self._tell_trouble(f"files are complete, but the run cannot be held: {fault.strerror or fault}")
            return moved
        self.state.waiting += [{"name": name, "why": why} for name, why in stuck.items()]
        self._tell_trouble("; ".join(f"{name}: {why}" for name, why in stuck.items()))
        return moved

    def _take(self, delivery: InboxDelivery) -> dict[str, Any]:
        facts = take(delivery, self.inbox.directory, self.inbox.sources, self.inbox.params.keep_replaced)
        self._watch.begin(delivery.target / path.name for path in delivery.files)
        replaced = ""
        if facts["replaced"]:
            kept = self.inbox.params.keep_replaced
            replaced = (
                f"; the older one is kept as {', '.join(facts['replaced'])}" if kept else "; the older one is gone"
            )
        self.say(f"{delivery.name}: moved to {delivery.target}, {facts['bytes']} bytes{replaced}")
        return facts

    def _tell_trouble(self, text: str) -> None:
        if text and text != self._trouble:
            self.say(text)
        self._trouble = text
