"""The survey's quality on one page: one HTML file without any link to the network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.errors import first_few, several
from fwclass.formats.epsg import epsg_of
from fwclass.publish.drawing import View
from fwclass.publish.figures import share_map
from fwclass.publish.files import write_page
from fwclass.publish.palette import RGB, css
from fwclass.publish.params import PublishParams
from fwclass.publish.qgis_style import HEIGHTS, STRIPS_APART
from fwclass.publish.quality_section import quality
from fwclass.publish.report import data_uri, environment, names_of, report_style
from fwclass.publish.sections import quantity

TEMPLATE = "quality.html.j2"
NAMED = 3
"""Sources that are named."""

NEAR: tuple[tuple[float, RGB], ...] = ((0.0, (33, 102, 172)), (0.5, (253, 219, 119)), (1.0, (178, 24, 43)))
"""Small differences are blue, large ones red."""


@dataclass(frozen=True)
class Picture:
    """A map: its title, what it shows, PNG, and its key from `low` to `high` in `unit`, colours left to right."""

    title: str
    what: str
    png: bytes
    low: str
    high: str
    unit: str
    ramp: str


def density_picture(values: NDArray[np.float32], view: View, params: PublishParams) -> Picture | None:
    """Map of pulses per m²; NaN where there is no echo, None where there is none at all."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return None
    low, high = (float(v) for v in np.percentile(finite, (2, 98)))
    high = max(high, low + 0.01)
    png = share_map(np.clip((values - low) / (high - low), 0, 1), view, params, HEIGHTS)
    text = "First echoes in every cell. What is white has no echo."
    return Picture("Pulse density", text, png, f"{low:.3g}", f"{high:.3g}", "pulses per m²", _gradient(HEIGHTS))


def difference_picture(values: NDArray[np.float32], view: View, params: PublishParams) -> Picture | None:
    """Map of the largest difference of two strips [m]; NaN where none are compared, None where none are at all."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return None
    high = max(STRIPS_APART, float(np.percentile(finite, 98)))
    png = share_map(np.clip(values / high, 0, 1), view, params, NEAR)
    text = "The largest difference in height of two strips, where both see one flat surface. White: no such place."
    return Picture("Differences of strips", text, png, "0", f"{100 * high:.3g}", "cm", _gradient(NEAR))


def _system(crs: CRS | None) -> str:
    if crs is None:
        return "in no known system"
    code = epsg_of(crs)
    return f"{crs.name} (EPSG:{code})" if code else str(crs.name)


def _gradient(ramp: Sequence[tuple[float, RGB]]) -> str:
    return ", ".join(f"{css(colour)} {100 * stop:g}%" for stop, colour in ramp)


def render_quality(
    summary: Mapping[str, Any],
    pictures: Sequence[Picture],
    version: str,
    path: Path,
    crs: CRS | None = None,
    files: Sequence[str] = (),
) -> None:
    """Write the page: styles inside, images as data, every text escaped.

    `summary`: what ``quality.json`` has (docs/quality.md). `crs`: the survey's, `files`: names of its sources.
    """
    density, strips = summary["density"], summary["strips"]
    facts = [
        ("echoes", quantity(summary["echoes"])),
        ("pulses per m²", f"{density['pulses']:.2f}" if density["pulses"] is not None else ""),
        ("strips", quantity(len(strips["strips"]))),
        ("strips apart, rms", f"{100 * strips['rms']:.1f} cm" if strips["rms"] is not None else ""),
        ("noise", f"{100 * summary['noise_share']:.2g} %" if summary["noise_share"] is not None else ""),
    ]
    page = environment().get_template(TEMPLATE)
    text = page.render(
        style=report_style(),
        survey=summary["survey"],
        version=version,
        facts=[f for f in facts if f[1]],
        surveyed=[
            ("coordinates", _system(crs)),
            *([("input", f"{several(len(files), 'file')}: {first_few(files, NAMED)}")] if files else []),
        ],
        names=names_of(files),
        quality=quality(summary),
        pictures=[{**vars(p), "uri": data_uri(p.png)} for p in pictures],
    )
    write_page(path, text)
