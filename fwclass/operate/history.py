"""What every `fwclass run` leaves in the history of its run, and the history as it is read."""

from __future__ import annotations

import hashlib
import json
import math
import os
import signal
import socket
import sys
import time
import uuid
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fwclass import __version__
from fwclass.errors import DONE, FAILED, INTERRUPTED, PARTIAL, QUALITY, USAGE, FwclassError, LockedError, StoreError
from fwclass.operate.request import Request
from fwclass.redact import redacted, redacted_setting
from fwclass.store import history
from fwclass.store.refusals import Unreachable
from fwclass.store.shapes import COUNT, NUMBER, TEXT, WHOLE, Maybe, Shape, misfit

if TYPE_CHECKING:
    from fwclass.store.run_location import (
        RunLocation,  # loads what object storage needs, which a directory's history does not
    )

ORDER = "FWCLASS_ORDER"
"""Environment variable by which a schedule tells the run that it starts who it is and why: JSON of id and why."""

WORDS = {
    DONE: "done",
    FAILED: "failed",
    USAGE: "configuration",
    PARTIAL: "partial",
    QUALITY: "quality",
    INTERRUPTED: "interrupted",
}
REFUSED, RUNNING = "refused", "running"

_LINE: dict[str, Shape] = {
    **dict.fromkeys(("began?", "word?"), TEXT),
    **dict.fromkeys(("workflow?", "only?", "aoi?", "message?"), Maybe(TEXT)),
    **dict.fromkeys(("settings?", "tiles?"), Maybe([TEXT])),
    **dict.fromkeys(("generation?", "echoes?"), Maybe(COUNT)),
    "exit_code?": Maybe(WHOLE),
    "seconds?": Maybe(NUMBER),
    "parts?": Maybe({TEXT: COUNT}),
    "accuracy?": Maybe({TEXT: Maybe(NUMBER)}),
    "why?": Maybe({"files?": Maybe([{}])}),
    "told?": Maybe({TEXT: {}}),
}
"""What the values of a line are, where they are there."""

OTHER_TEST = 0.1
"""Of the tested echoes, from which it is said that they are others: corrections take what lies around them out."""

LOOKED_BACK = 20
"""Runs of the history among which an earlier accuracy is looked for."""

LOSS = 0.001
"""Of the overall accuracy, from which it is said that a run is worse than the one before it."""

COUNTED = ("computed", "skipped", "failed", "blocked")


