"""`fwclass info --waveforms`: chosen pulses as a picture and as tables, and what a vendor's returns miss."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.pulse_sample import outgoing_of
from fwclass.decompose.recorded_pulse import recorded_pulse
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.errors import ConfigError, InputError
from fwclass.graph.sources import StripSpan
from fwclass.publish.files import check_free, written_whole
from fwclass.publish.waveform_pictures import draw_waveforms
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import check_source
from fwclass.report.place_remarks import place_remarks
from fwclass.report.plausibility import strip_plausibility
from fwclass.report.plausibility_remarks import plausibility_remarks
from fwclass.report.pulse_picture import receiver_picture
from fwclass.single_file.strip import FileStrip, strip_of
from fwclass.single_file.waveforms.pictured import Shown, echo_facts, pulse_picture
from fwclass.single_file.waveforms.shown import WaveformView, see
from fwclass.store.unchanged import check_unchanged

STRONGEST = 20
"""Echoes without a vendor return that are listed."""

KINDS = ("brightest single", "most echoes", "weakest single", "echo the vendor lacks", "saturated", "kept without echo")
"""What a shown pulse stands for, in the order of the panels."""

SIX = 6
SEVERAL = ("a best fit", "a worst fit", "an unsure extra echo")
"""Kinds of which so many are shown, behind `KINDS`."""

SURE = 10.0
"""Standard errors of its highest echo from which a pulse may be one of the best or worst fits."""

MOST_PULSES = 30
"""Panels of one picture at most."""


def look(
    path: Path, pulses: tuple[int, ...], settings: tuple[str, ...], out: Path | None, overwrite: bool
) -> dict[str, Any]:
    """Fit the waveforms of a file, draw some of its pulses into `out`, and tell what was found.

    Parameters
    ----------
    pulses : numbers of the pulses to show, counted by first appearance in the file; empty shows a choice of telling
        ones, and counts the echoes of the whole file that no return of its vendor explains.
    settings : ``read.key=value``, ``pulse.key=value``, ``decompose.key=value``.
    out : PNG; None is ``<file>-waveforms.png`` in the current directory. The system's pulse is drawn beside it, into
        ``…-system-pulse.png``.

    Returns plain data for JSON, without NaN.

    `InputError`: the file cannot be read, has no waveforms, or has no such pulse. `ConfigError`: `out` exists or cannot
    be written, or too many pulses are asked for.
    """
    target = out if out is not None else Path(f"{path.stem}-waveforms.png")
    beside_it = target.with_name(f"{target.stem}-system-pulse.png")
    for picture in (target, beside_it):
        _refuse(picture, pulses, overwrite)
    read: ReadParams = conf.section("read", settings)
    params: DecomposeParams = conf.section("decompose", settings)
    with check_unchanged(path):
        source = open_source(path)
        if not source.has_waves:
            raise InputError(
                "the file has no waveforms", where=path, do="name a file with waveform packets (fwclass info)"
            )
        check_source(source, read)
        with strip_of(source, settings) as strip:
            pulse, noise, places = strip.pulse(), strip.noise(), strip.places()
            spans = strip.spans if not pulses else _with(strip.spans, pulses, path)
            inflation = float(noise["inflation"] or 1.0)
            views = (see(strip.waves(span), params, pulse, pulses, inflation) for span in spans)
            recorded = _recorded(strip, settings)
            chosen, counts = _named_pulses(views, pulses, pulse, path) if pulses else _telling(views, pulse)
            remarks = [] if pulses else _remarks(strip, noise, params)
    if not chosen:
        raise InputError(
            "no waveform of the file shows an echo",
            where=path,
            got="; ".join(remarks),
            do="draw some as they are (--pulse 0 --pulse 1), and see `fwclass info` for what is wrong",
        )
    heading = f"{path.name}: {'chosen' if pulses else 'telling'} pulses, {_pulse_words(pulse)}"
    drawn = (
        (target, draw_waveforms([p for p, _ in chosen], heading)),
        (beside_it, receiver_picture(pulse, recorded, places, path.name)),
    )
    for place, picture_bytes in drawn:
        with written_whole(place) as beside:
            beside.write_bytes(picture_bytes)
    shape = {"shape": pulse.shape, "fwhm_ns": pulse.fwhm, "shape_error": pulse.shape_error, "echoes": pulse.echoes}
    return _plain(
        {
            "path": path,
            "png": target,
            "pulse_png": beside_it,
            "system_pulse": shape,
            "noise": dict(noise),
            "places": {**(places or {}), "remarks": place_remarks([{"name": path.stem, "places": places}])},
            "plausibility": remarks,
            **counts,
            "pulses": [f for _, f in chosen],
        }
    )


def _remarks(strip: FileStrip, noise: Mapping[str, Any], params: DecomposeParams) -> list[str]:
    """What `decompose` would say of the file, but for how its echoes are placed."""
    for _ in strip.echoes(()):
        pass
    source = strip.source
    judged = strip_plausibility(
        *(source.path.stem, source.n_points, strip.counts(), noise, None, strip.faults(), source.n_records)
    )
    return plausibility_remarks([judged], params)


def _recorded(strip: FileStrip, settings: tuple[str, ...]) -> SystemPulse | None:
    """The outgoing pulse as the first waveforms of the file that have one show it; None without."""
    for span in strip.spans[:1]:
        waves = strip.waves(span)
        rows = np.flatnonzero(np.diff(waves.outgoing_offsets) > 0)
        if len(rows):
            return recorded_pulse(outgoing_of(waves, rows), conf.section("pulse", settings))
    return None


def _refuse(target: Path, pulses: tuple[int, ...], overwrite: bool) -> None:
    if target.suffix.lower() != ".png":
        raise ConfigError("the picture is a PNG", where=target, expected="a name that ends in .png", got=target.suffix)
    if not target.parent.is_dir():
        raise ConfigError("the picture's directory does not exist", where=target.parent, do="make it first")
    check_free(target, overwrite)
    if len(pulses) > MOST_PULSES:
        raise ConfigError("too many pulses", where="--pulse", expected=f"at most {MOST_PULSES}", got=len(pulses))


def _with(spans: Sequence[StripSpan], pulses: tuple[int, ...], path: Path) -> list[StripSpan]:
    """The spans that hold some of `pulses`."""
    last = max((s.span.first_pulse + s.span.n_pulses for s in spans), default=0) - 1
    for number in pulses:
        if not 0 <= number <= last:
            raise InputError("no such pulse", where=path, expected=f"0 to {last}", got=number)
    return [s for s in spans if any(0 <= p - s.span.first_pulse < s.span.n_pulses for p in pulses)]


def _named_pulses(
    views: Iterator[WaveformView], pulses: tuple[int, ...], system: SystemPulse, path: Path
) -> tuple[list[Shown], dict[str, Any]]:
    """The pulses asked for, in that order."""
    rows = {}
    for seen in views:
        for at, number in enumerate(seen.ids.tolist()):
            rows[number] = pulse_picture(seen, at, system)
    for number in pulses:
        if number not in rows:
            raise InputError(
                f"pulse {number} has no waveform that can be read", where=path, do="see `fwclass info` for the reason"
            )
    return [rows[number] for number in dict.fromkeys(pulses)], {}


def _telling(views: Iterator[WaveformView], system: SystemPulse) -> tuple[list[Shown], dict[str, Any]]:
    """One pulse of every kind that a user wants to see, and the figures of the whole file."""
    best: dict[str, tuple[float, Shown]] = {}
    many: dict[str, list[tuple[float, Shown]]] = {}
    rows: list[dict[str, Any]] = []
    waveforms = echoes = returns = missed = cropped = 0
    for seen in views:
        for why, score in _scores(seen).items():
            at = int(np.argmax(score)) if len(score) else -1
            if at >= 0 and score[at] > best.get(why, (-np.inf,))[0]:
                best[why] = (float(score[at]), pulse_picture(seen, at, system))
        for why, score in _scores_of_several(seen).items():
            least = many.get(why, [])[SIX - 1 :]
            top = np.argsort(-score, kind="stable")[:SIX]
            more = [(float(score[at]), at) for at in top.tolist() if score[at] > (least[0][0] if least else -np.inf)]
            some = [*many.get(why, []), *((value, pulse_picture(seen, at, system)) for value, at in more)]
            many[why] = sorted(some, key=lambda one: (-one[0], one[1][1]["pulse"]))[:SIX]
        new = np.flatnonzero(seen.missed)
        cropped += int((~seen.complete).sum())
        waveforms, echoes = waveforms + seen.waves.pulses.rows, echoes + len(seen.pulse)
        returns, missed = returns + len(seen.returns), missed + len(new)
        rows = sorted([*rows, *_listed(seen, new)], key=lambda r: (-r["rank"], r["pulse"]))[:STRONGEST]
    counts: dict[str, Any] = {"waveforms": waveforms, "echoes": echoes, "returns": returns, "unexplained": None}
    if returns:
        strongest = [{k: v for k, v in row.items() if k != "rank"} for row in rows]
        counts["unexplained"] = {
            "count": missed,
            "share": missed / max(echoes, 1),
            "incomplete_pulses": cropped,
            "strongest": strongest,
        }
    return _merge_reasons([*best.items(), *((why, one) for why in SEVERAL for one in many.get(why, ()))]), counts


def _merge_reasons(chosen: Sequence[tuple[str, tuple[float, Shown]]]) -> list[Shown]:
    """Every chosen pulse once, with all that it stands for."""
    order = (*KINDS, *SEVERAL)
    reasons: dict[int, list[str]] = {}
    pictures: dict[int, Shown] = {}
    for why, (_, shown) in sorted(chosen, key=lambda one: order.index(one[0])):
        reasons.setdefault(shown[1]["pulse"], []).append(why)
        pictures[shown[1]["pulse"]] = shown
    out = []
    for number, whys in reasons.items():
        picture, facts = pictures[number]
        why = ", ".join(whys)
        extra = [e["noise_chance"] for e in facts["echoes"] if e["missed"] and np.isfinite(e["noise_chance"])]
        extra = extra if SEVERAL[2] in whys else []
        subtitle = f"{why}: by noise with {max(extra):.1g}" if extra else f"{why}; {picture.subtitle}"
        out.append((replace(picture, subtitle=subtitle), {**facts, "why": why}))
    return out


def _scores_of_several(seen: WaveformView) -> dict[str, NDArray[np.float64]]:
    """As `_scores`, of the kinds of which several are shown."""
    n, fits = len(seen.ids), seen.fits
    surest, extra, misfit = np.full(n, -np.inf), np.full(n, -np.inf), np.full(n, -np.inf)
    significance = np.nan_to_num(seen.significance, nan=0.0)
    np.maximum.at(surest, seen.pulse, significance)
    known = np.flatnonzero(seen.missed & np.isfinite(seen.chance))
    np.maximum.at(extra, seen.pulse[known], seen.chance[known])
    np.maximum.at(misfit, seen.pulse, np.nan_to_num(fits.misfit[fits.row], nan=-np.inf))
    clear = (surest >= SURE) & np.isfinite(misfit)
    best, worst = np.where(clear, -misfit, -np.inf), np.where(clear, misfit, -np.inf)
    return dict(zip(SEVERAL, (best, worst, extra), strict=True))


def _scores(seen: WaveformView) -> dict[str, NDArray[np.float64]]:
    """How well every pulse stands for a kind; minus infinity where it is not of the kind."""
    n, fits = len(seen.ids), seen.fits
    count = np.bincount(seen.pulse, minlength=n)
    clipped = np.bincount(seen.pulse, (fits.flags & SATURATED) > 0, n)
    highest, clearest = np.full(n, -np.inf), np.full(n, -np.inf)
    np.maximum.at(highest, seen.pulse, fits.amplitude)
    significance = np.nan_to_num(seen.significance, nan=0.0)
    new = seen.missed
    np.maximum.at(clearest, seen.pulse[new], significance[new])
    vendor = np.bincount(seen.return_pulse, minlength=n) > 0
    ends = seen.waves.offsets[:-1]
    peak = np.zeros(n)
    if len(seen.waves.samples) and (np.diff(seen.waves.offsets) > 0).all():
        np.maximum.at(peak, seen.of_row, np.maximum.reduceat(seen.waves.samples, ends).astype(float))

    def only(score: NDArray, where: NDArray) -> NDArray[np.float64]:
        return np.where(where, score, -np.inf)

    scores = (
        only(highest, (count == 1) & (clipped == 0)),
        only(count.astype(float), count > 1),
        only(-highest, count == 1),
        only(clearest, vendor & np.isfinite(clearest)),
        only(highest, clipped > 0),
        only(peak, vendor & (count == 0)),
    )
    return dict(zip(KINDS, scores, strict=True))


def _listed(seen: WaveformView, echoes: NDArray[np.int64]) -> list[dict[str, Any]]:
    """The most significant of `echoes`."""
    strength = np.nan_to_num(seen.significance[echoes], nan=-1.0)
    top = echoes[np.argsort(-strength, kind="stable")[:STRONGEST]]
    time = seen.waves.pulses["gps_time"]
    return [
        {
            "pulse": int(seen.ids[seen.pulse[e]]),
            "gps_time": float(time[seen.fits.row[e]]),
            **echo_facts(seen, e),
            "rank": float(np.nan_to_num(seen.significance[e], nan=-1.0)),
        }
        for e in top.tolist()
    ]


def _pulse_words(pulse: SystemPulse) -> str:
    on = f"{pulse.outgoing:,} outgoing pulses" if pulse.outgoing else f"{pulse.echoes:,} echoes"
    kind = "Gaussian" if pulse.shape == "gaussian" else f"measured on {on}"
    return f"system's pulse {pulse.fwhm:.2f} ns ({kind})"


def _plain(value: Any) -> Any:
    """For JSON: no NaN, no infinity, no paths."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
