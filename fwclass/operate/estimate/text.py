"""What a survey will take in words, for a terminal."""

from __future__ import annotations

from fwclass.errors import several
from fwclass.operate.estimate.costs import density_known, too_dense
from fwclass.operate.estimate.forecast import Forecast
from fwclass.operate.estimate.headers import SourceFacts


def describe(forecast: Forecast) -> str:
    """What is planned; the stages below."""
    return "\n".join([*_head(forecast), "", *_stages(forecast), "", *_sizes(forecast), "", *_limits(forecast)])


def duration(seconds: float) -> str:
    """``45 s``, ``12 min``, ``3.5 h``, ``2.1 days``."""
    for limit, unit, name in ((90, 1, "s"), (5400, 60, "min"), (48 * 3600, 3600, "h")):
        if seconds < limit:
            value = seconds / unit
            return f"{value:.1f} {name}" if name == "h" else f"{value:.0f} {name}"
    return f"{seconds / 86400:.1f} days"


def volume(size: float) -> str:
    """Bytes in MB, GB or TB."""
    for limit, unit, name in ((1e9, 1e6, "MB"), (1e12, 1e9, "GB")):
        if size < limit:
            return f"{size / unit:,.1f} {name}"
    return f"{size / 1e12:,.1f} TB"


def _head(forecast: Forecast) -> list[str]:
    facts, counts, tiles, estimate = forecast.facts, forecast.counts, forecast.tiles, forecast.estimate
    workers = forecast.workers or "no"
    box = facts.box
    area = min((box.xmax - box.xmin) * (box.ymax - box.ymin), tiles.number * tiles.size**2) / 1e6
    number = several(len(facts.sources), "strip" if facts.simulated else "file")
    number += " still to be simulated" * facts.simulated
    pulses = f"{counts.pulses.sum():,.0f} pulses and " if any(s.waves for s in facts.sources) else ""
    lines = [
        f"survey      {forecast.config.survey.name}: {number}, {counts.points.sum():,.0f} points, "
        f"about {pulses}{counts.echoes.sum():,.0f} echoes on {area:,.2f} km²",
        f"tiles       {tiles.number:,} of {tiles.size:g} m, each with {forecast.halo:g} m of its neighbours; "
        f"{tiles.counts.sum() / max(1, tiles.number):,.0f} echoes on average, "
        f"{tiles.counts.max() * forecast.crowding:,.0f} in the fullest",
        f"memory      {estimate.largest.memory_mib:,.0f} MiB in a worker at most ({estimate.largest.name})",
        f"disk        {volume(estimate.bytes)}, {volume(forecast.room.free)} free",
        f"time        {duration(estimate.wall)} with {workers} workers, {duration(estimate.seconds)} of "
        f"processor, and {duration(estimate.compile_seconds)} of compiling in a first run",
    ]
    if facts.sample:
        s = facts.sample
        lines.append(
            f"sampled     {s.points:,} points of {s.path.name}: {s.density:.2f} points/m² where it was flown "
            f"({s.even:.2f} by its header), {s.returns_per_pulse:.2f} returns a pulse"
        )
    if facts.sample and too_dense(forecast.config, facts):
        lines.append(
            f"dense       {density_known(facts):,.0f} points/m² in {facts.sample.path.name}: of so many few count in a "
            "neighbourhood (features.dense_echoes), and the report tells where; just below it features take longer "
            "than planned"
        )
    lines += [_places(s) for s in facts.sources if len(s.places) > 1]
    if forecast.measured:
        m = forecast.measured
        lines.append(
            f"dry run     {m.parts:,} parts in {duration(m.seconds)}, {m.peak_mib:,.0f} MiB at most; measured: "
            f"{', '.join(m.stages)}"
        )
    else:
        lines.append(
            "costs       from section `plan` of the configuration, measured on another survey; --dry-run N measures"
        )
    return lines


def _places(source: SourceFacts) -> str:
    """A file whose points lie in places far apart, as stray points do, and the smallest of them."""
    box, number = min(source.places, key=lambda p: p[1])
    return (
        f"far apart   {source.path.name}: its points lie in {len(source.places):,} places, {number:,.0f} of them at "
        f"x {box.xmin:.2f} to {box.xmax:.2f}, y {box.ymin:.2f} to {box.ymax:.2f}: stray points?"
    )


def _stages(forecast: Forecast) -> list[str]:
    lines = [f"{'stage':<16}{'parts':>10}{'time':>10}{'disk':>12}{'memory MiB':>12}"]
    for s in forecast.estimate.stages:
        lines.append(
            f"{s.name:<16}{s.amount.parts:>10,}{duration(s.seconds):>10}{volume(s.bytes):>12}{s.memory_mib:>12,.0f}"
        )
    if forecast.estimate.unknown:
        lines.append(f"without a number in section `plan`, so not counted: {', '.join(forecast.estimate.unknown)}")
    return lines


def _sizes(forecast: Forecast) -> list[str]:
    lines = [f"{'tile.size':<12}{'tiles':>12}{'time':>10}{'memory MiB':>12}"]
    for c in forecast.choices:
        marks = [] if c.fits else ["does not fit"]
        marks += [] if c.enough else ["too few for the workers"]
        marks += ["set"] if c.size == forecast.config.tile.size else []
        marks += ["proposed"] if c is forecast.best else []
        suffix = "  " + ", ".join(marks) if marks else ""
        lines.append(f"{c.size:<12g}{c.tiles:>12,}{duration(c.wall):>10}{c.memory_mib:>12,.0f}{suffix}")
    return lines


def _limits(forecast: Forecast) -> list[str]:
    return [f"{'fits' if limit.fits else 'DOES NOT FIT':<14}{limit.text}" for limit in forecast.limits]
