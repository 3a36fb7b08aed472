"""A plan in words, for a terminal."""

from __future__ import annotations

from fwclass.errors import several
from fwclass.operate.estimate.costs import density_known, too_dense
from fwclass.operate.estimate.headers import SourceFacts
from fwclass.operate.estimate.whole import Plan


def describe(plan: Plan) -> str:
    """What is planned; the stages below."""
    return "\n".join([*_head(plan), "", *_stages(plan), "", *_sizes(plan), "", *_limits(plan)])


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


def _head(plan: Plan) -> list[str]:
    facts, counts, tiles, estimate = plan.facts, plan.counts, plan.tiles, plan.estimate
    box = facts.box
    area = min((box.xmax - box.xmin) * (box.ymax - box.ymin), tiles.number * tiles.size**2) / 1e6
    number = several(len(facts.sources), "strip" if facts.simulated else "file")
    number += " still to be simulated" * facts.simulated
    pulses = f"{counts.pulses.sum():,.0f} pulses and " if any(s.waves for s in facts.sources) else ""
    lines = [
        f"survey      {plan.config.survey.name}: {number}, {counts.points.sum():,.0f} points, "
        f"about {pulses}{counts.echoes.sum():,.0f} echoes on {area:,.2f} km²",
        f"tiles       {tiles.number:,} of {tiles.size:g} m, each with {plan.halo:g} m of its neighbours; "
        f"{tiles.counts.sum() / max(1, tiles.number):,.0f} echoes on average, "
        f"{tiles.counts.max() * plan.crowding:,.0f} in the fullest",
        f"memory      {estimate.largest.memory_mib:,.0f} MiB in a worker at most ({estimate.largest.name})",
        f"disk        {volume(estimate.bytes)}, {volume(plan.room.free)} free",
        f"time        {duration(estimate.wall)} with {plan.workers or 'no'} workers, {duration(estimate.seconds)} of "
        f"processor, and {duration(estimate.compile_seconds)} of compiling in a first run",
    ]
    if facts.sample:
        s = facts.sample
        lines.append(
            f"sampled     {s.points:,} points of {s.path.name}: {s.density:.2f} points/m² where it was flown "
            f"({s.even:.2f} by its header), {s.returns_per_pulse:.2f} returns a pulse"
        )
    if facts.sample and too_dense(plan.config, facts):
        lines.append(
            f"dense       {density_known(facts):,.0f} points/m² in {facts.sample.path.name}: of so many few count in a "
            "neighbourhood (features.dense_echoes), and the report tells where; just below it features take longer "
            "than planned"
        )
    lines += [_places(s) for s in facts.sources if len(s.places) > 1]
    if plan.measured:
        m = plan.measured
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


def _stages(plan: Plan) -> list[str]:
    lines = [f"{'stage':<16}{'parts':>10}{'time':>10}{'disk':>12}{'memory MiB':>12}"]
    for s in plan.estimate.stages:
        lines.append(
            f"{s.name:<16}{s.amount.parts:>10,}{duration(s.seconds):>10}{volume(s.bytes):>12}{s.memory_mib:>12,.0f}"
        )
    if plan.estimate.unknown:
        lines.append(f"without a number in section `plan`, so not counted: {', '.join(plan.estimate.unknown)}")
    return lines


def _sizes(plan: Plan) -> list[str]:
    lines = [f"{'tile.size':<12}{'tiles':>12}{'time':>10}{'memory MiB':>12}"]
    for c in plan.choices:
        marks = [] if c.fits else ["does not fit"]
        marks += [] if c.enough else ["too few for the workers"]
        marks += ["set"] if c.size == plan.config.tile.size else []
        marks += ["proposed"] if c is plan.best else []
        suffix = "  " + ", ".join(marks) if marks else ""
        lines.append(f"{c.size:<12g}{c.tiles:>12,}{duration(c.wall):>10}{c.memory_mib:>12,.0f}{suffix}")
    return lines


def _limits(plan: Plan) -> list[str]:
    return [f"{'fits' if limit.fits else 'DOES NOT FIT':<14}{limit.text}" for limit in plan.limits]
