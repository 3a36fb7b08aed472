"""What the terminal says of a survey's quality."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fwclass.assess.remarks import percent_words
from fwclass.errors import several
from fwclass.publish.quality_section import threshold_words
from fwclass.quality.strips import farthest_pair


def quality_lines(quality: Mapping[str, Any]) -> Iterator[str]:
    """Density, voids, strips, noise and coverage of a survey, a line each; `quality`: as ``quality.json`` has it."""
    density, voids, strips = quality["density"], quality["voids"], quality["strips"]
    if density["pulses"] is not None:
        p = density["percentiles"]
        yield (
            f"density     {density['pulses']:.2f} pulses per m², {density['echoes']:.2f} echoes; in 90 % of the cells "
            f"{p['p5']:.2f} to {p['p95']:.2f} pulses"
        )
    if voids["count"]:
        largest = f"the largest {voids['largest'][0]['area']:,.3g} m²"
        share = percent_words(voids["share"])
        yield f"voids       {voids['count']:,} from {voids['least']:.3g} m² on, {share} of the area; {largest}"
    else:
        yield f"voids       none from {voids['least']:.3g} m² on"
    yield f"strips      {_strips(strips)}"
    aside = farthest_pair(strips)
    if aside is not None:
        first, second = (strips["strips"][aside[k]]["name"] for k in ("first", "second"))
        offset = aside["offset"]
        apart = f"{100 * offset['distance']:.1f} ± {100 * offset['error']:.1f} cm apart at most"
        yield f"in plan     {apart}: {first} and {second}"
    if quality["noise_share"] is not None:
        yield f"noise       {percent_words(quality['noise_share'])} of the echoes ({quality['noise']:,})"
    if covered := quality["coverage"]:
        share = "no cell lies in it" if covered["share"] is None else percent_words(covered["share"])
        yield f"coverage    {share} of the area that was to be flown, {several(covered['gaps'], 'gap')}"


def threshold_lines(thresholds: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Whether each threshold that was asked for is met, a line each; `thresholds`: as ``report.json`` has them."""
    for one in thresholds:
        yield f"threshold   {one['what']}: {threshold_words(one)}"


def _strips(strips: Mapping[str, Any]) -> str:
    text = f"{len(strips['strips']):,} by {strips['by']}"
    if not strips["pairs"]:
        return f"{text}, nowhere compared"
    left = f", {100 * strips['left']:.1f} cm without their heights and tilts" if strips["left"] is not None else ""
    return (
        f"{text}, {100 * strips['rms']:.1f} cm apart in height (root mean square of {strips['pairs']:,} places){left}"
    )
