"""What the delivery that a run follows had, and its own has not: sources that are gone, or another survey's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from unicodedata import normalize

from fwclass.errors import DamagedError, first_few, refuse_unsound
from fwclass.run.runner import Runner
from fwclass.store.atomic import read_json

NAMED = 5
"""Sources that are named."""


def since_earlier(runner: Runner, name: str, survey: str, files: Mapping[str, Any]) -> dict[str, Any] | None:
    """What changed since the delivery that is shown now; None where there is none, or it cannot be read.

    `name`: of its report. `survey`: name of the survey. `files`: of this run, as `source_files` has them; one that is
    left out on request (survey.exclude) is not lost.

    Returns ``lost_sources`` with path, points and pulses, and ``remarks``.
    """
    path = runner.store.generations.shown(name)
    here = {normalize("NFC", name) for name in (*(one["path"] for one in files["files"]), *files["excluded"])}
    try:
        before = read_json(path) if path is not None else None
        there = list(before["input"]["files"]) if before is not None else []
        gone = [f for f in there if normalize("NFC", f["path"]) not in here]
        lost = [{key: f.get(key) for key in ("path", "points", "pulses")} for f in gone]
    except (DamagedError, OSError, KeyError, TypeError, AttributeError):
        return None
    if before is None:
        return None
    remarks = []
    if before.get("survey") != survey:
        remarks.append(f"the delivery before this one is of another survey, {before.get('survey')}: is --out right?")
    if lost:
        remarks.append(f"{lost_words(lost)} of the delivery before this one, and not found any more")
    return {"lost_sources": lost, "remarks": remarks}


def lost_words(lost: Sequence[Mapping[str, Any]]) -> str:
    """Sources in words, with what they held."""
    each = [f"{f['path']} ({f['points'] or f['pulses'] or 0:,} {'points' if f['points'] else 'pulses'})" for f in lost]
    return f"{first_few(each, NAMED)} {'is a source' if len(lost) == 1 else 'are sources'}"


def judge_sources(facts: Mapping[str, Any] | None, accepted: bool, where: object) -> None:
    """`QualityError` where a source of the delivery before is gone; nothing where the user accepts it."""
    lost = facts["lost_sources"] if facts else []
    refuse_unsound(
        [f"{lost_words(lost)} of it, and not found any more"] if lost else [],
        accepted,
        "sources of the delivery before are gone",
        where=f"{where}: survey.sources",
        expected="every file that was delivered before",
        do="put them back and run again; if they are to be left out, nothing is to be done",
        accept="the next delivery is held against this one (--accept-implausible says so at once)",
    )