def utc(seconds: float) -> str:
    """Seconds since the epoch as ``2026-03-01T02:00:00Z``."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def word_of(code: int) -> str:
    """What an exit code means; negative ones are signals that ended the process."""
    if code == -signal.SIGINT:
        return WORDS[INTERRUPTED]
    if code < 0:
        with_name = signal.Signals(-code).name if -code in signal.valid_signals() else str(-code)
        return f"killed by {with_name}"
    return WORDS.get(code, "failed")


@dataclass
class Entry:
    """A run's place in the history.

    `location`: where the run lies. `generation`: number of the delivery that it made, None for none. `runner`: where
    its parts are counted. `began`, `clock`: of the wall clock and of the monotonic one [s]. `last`: the line that was
    written last. `accuracy`: ``overall_accuracy``, ``kappa`` and the echoes
    ``tested`` where there was a test area; `echoes`: in the tiles.
    """

    location: RunLocation
    request: Request
    only: str | None = None
    id: str = field(default_factory=lambda: uuid.uuid4().hex)
    why: Mapping[str, Any] = field(default_factory=lambda: {"trigger": "manual"})
    runner: Any = None
    generation: int | None = None
    began: float = field(default_factory=time.time)
    clock: float = field(default_factory=time.monotonic)
    last: dict[str, Any] = field(default_factory=dict)
    accuracy: Mapping[str, float | None] | None = None
    tested_by: str | None = None
    echoes: int | None = None

    def begin(self, runner: Any) -> None:
        """The run holds the directory."""
        self.runner = runner
        self._write({"record": "begin", **self._facts()})

    def end(self, code: int, word: str, message: str = "") -> None:
        """Write that the command ended, with its exit code."""
        self._write(self.ending(code, word, message))

    def ending(self, code: int, word: str, message: str = "") -> dict[str, Any]:
        """The line that tells how the run has ended."""
        counts = Counter(outcome.status for outcome in self.runner.outcomes.values()) if self.runner is not None else {}
        return {
            "record": "end",
            **self._facts(),
            "ended": utc(time.time()),
            "seconds": round(time.monotonic() - self.clock, 3),
            "exit_code": code,
            "word": word,
            "parts": {status: counts.get(status, 0) for status in COUNTED},
            "generation": self.generation,
            "accuracy": None if self.accuracy is None else dict(self.accuracy),
            "tested_by": self.tested_by,
            "echoes": self.echoes,
            "message": message,
        }

    def judged(self, report: Mapping[str, Any]) -> str:
        """Take over what the run's `report` says; a line for the user where an earlier run was more accurate."""
        accuracy = report.get("accuracy")
        self.echoes = (report.get("counts") or {}).get("echoes_in_tiles")
        if not accuracy or accuracy["overall_accuracy"] is None:  # nothing was tested
            return ""
        now, kappa = round(accuracy["overall_accuracy"], 6), accuracy["kappa"]
        tested = int(sum(map(sum, accuracy["confusion"])))
        self.accuracy = {"overall_accuracy": now, "kappa": None if kappa is None else round(kappa, 6), "tested": tested}
        self.tested_by = by = tested_by(report)
        past = (r for r in reversed(past_runs(self.location, LOOKED_BACK)) if _overall(r) is not None)
        earlier = next((r for r in past if r.get("tested_by", by) == by), None)
        before = _overall(earlier or {})
        if earlier is None or before is None or before - now < LOSS:
            return ""
        earlier_tested = (earlier.get("accuracy") or {}).get("tested")
        other = ""
        if earlier_tested and abs(tested - earlier_tested) > OTHER_TEST * earlier_tested:
            other = f"; {tested:,} echoes were tested, {earlier_tested:,} then: it may be more where both were"
        return (
            f"LOST        {100 * (before - now):.1f} points of overall accuracy against the run of {earlier['began']} "
            f"({100 * before:.1f} %){other}"
            + ("; fwclass diff says what changed" if isinstance(self.location, Path) else "")
        )

    def _facts(self) -> dict[str, Any]:
        return {
            "id": self.id,
            "began": utc(self.began),
            "why": dict(self.why),
            "version": __version__,
            "settings": [redacted_setting(s) for s in self.request.settings],
            "workflow": self.request.workflow,
            "tiles": list(self.request.tiles) if self.request.tiles is not None else None,
            "only": self.only,
            "aoi": self.request.aoi,
            "conf": self.request.conf,
            "host": socket.gethostname(),
            "pid": os.getpid(),
        }

    def _write(self, line: Mapping[str, Any]) -> None:
        """A history that cannot be written (disk full, no permission, no network) is told, and stops no run."""
        self.last = dict(line)
        try:
            history.append(self.location, line)
        except (OSError, StoreError) as fault:
            sys.stderr.write(f"the history in {self.location} could not be written: {why_not(fault)}\n")


def tested_by(report: Mapping[str, Any]) -> str:
    """What accuracies hang on besides the classifier, as a digest: classes, test areas and reference."""
    config = report.get("config") or {}
    survey = config.get("survey") or {}
    facts = [*(survey.get(name) for name in ("classes", "reference", "corrections")), config.get("areas")]
    return hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()[:16]


def why_not(fault: OSError | StoreError) -> str:
    """Why a file or an object could not be read or written, in few words."""
    if isinstance(fault, StoreError):
        return fault.what
    return fault.strerror or str(fault)


def entry_of(location: RunLocation, request: Request, only: str | None = None) -> Entry:
    """A new entry; what a schedule has ordered has the schedule's words."""
    entry = Entry(location, request, only)
    try:
        order = json.loads(os.environ.pop(ORDER, "null"))
        if order is not None:
            entry.id, entry.why = str(order["id"]), dict(order["why"])
    except (ValueError, KeyError, TypeError):
        pass  # not a schedule's: a run by hand
    return entry


@contextmanager
def record_run(location: RunLocation, request: Request, only: str | None = None) -> Iterator[Entry]:
    """Write into the history in `location` how the run within ends, however it ends; `Entry.begin` says that it began.

    A run that ended because object storage does not answer, or by Ctrl-C, does not wait for it once more.
    """
    entry = entry_of(location, request, only)
    try:
        yield entry
    except BaseException as fault:
        if isinstance(fault, (Unreachable, KeyboardInterrupt)):
            from fwclass.store.run_location import without_retries

            entry.location = without_retries(location)
        entry.end(*_ending(fault))
        raise
    entry.end(DONE, WORDS[DONE])


