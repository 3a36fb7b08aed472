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


def describe(summary: Mapping[str, Any]) -> str:
    """The summary of `fwclass ground`."""
    units = summary["metres_per_unit"]
    total = summary["points"]
    rows = [
        ("input", summary["input"]),
        ("coordinates", summary["crs"]),
        *([("", "the filter works in metres")] if (units["xy"], units["z"]) != (1.0, 1.0) else []),
        ("points", f"{total:,}"),
        *[("", f"{n:,} {why}: kept, never ground") for why, n in summary["unusable"].items()],
        *(
            [("", f"{summary['left_out']:,} left out (withheld, synthetic, or noise that stays)")]
            if summary["left_out"]
            else []
        ),
        ("last returns", f"{summary['last_returns']:,}"),
        *_measured(summary["measured"]),
        ("filter", summary["method"] + (f", preset {summary['preset']}" if summary["preset"] else "")),
        *_wrap("parameters", ", ".join(parameters(summary["parameters"]))),
        ("ground", f"{summary['ground']:,} ({share(summary['ground'], total)})"),
        ("noise", f"{summary['noise']:,}"),
        ("seconds", _seconds(summary["seconds"])),
        *[("note", text) for text in summary["notes"]],
        ("written", summary["output"]),
        *([("", summary["waveforms"])] if summary["waveforms"] else []),
        *[("", facts["path"]) for facts in summary["rasters"].values()],
    ]
    return table(rows)


def _seconds(seconds: Mapping[str, float]) -> str:
    text = f"{seconds['all']:.1f}, of which {seconds['filter']:.1f} in the filter"
    if seconds["compiling"] < 1.0:
        return text
    return f"{text} and {seconds['compiling']:.1f} compiling for this machine, once"


def _wrap(name: str, text: str) -> list[tuple[str, str]]:
    lines = textwrap.wrap(text, WIDTH)
    return [(name if i == 0 else "", line) for i, line in enumerate(lines)]


def _measured(measures: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What ``--auto`` measured."""
    if not measures:
        return []
    lines = measured_table(Measured(**measures)).splitlines()
    return [("measured" if i == 0 else "", line) for i, line in enumerate(lines)]


def describe_heights(summary: Mapping[str, Any]) -> str:
    """The summary of `fwclass normalize`."""
    origin = f"found by {summary['method']}" if summary["method"] else "by the input's classes"
    spread = summary["heights_m"]
    span = "{least:.2f} to {greatest:.2f} m, median {median:.2f} m".format(**spread) if spread else "none"
    rows = [
        ("input", summary["input"]),
        ("coordinates", summary["crs"]),
        ("points", f"{summary['points']:,}"),
        ("ground", f"{summary['ground']:,} points {origin}"),
        ("heights", f"above {_ABOVE[summary['height']]}: {span}"),
        *_without(summary),
        ("seconds", f"{summary['seconds']['all']:.1f}"),
        *[("note", text) for text in summary["notes"]],
        ("written", summary["output"]),
        *([("", summary["waveforms"])] if summary["waveforms"] else []),
    ]
    return table(rows)


_ABOVE = {"tin": "the TIN of the ground", "nearest": "the nearest ground point", "raster": "the terrain raster"}


def _without(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Points that have no height, and what they got."""
    if not summary["without"]:
        return []
    text = summary["keep_z"] or not summary["output"].lower().endswith((".las", ".laz"))
    return [
        ("without terrain", f"{summary['without']:,} points, kept with {'no value' if text else 'z = -9999'}"),
        ("", f"no ground within {summary['max_gap']:g} m: --set terrain.max_gap=… reaches further"),
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
    """A share in percent, as text; "-" of nothing."""
    return f"{100 * part / whole:.1f} %" if whole else "-"


def table(rows: list[tuple[str, str]]) -> str:
    """Two columns; a row without a name goes on with the one above."""
    return "\n".join(f"{name:<16}{visible(text)}" for name, text in rows)
