"""What the ground commands did, in words for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

from fwclass.errors import visible
from fwclass.ground.measure import Measured
from fwclass.ground.measure import table as measured_table

WIDTH = 92
"""Characters of a line beside its name."""


def describe(made: Mapping[str, Any]) -> str:
    """The summary of `fwclass ground`."""
    units = made["metres_per_unit"]
    total = made["points"]
    rows = [
        ("input", made["input"]),
        ("coordinates", made["crs"]),
        *([("", "the filter works in metres")] if (units["xy"], units["z"]) != (1.0, 1.0) else []),
        ("points", f"{total:,}"),
        *[("", f"{n:,} {why}: kept, never ground") for why, n in made["unusable"].items()],
        *(
            [("", f"{made['left_out']:,} left out (withheld, synthetic, or noise that stays)")]
            if made["left_out"]
            else []
        ),
        ("last returns", f"{made['last_returns']:,}"),
        *_measured(made["measured"]),
        ("filter", made["method"] + (f", preset {made['preset']}" if made["preset"] else "")),
        *_wrapped("parameters", ", ".join(parameters(made["parameters"]))),
        ("ground", f"{made['ground']:,} ({share(made['ground'], total)})"),
        ("noise", f"{made['noise']:,}"),
        ("seconds", _seconds(made["seconds"])),
        *[("note", text) for text in made["notes"]],
        ("written", made["output"]),
        *([("", made["waveforms"])] if made["waveforms"] else []),
        *[("", facts["path"]) for facts in made["rasters"].values()],
    ]
    return table(rows)


def _seconds(seconds: Mapping[str, float]) -> str:
    text = f"{seconds['all']:.1f}, of which {seconds['filter']:.1f} in the filter"
    if seconds["compiling"] < 1.0:
        return text
    return f"{text} and {seconds['compiling']:.1f} compiling for this machine, once"


def _wrapped(name: str, text: str) -> list[tuple[str, str]]:
    lines = textwrap.wrap(text, WIDTH)
    return [(name if i == 0 else "", line) for i, line in enumerate(lines)]


def _measured(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What ``--auto`` measured."""
    if not found:
        return []
    lines = measured_table(Measured(**found)).splitlines()
    return [("measured" if i == 0 else "", line) for i, line in enumerate(lines)]


def describe_heights(made: Mapping[str, Any]) -> str:
    """The summary of `fwclass normalize`."""
    found = f"found by {made['method']}" if made["method"] else "by the input's classes"
    spread = made["heights_m"]
    told = "{least:.2f} to {greatest:.2f} m, median {median:.2f} m".format(**spread) if spread else "none"
    rows = [
        ("input", made["input"]),
        ("coordinates", made["crs"]),
        ("points", f"{made['points']:,}"),
        ("ground", f"{made['ground']:,} points {found}"),
        ("heights", f"above {_ABOVE[made['height']]}: {told}"),
        *_without(made),
        ("seconds", f"{made['seconds']['all']:.1f}"),
        *[("note", text) for text in made["notes"]],
        ("written", made["output"]),
        *([("", made["waveforms"])] if made["waveforms"] else []),
    ]
    return table(rows)


_ABOVE = {"tin": "the TIN of the ground", "nearest": "the nearest ground point", "raster": "the terrain raster"}


def _without(made: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Points that have no height, and what they got."""
    if not made["without"]:
        return []
    text = made["keep_z"] or not made["output"].lower().endswith((".las", ".laz"))
    return [
        ("without terrain", f"{made['without']:,} points, kept with {'no value' if text else 'z = -9999'}"),
        ("", f"no ground within {made['max_gap']:g} m: --set terrain.max_gap=… reaches further"),
    ]


def parameters(values: Mapping[str, Any], before: str = "") -> list[str]:
    """``name value`` of every parameter, with its section's name before it."""
    out = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            if name != "noise":
                out += parameters(value, f"{before}{name}.")
        elif value is not None:
            out.append(f"{before}{name} {value:g}" if isinstance(value, float) else f"{before}{name} {_plain(value)}")
    return out


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "/".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "-"


def table(rows: list[tuple[str, str]]) -> str:
    """Two columns; a row without a name goes on with the one above."""
    return "\n".join(f"{name:<16}{visible(text)}" for name, text in rows)
