"""The status of a run as a table for a person, and as plain data for a program."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.errors import first_few, visible
from fwclass.operate.request import Request
from fwclass.operate.status.walk import STANDINGS, PartState, RunStatus
from fwclass.run.libraries import by_libraries, text_of
from fwclass.run.part import Name
from fwclass.store.libraries import fingerprint
from fwclass.store.lock import holder_text
from fwclass.store.run_store import Store
from fwclass.survey.file_digests import delivered_of

NAMED = 4
"""Parts that are named of those that have one reason."""


def is_delivered(status: RunStatus, request: Request) -> bool:
    """Whether all parts are done, and readers see just them; those of chosen tiles may lie in a delivery aside."""
    if not status.all_done:
        return False
    shown = status.store.generations.current()
    there = [shown] if request.wanted is None or shown is None else status.store.generations.all()
    return any(g is not None and g.digest == status.digest and not status.lacking(g) for g in there)


def _lacking(status: RunStatus) -> list[str]:
    """Files of the delivery that readers see that are gone, or of another size."""
    shown = status.store.generations.current()
    return [] if shown is None else status.lacking(shown)


def is_cleaned(status: RunStatus) -> bool:
    """Whether a whole delivery stands alone: what it was made of was removed, and its sources are those that were read
    last."""
    shown = status.store.generations.current()
    left = shown is not None and shown.whole and status.fault is None and _bare(status.store)
    return left and not _other_sources(status) and not _lacking(status)


def _bare(store: Store) -> bool:
    """No part is left but such as made the files of a simulated survey."""
    return all(stage == "simulate" for stage, _ in store.parts())


def _other_sources(status: RunStatus) -> list[str]:
    """Names of source files and settings that are not those of the delivery that readers see."""
    shown = status.store.generations.current()
    known = delivered_of(status.store, "" if shown is None else shown.name)
    return sorted({file.name for file in status.external if file.digest not in known})


def as_data(status: RunStatus, request: Request, writer: Mapping[str, Any] | None, every: bool) -> dict[str, Any]:
    """Plain data: counts by stage, and every part that is not done, or with `every` all parts."""
    parts = [_part(s, request) for s in status.states.values() if every or s.standing != "done"]
    return {
        "run": request.root,
        "command": request.command(),
        "done": is_delivered(status, request),
        "delivery_lacks": _lacking(status),
        "running": dict(writer) if writer else None,
        "plan_ends": status.ends,
        "fault": None if status.fault is None else str(status.fault),
        "stages": [{"stage": stage, **counts} for stage, counts in _counts(status.states).items()],
        "parts": parts,
        "not_in_plan": surplus_parts(status, request),
        "libraries": {"here": dict(fingerprint()), "parts": by_libraries(status.libraries, status.store)},
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


def surplus_parts(status: RunStatus, request: Request) -> dict[str, int]:
    """How many parts by stage the store holds that the plan does not name; none are counted for chosen tiles."""
    if request.wanted is not None:
        return {}
    counts: Counter[str] = Counter()
    for stage, part in status.store.parts():
        counts[stage] += (stage, part) not in status.states
    return {stage: n for stage, n in counts.items() if n}


def as_text(status: RunStatus, request: Request, writer: Mapping[str, Any] | None, every: bool) -> str:
    """A table by stage, then what is not done and why, then what to do."""
    counts = _counts(status.states)
    rows = [f"{request.root}: {request.command()}"]
    if writer:
        rows.append(f"a run is writing to it: {holder_text(writer)}")
    width = max([5, *map(len, counts)])
    if counts:
        rows += ["", f"{'stage':<{width}}" + "".join(f"{name:>9}" for name in ("parts", *STANDINGS))]
    for stage, row in counts.items():
        rows.append(f"{stage:<{width}}" + "".join(f"{row[n] or '-':>9}" for n in ("parts", *STANDINGS)))
    shown = status.store.generations.current()
    if shown is not None and not writer and _bare(status.store):
        gone = "nothing is left of what it was made of (`fwclass clean`, or run.keep_intermediate: false)"
        after = f"the next run makes all of it anew: {request.command()}"
        stands = f"delivery {shown.name} stands; {gone}, and {after}"
        others_now = first_few(_other_sources(status), NAMED)
        came = [f"sources changed or came since then: {others_now}"] if others_now else []
        broken = [_broken(shown.name, lost)] if (lost := _lacking(status)) else []
        return "\n".join([rows[0], "", stands, *came, *broken])
    rows += ["", *(_every(status) if every else _grouped(status))]
    rows += _failed(status, request)
    surplus = surplus_parts(status, request)
    if status.ends is not None and status.fault is None:
        kept = f"; {sum(surplus.values()):,} of the store are taken where nothing of theirs changed" if surplus else ""
        rows.append(f"which other parts there are is known once those are made ({status.ends}){kept}")
    others_by_stage = ", ".join(f"{stage} {n}" for stage, n in surplus.items())
    if status.fault is not None:
        rows += [f"a run would end here: {status.fault}", "so it cannot be told which parts are stale"]
        return "\n".join([*rows, f"the store holds {others_by_stage}"] if surplus else rows)
    if surplus and status.ends is None:
        rows.append(f"besides, the store holds parts that the plan does not name: {others_by_stage}")
    rows += [text_of(row) for row in by_libraries(status.libraries, status.store)]
    return "\n".join([*rows, _verdict(status, request, writer)])


def _grouped(status: RunStatus) -> list[str]:
    """Parts of one stage that are not done for the same kinds of reasons, in one entry."""
    groups: dict[tuple[str, ...], list[PartState]] = {}
    for s in status.states.values():
        if s.standing not in ("done", "failed"):
            groups.setdefault((s.stage, s.standing, *(r.kind for r in s.reasons)), []).append(s)
    rows = []
    for (stage, standing, *_), some in groups.items():
        rows.append(f"{standing:<8} {stage}: {first_few([s.part for s in some], NAMED)}")
        rows += [f"           {r.text if len(some) == 1 else r.kind}" for r in some[0].reasons]
    return rows


def _every(status: RunStatus) -> list[str]:
    rows = []
    for s in status.states.values():
        if s.standing != "failed":
            rows.append(f"{s.standing:<8} {s.stage}/{s.part}")
            rows += [f"           {r.text}" for r in s.reasons]
    return rows


def _failed(status: RunStatus, request: Request) -> list[str]:
    rows = []
    for s in status.states.values():
        if s.standing == "failed":
            rows.append(f"failed   {s.stage}/{s.part}")
            rows += [f"           {line}" for line in s.message.splitlines()]
            rows.append(f"           alone: {request.replay((s.stage, s.part))}")
    return rows


def _verdict(status: RunStatus, request: Request, writer: Mapping[str, Any] | None) -> str:
    total = len(status.states)
    if is_delivered(status, request):
        return f"all {total} parts are done"
    if status.all_done:
        next_step = "wait for the run to end" if writer else f"deliver them: {request.command()}"
        if (gone := _lacking(status)) and (shown := status.store.generations.current()) is not None:
            return f"all {total} parts are done, and {_broken(shown.name, gone)}; {next_step}"
        return f"all {total} parts are done, and readers do not see them yet; {next_step}"
    left = sum(s.standing != "done" for s in status.states.values())
    next_step = "wait for the run to end" if writer else f"make them: {request.command()}"
    waits = f" ({status.waiting} of them only wait for what they need)" if status.waiting else ""
    return f"{left} of {total} parts are not done{waits}; {next_step}"


def _broken(name: str, gone: Sequence[str]) -> str:
    return f"delivery {name} is not what was delivered, gone or of another size: {visible(first_few(gone, NAMED))}"