def _ending(fault: BaseException) -> tuple[int, str, str]:
    """Exit code, its word and a message for what a run ended with."""
    if isinstance(fault, SystemExit):
        code = fault.code if isinstance(fault.code, int) else int(fault.code is not None)
        return code, word_of(code), ""
    if isinstance(fault, LockedError):
        return fault.exit_code, REFUSED, fault.what
    if isinstance(fault, FwclassError):
        return fault.exit_code, word_of(fault.exit_code), fault.what
    if isinstance(fault, KeyboardInterrupt):
        return INTERRUPTED, WORDS[INTERRUPTED], ""
    text = fault.strerror if isinstance(fault, OSError) else None
    return FAILED, WORDS[FAILED], redacted(text or type(fault).__name__)


def past_runs(location: RunLocation, last: int | None = None) -> list[dict[str, Any]]:
    """The `last` runs in the history, oldest first, with `word` running or interrupted where no end was written.

    None: all of them, or as many as are read of object storage unasked.
    """
    runs = _join_lines(history.lines(location, last))
    if open_runs := [run for run in runs if "word" not in run]:
        from fwclass.store.run_location import held_by

        writer = held_by(location)
        for run in open_runs:
            if writer is None:
                alive = False
            elif writer.get("pid") is None:  # it found no room for its name
                alive = run is open_runs[-1]
            else:
                alive = (writer.get("host"), writer.get("pid")) == (run.get("host"), run.get("pid"))
            run["word"] = RUNNING if alive else WORDS[INTERRUPTED]
    return runs if last is None else runs[-last:]


def past_run(location: RunLocation, name: str) -> dict[str, Any] | None:
    """What the history has of the run whose id is `name`, None for nothing."""
    return next(iter(_join_lines(history.lines_of(location, name))), None)


def _join_lines(lines: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Runs, each of all its lines; a line whose values are of other kinds is damaged, and passed over."""
    runs: dict[str, dict[str, Any]] = {}
    for line in lines:
        name = str(line.get("id"))
        if misfit(line, _LINE):
            continue
        if line.get("record") in ("begin", "end", "told"):
            runs[name] = {**runs.get(name, {}), **{k: v for k, v in line.items() if k != "record"}}
    return [run for run in runs.values() if "began" in run]


def table(runs: Sequence[Mapping[str, Any]]) -> str:
    """Runs as a table for a person, oldest first."""
    if not runs:
        return "no run is in the history"
    rows: list[tuple[str, ...]] = [
        ("began (UTC)", "took", "why", "ended", *COUNTED, "delivery", "echoes", "overall", "what")
    ]
    rows += [_row(run) for run in runs]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    right = {1, *range(4, 4 + len(COUNTED) + 3)}
    return "\n".join(
        "  ".join(
            c.rjust(w) if k in right else c.ljust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def _row(run: Mapping[str, Any]) -> tuple[str, ...]:
    parts, code = run.get("parts") or {}, run.get("exit_code")
    ended = str(run["word"]) if code is None or run["word"] == REFUSED else f"{run['word']} ({code})"
    delivery, overall = run.get("generation"), _overall(run)
    return (
        str(run["began"]),
        _took(run.get("seconds")),
        str((run.get("why") or {}).get("trigger", "")),
        ended,
        *(str(parts.get(status, "-")) for status in COUNTED),
        "-" if delivery is None else str(delivery),
        "-" if run.get("echoes") is None else f"{run['echoes']:,}",
        "-" if overall is None else f"{100 * overall:.1f} %",
        _what(run),
    )


def _overall(run: Mapping[str, Any]) -> float | None:
    """The overall accuracy of a run in the history, None where it was not judged."""
    overall = (run.get("accuracy") or {}).get("overall_accuracy")
    return float(overall) if isinstance(overall, int | float) and math.isfinite(overall) else None


def _took(seconds: Any) -> str:
    if not isinstance(seconds, (int, float)) or not math.isfinite(seconds):
        return "-"
    if seconds < 100:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


def _what(run: Mapping[str, Any]) -> str:
    """Files that came, what the run was restricted to, its settings, and who was not reached."""
    why = run.get("why") or {}
    words = [str(f.get("name")) + (" again" if f.get("replaced") else "") for f in why.get("files") or ()]
    words += [str(run["workflow"])] if run.get("workflow") not in (None, "classification") else []
    words += [f"--only {run['only']}"] if run.get("only") else []
    words += [f"--tiles {','.join(run['tiles'])}"] if run.get("tiles") else []
    words += [f"--aoi {run['aoi']}"] if run.get("aoi") else []
    words += [f"--set {s}" for s in run.get("settings") or ()]
    words += [str(run["message"])] if run.get("message") else []
    words += [f"{kind} failed: {t.get('fault')}" for kind, t in (run.get("told") or {}).items() if not t.get("ok")]
    return ", ".join(words)
