"""What `fwclass features` did, in words for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.errors import visible

MANY = 8
"""So many names are shown."""


def describe(made: Mapping[str, Any]) -> str:
    """The summary of `fwclass features`."""
    seconds = made["seconds"]
    compiling = f", {seconds['compiling']:.1f} of them compiling, once" if seconds["compiling"] >= 1.0 else ""
    lost = made["left_out"]
    empty = {n: c for n, c in made["without_value"].items() if c == made["echoes"]}
    echoes, features = _count(made["echoes"], "echo", "echoes"), _count(len(made["features"]), "feature")
    rows = [
        f"{visible(made['input'])}: {echoes}, {features} of {made['set']}",
        *made["notes"],
        f"neighbourhoods reach {made['reach']:g} m; {_count(made['tiles'], 'tile')}",
        *([f"LEFT OUT, {why}: {_names([n for n in lost if lost[n] == why])}" for why in dict.fromkeys(lost.values())]),
        *([f"WARNING: no echo has a value of {_names(list(empty))}"] if empty else []),
        f"{seconds['all']:.1f} s{compiling}",
        f"written: {visible(made['output'])} ({made['bytes'] / 1e6:.1f} MB)",
    ]
    return "\n".join(rows)


def _count(n: int, one: str, many: str = "") -> str:
    return f"{n:,} {one if n == 1 else many or f'{one}s'}"


def _names(names: list[str]) -> str:
    return ", ".join(names[:MANY]) + (f" and {len(names) - MANY} more" if len(names) > MANY else "")
