"""One part alone: the part that failed is made again, and no other."""

from __future__ import annotations

from fwclass.errors import ConfigError, InputError, first_few, nearest
from fwclass.operate.request import Request
from fwclass.operate.status.walk import RunStatus
from fwclass.run.part import Name, Task


def task_alone(status: RunStatus, text: str, request: Request) -> Task:
    """The task that ``--only STAGE/PART`` names; all that it needs must be done."""
    stage, _, part = text.partition("/")
    task = status.tasks.get((stage, part))
    if task is None:
        raise ConfigError(
            "no such part in this run",
            where="--only",
            expected="STAGE/PART, for example features/12_34",
            got=text,
            do=_suggestion(status, stage),
        )
    late = [n for n in task.needs if status.states[n].standing != "done"]
    if late:
        raise InputError(
            f"{text} cannot be made alone: a part that it needs is not done",
            where=f"--only {text}",
            got=first_few([f"{'/'.join(n)} is {status.states[n].standing}" for n in late], 3),
            do=f"make that first ({request.command(late[0])}), or run the whole: {request.command()}",
        )
    return task


def _suggestion(status: RunStatus, stage: str) -> str:
    stages = list(dict.fromkeys(name for name, _ in status.states))
    if stage not in stages:
        return nearest(stage, stages)
    parts: list[Name] = [n for n in status.states if n[0] == stage]
    known = ", ".join(p for _, p in parts[:3])
    return f"{stage} has {len(parts)} parts, for example {known}; `fwclass status --parts` lists all"
