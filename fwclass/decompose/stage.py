"""Decomposition: the waveforms of a span to its echoes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.belonging import belonging
from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.fitting import fit_waveforms
from fwclass.decompose.matching import nearest_of_pulse, rank_in_pulse
from fwclass.decompose.odd_samples import late_waveforms, odd_waveforms
from fwclass.decompose.params import BathymetryParams, DecomposeParams
from fwclass.decompose.placement import AS_STORED, Placement
from fwclass.decompose.placing import beams, detection_limits, from_anchor, origins_of
from fwclass.decompose.plausible import UNKNOWN, Surroundings, flag_implausible, renumber
from fwclass.decompose.recovery import recovered
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.decompose.water_column import place_water, with_water
from fwclass.grid import quantise
from fwclass.schema import Table
from fwclass.stage import Computation
from fwclass.units import AREA_PER_FWHM
from fwclass.waveforms import BATHYMETRY_COLUMNS, ECHO_COLUMNS, IMPLAUSIBLE, Waveforms

FITTED, KEPT, READ_AS_ECHO = 0, 1, 2
"""Values of `origin`."""

VENDOR_KEPT, FAR_FROM_VENDOR, UNFITTED = 16, 32, 64
"""Values of `fit_flags` beside those of `fitting`."""

LINK_COLUMNS = ("pulse", "echo_number")
MOST = 255
"""Echoes of a pulse at most, all its segments together: `echo_number` has one byte. Later ones are left out."""


def decompose(
    waves: Waveforms,
    strip: int,
    params: DecomposeParams,
    pulse: SystemPulse,
    around: Surroundings = UNKNOWN,
    placement: Placement = AS_STORED,
    bathymetry: BathymetryParams | None = None,
) -> tuple[Table, Table, dict[str, int]]:
    """Echoes of a span, and the echo that every return belongs to.

    Fitted echoes are placed along the beam from the anchor of their segment: P(t) = P_anchor + (anchor_time - t) step,
    see `placing`. A pulse whose waveforms show no echo, and every return without a usable packet, keeps its returns
    as echoes. Echoes of a file without waveforms have an energy relative to the vendor's detection limit where it
    gives amplitude [dB] and width. A pulse of a format without returns has echoes of class 0 and intensity 0.

    Parameters
    ----------
    waves : pulses, returns and samples of a span.
    strip : index of the source file in the survey.
    params : `DecomposeParams`.
    pulse : the system's pulse.
    around : what the echoes are held against, see `plausible`.
    placement : what the strip tells of its places.
    bathymetry : waveforms are tried for water; None: they are not.

    Returns
    -------
    echoes : `ECHO_COLUMNS`, with `bathymetry` also `BATHYMETRY_COLUMNS`, one row per echo in canonical order (pulse,
        echo_number).
    links : `LINK_COLUMNS`, one row per return, in file order: the nearest echo of its pulse.
    counts : `plausible.COUNTS`.
    """
    echoes = _echo_columns(waves, params, pulse, placement, bathymetry)
    returns = _return_columns(waves, echoes["pulse"])
    if bathymetry is not None:
        returns |= dict.fromkeys(("water_decay", "water_depth"), np.full(len(returns["pulse"]), np.nan))
        returns["water"] = np.zeros(len(returns["pulse"]), np.uint8)
    if len(returns["pulse"]):
        echoes = {name: np.concatenate([echoes[name], returns[name]]) for name in echoes}
        order = np.lexsort((echoes["echo_number"], echoes["pulse"]))
        echoes = {name: values[order] for name, values in echoes.items()}
    echoes, judged = _judge(echoes, waves, around, params)
    links = _tie(waves.returns, echoes)
    echoes["strip"] = np.full(len(echoes["pulse"]), strip)
    for axis in "xyz":
        echoes[axis] = quantise(echoes[axis])
    names = ECHO_COLUMNS if bathymetry is None else (*ECHO_COLUMNS, *BATHYMETRY_COLUMNS)
    table = Table({name: echoes[name] for name in names})
    own = table.take(_echo_of_return(table, links))
    measured = (own["origin"] == FITTED) & (own["fit_flags"] & (SATURATED | VENDOR_KEPT) == 0)
    lone = returns_without_echo(waves, table, links, params)
    odd = odd_waveforms(waves) | belonging(waves, own, measured)
    fitted = table["origin"] == FITTED
    late = late_waveforms(waves, pulse, {name: table[name][fitted] for name in ("pulse", "time")})
    return table, links, {**judged, "returns_without_echo": lone, **odd, "late": late}


def _judge(
    echoes: dict[str, NDArray], waves: Waveforms, around: Surroundings, params: DecomposeParams
) -> tuple[dict[str, NDArray], dict[str, int]]:
    """`echoes` with implausible and withheld ones flagged, class and intensity of the nearest return; the counts."""
    order = np.lexsort((waves.returns["return_number"], waves.returns["pulse"]))
    pulse = waves.returns["pulse"][order]
    nearest = np.empty(len(echoes["pulse"]), np.int64)
    nearest_of_pulse(echoes["pulse"], _places(echoes), pulse, _places(waves.returns)[order], nearest)
    row = np.where(nearest >= 0, order[nearest], -1) if len(order) else nearest
    for name in ("source_class", "intensity"):
        values = waves.returns[name]
        echoes[name] = np.where(row >= 0, values[row], 0) if len(values) else np.zeros(len(row), np.uint8)
    judged = flag_implausible(echoes, row, waves, around, params)
    if waves.returns["withheld"].any():
        withheld = (row >= 0) & waves.returns["withheld"][row]
        echoes["fit_flags"] = echoes["fit_flags"] | np.where(withheld, IMPLAUSIBLE, 0).astype(np.uint8)
    return renumber(echoes, judged.implausible), dict(judged.counts)


def _places(columns: Mapping[str, NDArray]) -> NDArray[np.float64]:
    return np.stack([columns[axis] for axis in "xyz"], axis=1)


def returns_without_echo(waves: Waveforms, echoes: Table, links: Table, params: DecomposeParams) -> int:
    """How many returns have no echo of their pulse within `vendor_tolerance`: weaker than the threshold, overlapped,
    or made of a receiver's ringing. `echoes` and `links` are what `decompose` gave for `waves`. Returns of water lie
    where their vendor takes light to go, and are not counted."""
    if links.rows == 0 or waves.pulses.rows == 0:
        return 0
    at = _echo_of_return(echoes, links)
    away = np.sqrt(sum((echoes[a][at] - waves.returns[a]) ** 2 for a in "xyz"))
    lone = away > params.vendor_tolerance * beams(waves)[1].max()
    return int((lone & (echoes["water"][at] == 0) if "water" in echoes else lone).sum())


def _echo_of_return(echoes: Table, links: Table) -> NDArray[np.int64]:
    """Row of the echo that every return is tied to."""
    keys = (echoes["pulse"].astype(np.int64) << 8) | echoes["echo_number"]
    return np.asarray(np.searchsorted(keys, (links["pulse"].astype(np.int64) << 8) | links["echo_number"]))


def _echo_columns(
    waves: Waveforms,
    params: DecomposeParams,
    pulse: SystemPulse,
    placement: Placement,
    bathymetry: BathymetryParams | None,
) -> dict[str, NDArray]:
    """Columns of the fitted echoes, by pulse and echo number."""
    waves, doubt = recovered(waves, params, pulse)
    fits = fit_waveforms(waves, params, pulse, doubt)
    if bathymetry is not None:
        fits, waters = with_water(fits, waves, params, pulse, bathymetry)
    row, pulses = fits.row, waves.pulses
    late, range_late = origins_of(waves, params, pulse, placement)
    after, far = from_anchor(fits, waves, late, params, placement)
    beam, speed = beams(waves)
    time = pulses["segment_start"].astype(np.float64)[row] + fits.time
    with np.errstate(divide="ignore"):
        decibels = 10.0 * np.log10(fits.amplitude / detection_limits(waves, params, pulse)[row])
    columns = {
        "pulse": pulses["pulse"][row],
        "origin": np.full(len(row), FITTED, np.uint8),
        "gps_time": pulses["gps_time"][row],
        "beam_range": pulses["anchor_range"][row] + (after + (late - range_late)[row]) * speed[row],
        "amplitude": fits.amplitude,
        "amplitude_db": decibels,
        "width": fits.width,
        "energy": fits.energy * pulses["gain"][row],
        "time": time,
        "amplitude_sigma": fits.amplitude_sigma,
        "width_sigma": fits.width_sigma,
        "range_sigma": fits.time_sigma * speed[row],
        "deviation": fits.deviation,
        "baseline": fits.baseline[row],
        "noise_level": fits.noise[row],
        "misfit": fits.misfit[row],
        "fit_flags": fits.flags | np.where(far, FAR_FROM_VENDOR, 0).astype(np.uint8),
    }
    for c, axis in enumerate("xyz"):
        columns[axis] = pulses[f"anchor_{axis}"][row] + (after * speed[row]) * beam[row, c]
        columns[f"beam_{axis}"] = beam[row, c]
    if bathymetry is not None:
        columns |= place_water(columns, waters, row, fits.time_sigma, after, speed[row], bathymetry)
    if (np.diff(pulses["pulse"].astype(np.int64)) <= 0).any():  # pulses of several segments
        order = np.lexsort((time, columns["pulse"]))
        columns = {name: values[order] for name, values in columns.items()}
    number, size = np.empty(len(row), np.int64), np.empty(len(row), np.int64)
    rank_in_pulse(columns["pulse"], number, size)
    columns |= {"echo_number": number, "number_of_echoes": np.minimum(size, MOST)}
    if size.max(initial=0) > MOST:
        columns = {name: values[number <= MOST] for name, values in columns.items()}
    return columns


def _return_columns(waves: Waveforms, alive: NDArray) -> dict[str, NDArray]:
    """Columns of the returns that are echoes themselves: of pulses not among `alive`."""
    table = waves.returns.take(np.flatnonzero(~_among(waves.returns["pulse"], alive)))
    table = table.take(np.lexsort((table["return_number"], table["pulse"])))
    n = table.rows
    rank, size = np.empty(n, np.int64), np.empty(n, np.int64)
    rank_in_pulse(table["pulse"], rank, size)
    amplitude = np.where(np.isnan(table["vendor_amplitude"]), table["intensity"], table["vendor_amplitude"])
    nothing = np.full(n, np.nan)
    unseen = table["has_packet"]
    undeclared = np.isnan(table["location"])
    origin = np.where(undeclared, READ_AS_ECHO, np.where(unseen, FITTED, KEPT))
    rank = np.where(undeclared, np.maximum(table["return_number"], 1), rank)
    size = np.where(undeclared, np.maximum(table["number_of_returns"], rank), size)
    energy = AREA_PER_FWHM * 10.0 ** (table["vendor_amplitude"].astype(np.float64) / 10.0) * table["vendor_width"]
    unknown = ("beam_range", "amplitude_sigma", "width_sigma", "range_sigma", "baseline", "noise_level", "misfit")
    columns = {
        **dict.fromkeys(unknown, nothing),
        "pulse": table["pulse"],
        "echo_number": rank,
        "number_of_echoes": size,
        "origin": origin,
        "gps_time": table["gps_time"],
        "amplitude": amplitude,
        "amplitude_db": table["vendor_amplitude"],
        "width": table["vendor_width"],
        "energy": np.where(undeclared, energy, np.nan),
        "deviation": table["vendor_deviation"],
        "time": np.where(unseen, table["location"], np.nan),
        "fit_flags": (np.where(unseen, VENDOR_KEPT, UNFITTED) | _saturation_flags(waves, table["pulse"])).astype(
            np.uint8
        ),
    }
    beam = np.full((n, 3), np.nan)
    if waves.pulses.rows:
        at = np.searchsorted(waves.pulses["pulse"], table["pulse"][unseen])
        beam[unseen] = beams(waves)[0][at]
    for c, axis in enumerate("xyz"):
        columns[axis] = table[axis]
        columns[f"beam_{axis}"] = beam[:, c]
    return columns


def _saturation_flags(waves: Waveforms, pulse: NDArray) -> NDArray[np.int64]:
    """Flag `SATURATED` of the pulses some of whose samples stand at the digitiser's limit."""
    rows = np.flatnonzero(np.diff(waves.offsets) > 0)
    if len(rows) == 0 or len(pulse) == 0:
        return np.zeros(len(pulse), np.int64)
    highest = np.maximum.reduceat(waves.samples[: waves.offsets[-1]], waves.offsets[rows])
    full = waves.pulses["pulse"][rows[highest >= waves.pulses["saturation"][rows]]]
    return np.where(_among(pulse, full), SATURATED, 0)


def _among(values: NDArray, known: NDArray) -> NDArray[np.bool_]:
    """Which of `values` occur in `known`; both are whole numbers of a narrow range."""
    if len(known) == 0 or len(values) == 0:
        return np.zeros(len(values), bool)
    low = int(min(values.min(), known.min()))
    present = np.zeros(int(max(values.max(), known.max())) - low + 1, bool)
    present[known - low] = True
    return np.asarray(present[values - low], bool)


def _tie(returns: Table, echoes: dict[str, NDArray]) -> Table:
    """Pulse and echo number of the echo nearest to every return in its pulse."""
    order = np.lexsort((returns["return_number"], returns["pulse"]))
    to_echo = np.empty(returns.rows, np.int64)
    nearest_of_pulse(returns["pulse"][order], _places(returns)[order], echoes["pulse"], _places(echoes), to_echo)
    number = np.empty(returns.rows, np.uint8)
    number[order] = echoes["echo_number"][to_echo]
    return Table({"pulse": returns["pulse"], "echo_number": number})


PULSE = Computation(name="pulse", version=23)
PLACES = Computation(name="places", version=16)
DECOMPOSE = Computation(name="decompose", version=21, writes=ECHO_COLUMNS)
