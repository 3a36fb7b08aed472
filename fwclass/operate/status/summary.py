"""The status of a run as a table for a person, and as plain data for a program."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from fwclass.errors import first_few
from fwclass.operate.request import Request
from fwclass.operate.status.walk import STANDINGS, PartState, RunStatus
from fwclass.run.libraries import by_libraries, text_of
from fwclass.run.part import Name
from fwclass.store.libraries import fingerprint
from fwclass.store.run_store import NO_STAGES

NAMED = 4
"""Parts that are named of those that have one reason."""


def is_delivered(looked: RunStatus, request: Request) -> bool:
    """Whether all parts are done, and readers see just them; those of chosen tiles may lie in a delivery aside."""
    if not looked.all_done:
        return False
    shown = looked.store.generations.current()
    there = [shown] if request.wanted is None or shown is None else looked.store.generations.all()
    return any(g is not None and g.digest == looked.digest for g in there)


def as_data(looked: RunStatus, request: Request, writer: Mapping[str, Any] | None, every: bool) -> dict[str, Any]:
    """Plain data: counts by stage, and every part that is not done, or with `every` all parts."""
    parts = [_part(s, request) for s in looked.states.values() if every or s.standing != "done"]
    return {
        "run": request.root,
        "command": request.command(),
        "done": is_delivered(looked, request),
        "running": dict(writer) if writer else None,
        "plan_ends": looked.ends,
        "fault": None if looked.fault is None else str(looked.fault),
        "stages": [{"stage": stage, **counts} for stage, counts in _counts(looked.states).items()],
        "parts": parts,
        "not_in_plan": others(looked, request),
        "libraries": {"here": dict(fingerprint()), "parts": by_libraries(looked.libraries, looked.store)},
    }


def _part(state: PartState, request: Request) -> dict[str, Any]:
    plain: dict[str, Any] = {"stage": state.stage, "part": state.part, "status": state.standing}
    if state.standing != "done":
        plain |= {"why": [r.text for r in state.reasons], "waits": state.waits, "message": state.message}
    if state.standing == "failed":
        plain["replay"] = request.replay((state.stage, state.part))
    return plain


def _counts(states: Mapping[Name, PartState]) -> dict[str, dict[str, int]]:
    counts: dict[str, dict[str, int]] = {}
    for state in states.values():
        row = counts.setdefault(state.stage, {"parts": 0, **dict.fromkeys(STANDINGS, 0)})
        row["parts"] += 1
        row[state.standing] += 1
    return counts


def others(looked: RunStatus, request: Request) -> dict[str, int]:
    """How many parts by stage the store holds that the plan does not name; none are counted for chosen tiles."""
    if request.wanted is not None:
        return {}
    counts: Counter[str] = Counter()
    for stage, part in looked.store.parts():
        if stage not in NO_STAGES:
            counts[stage] += (stage, part) not in looked.states
    return {stage: n for stage, n in counts.items() if n}


def as_text(looked: RunStatus, request: Request, writer: Mapping[str, Any] | None, every: bool) -> str:
    """A table by stage, then what is not done and why, then what to do."""
    counts = _counts(looked.states)
    rows = [f"{request.root}: {request.command()}"]
    if writer:
        rows.append(f"a run is writing to it: pid {writer.get('pid')} on {writer.get('host')}")
    width = max([5, *map(len, counts)])
    if counts:
        rows += ["", f"{'stage':<{width}}" + "".join(f"{name:>9}" for name in ("parts", *STANDINGS))]
    for stage, row in counts.items():
        rows.append(f"{stage:<{width}}" + "".join(f"{row[n] or '-':>9}" for n in ("parts", *STANDINGS)))
    shown = looked.store.generations.current()
    if shown is not None and not writer and not looked.store.parts():
        gone = "nothing is left of what it was made of (`fwclass clean`, or run.keep_intermediate: false)"
        after = f"the next run makes all of it anew: {request.command()}"
        return "\n".join([rows[0], "", f"delivery {shown.name} stands; {gone}, and {after}"])
    rows += ["", *(_every(looked) if every else _grouped(looked))]
    rows += _failed(looked, request)
    if looked.ends is not None and looked.fault is None:
        rows.append(f"which other parts there are is known once those are made ({looked.ends})")
    left = others(looked, request)
    others_by_stage = ", ".join(f"{stage} {n}" for stage, n in left.items())
    if looked.fault is not None:
        rows += [f"a run would end here: {looked.fault}", "so it cannot be told which parts are stale"]
        return "\n".join([*rows, f"the store holds {others_by_stage}"] if left else rows)
    if left:
        rows.append(f"besides, the store holds parts that the plan does not name (so far): {others_by_stage}")
    rows += [text_of(row) for row in by_libraries(looked.libraries, looked.store)]
    return "\n".join([*rows, _verdict(looked, request, writer)])


def _grouped(looked: RunStatus) -> list[str]:
    """Parts of one stage that are not done for the same kinds of reasons, in one entry."""
    groups: dict[tuple[str, ...], list[PartState]] = {}
    for s in looked.states.values():
        if s.standing not in ("done", "failed"):
            groups.setdefault((s.stage, s.standing, *(r.kind for r in s.reasons)), []).append(s)
    rows = []
    for (stage, standing, *_), some in groups.items():
        rows.append(f"{standing:<8} {stage}: {first_few([s.part for s in some], NAMED)}")
        rows += [f"           {r.text if len(some) == 1 else r.kind}" for r in some[0].reasons]
    return rows


def _every(looked: RunStatus) -> list[str]:
    rows = []
    for s in looked.states.values():
        if s.standing != "failed":
            rows.append(f"{s.standing:<8} {s.stage}/{s.part}")
            rows += [f"           {r.text}" for r in s.reasons]
    return rows


def _failed(looked: RunStatus, request: Request) -> list[str]:
    rows = []
    for s in looked.states.values():
        if s.standing == "failed":
            rows.append(f"failed   {s.stage}/{s.part}")
            rows += [f"           {line}" for line in s.message.splitlines()]
            rows.append(f"           alone: {request.replay((s.stage, s.part))}")
    return rows


def _verdict(looked: RunStatus, request: Request, writer: Mapping[str, Any] | None) -> str:
    total = len(looked.states)
    if is_delivered(looked, request):
        return f"all {total} parts are done"
    if looked.all_done:
        next_step = "wait for the run to end" if writer else f"deliver them: {request.command()}"
        return f"all {total} parts are done, and readers do not see them yet; {next_step}"
    left = sum(s.standing != "done" for s in looked.states.values())
    next_step = "wait for the run to end" if writer else f"make them: {request.command()}"
    waits = f" ({looked.waiting} of them only wait for what they need)" if looked.waiting else ""
    return f"{left} of {total} parts are not done{waits}; {next_step}"
