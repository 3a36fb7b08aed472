"""Colours of classes: as in maps of lidar surveys, told apart by colour-blind readers too."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

RGB = tuple[int, int, int]

BLANK: RGB = (255, 255, 255)
"""Where there is no data."""

BY_NAME: dict[str, RGB] = {
    "ground": (216, 180, 128),
    "low vegetation": (216, 244, 176),
    "medium vegetation": (82, 146, 98),
    "high vegetation": (24, 96, 52),
    "vegetation": (47, 125, 70),
    "building": (226, 92, 36),
    "water": (84, 172, 228),
    "artificial": (112, 60, 150),
    "bridge": (90, 100, 115),
    "road": (120, 120, 120),
    "noise": (30, 30, 30),
    "unclassified": (190, 195, 200),
    "other": (150, 155, 165),
    "measured": (70, 120, 90),
    "interpolated": (240, 214, 140),
    "extrapolated": (200, 80, 60),
}
"""Lightness differs beside hue, so that the main classes stay apart without red-green vision and in grey."""

BY_CODE: dict[int, RGB] = {
    1: BY_NAME["unclassified"],
    2: BY_NAME["ground"],
    3: BY_NAME["low vegetation"],
    4: BY_NAME["medium vegetation"],
    5: BY_NAME["high vegetation"],
    6: BY_NAME["building"],
    7: BY_NAME["noise"],
    9: BY_NAME["water"],
    11: BY_NAME["road"],
    17: BY_NAME["bridge"],
    18: BY_NAME["noise"],
}
"""ASPRS codes (LAS 1.4 R15, table 17)."""

_SAME = {
    "tree": "vegetation",
    "trees": "vegetation",
    "buildings": "building",
    "roof": "building",
    "artificial objects": "artificial",
    "artificial object": "artificial",
}

SPARE: tuple[RGB, ...] = ((0, 158, 163), (196, 78, 140), (240, 196, 60), (86, 110, 190), (140, 86, 60))
"""For classes that neither name nor code gives a colour, in the order of the classes."""


def colours(classes: Iterable[Mapping[str, Any]]) -> dict[int, RGB]:
    """Colour per class code: by name, else by code, else the next spare one.

    `classes` is a list of ``{"name": …, "code": …}``.
    """
    out: dict[int, RGB] = {}
    spare = 0
    for item in classes:
        name, code = str(item["name"]).lower().replace("_", " "), int(item["code"])
        colour = BY_NAME.get(_SAME.get(name, name)) or BY_CODE.get(code)
        if colour is None:
            colour = SPARE[spare % len(SPARE)]
            spare += 1
        out[code] = colour
    return out


def css(colour: RGB) -> str:
    """A colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
