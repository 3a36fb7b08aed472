"""Features that a file cannot give: an error with the way out, or left out where that is asked for."""

from __future__ import annotations

from pathlib import Path

from fwclass.errors import ConfigError
from fwclass.features.params import Asked, is_feature
from fwclass.radiometry.stage import RADIOMETRY
from fwclass.schema import Table
from fwclass.single_file.features.names import Wanted

SHORT = 12
"""So many names are written out."""

_WHY = {
    "width": "no echo widths (no waveforms, nor the extra byte `Pulse width`)",
    "gps_time": "no times that tell which returns are of one pulse",
    "height_above_ground": "no ground (class 2, or --method)",
    **dict.fromkeys(("echo_number", "number_of_echoes"), "no echo numbers (a text has none)"),
    **dict.fromkeys(
        RADIOMETRY.writes, "no ranges (--trajectory, or --set radiometry.platform_altitude=METRES; and beams)"
    ),
}
"""What a file lacks that does not have a column."""


def given(
    asked: Wanted, table: Table, source: Path, skip: bool, later: frozenset[str] = frozenset()
) -> tuple[Wanted, dict[str, str]]:
    """The features that `table` can give; those that it cannot, with what it lacks. Columns `later` may still come.

    Raises
    ------
    ConfigError
        It cannot give one, and `skip` is not asked for; or none is left.
    """
    there = (set(table) | later) - ({"echo_number"} if "number_of_echoes" not in table else set())
    lost = {name: why for name in asked.names if (why := _lacks(name, there))}
    left = tuple(n for n in asked.names if n not in lost)
    if lost and (not skip or not left):
        reasons = dict.fromkeys(lost.values())
        told = "; ".join(f"{why}: {_listed([n for n in lost if lost[n] == why])}" for why in reasons)
        some = "add --skip-missing" + (f", or ask for --features {','.join(left)}" if len(left) <= SHORT else "")
        raise ConfigError(
            f"the file cannot give {len(lost)} of the {len(asked.names)} features",
            where=f"{source}, features of {asked.told}",
            got=told,
            do=some if left else "ask for other features: `fwclass features --list` shows all",
        )
    return Wanted(asked.told, left), lost


def _lacks(name: str, there: set[str]) -> str:
    """What feature `name` cannot be computed without, "" where nothing is missing."""
    reads = Asked.of([name]).reads if is_feature(name) else (name,)
    missing = [n for n in reads if n not in there]
    return _WHY.get(missing[0], f"no {missing[0]}") if missing else ""


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - SHORT} more" if len(names) > SHORT else ""
    return ", ".join(names[:SHORT]) + more
