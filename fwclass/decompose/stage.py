"""Decomposition: the waveforms of a chunk to its echoes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fwclass.decompose import pulse_fit
from fwclass.decompose.matching import nearest_of_pulse, rank_in_pulse
from fwclass.grid import quantised
from fwclass.schema import IDENTITY, Table
from fwclass.stage import Params, Stage
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

FITTED, KEPT, READ_AS_ECHO = 0, 1, 2
"""Values of `origin`."""

VENDOR_KEPT, FAR_FROM_VENDOR = 16, 32
"""Values of `fit_flags` beside those of `pulse_fit`."""

ECHO_COLUMNS = (
    *IDENTITY, "number_of_echoes", "origin", "x", "y", "z", "gps_time", "beam_x", "beam_y", "beam_z", "amplitude",
    "width", "time", "baseline", "misfit", "fit_flags", "source_class", "intensity",
)  # fmt: skip
LINK_COLUMNS = ("pulse", "echo_number")


class DecomposeParams(Params):
    """Parameters of the Gaussian decomposition; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    pulse_width : FWHM of the system's pulse as the receiver records it [ns].
    detection : least height of a peak after the matched filter, in standard deviations of the noise.
    split_gain : least drop of chi-square that pays for one more echo (three parameters).
    narrowest, widest : range of an echo's width, in pulse widths.
    separation : least distance of two echoes of a pulse [ns].
    max_echoes : echoes of a pulse at most.
    noise_floor : least standard deviation of the noise, from digitisation [DN].
    shape_error : how far the system's pulse departs from a Gaussian, as a share of its height.
    poor_misfit : reduced chi-square above which a fit is flagged poor.
    vendor_tolerance : a pulse without an echo this close to its anchor return is flagged [ns].
    register_within : the pulse is shifted so that the echo nearest to its anchor return falls on it, if they are this
        close [ns]; 0 trusts the stored return location. Without the outgoing pulse the location of some systems
        jitters by half a sample.
    tail_share, tail_reach : an echo lower than this share of an earlier one, up to this long after it [ns], is the
        receiver's ringing and is left out; a share of 0 keeps all.
    iterations, tolerance : end of the fit: steps, and gain of chi-square in one step.
    """

    pulse_width: float = Field(gt=0.0)
    detection: float = Field(gt=0.0)
    split_gain: float = Field(gt=0.0)
    narrowest: float = Field(gt=0.0, le=1.0)
    widest: float = Field(ge=1.0)
    separation: float = Field(ge=0.0)
    max_echoes: int = Field(ge=1, le=64)
    noise_floor: float = Field(gt=0.0)
    shape_error: float = Field(ge=0.0, lt=1.0)
    poor_misfit: float = Field(gt=0.0)
    vendor_tolerance: float = Field(gt=0.0)
    register_within: float = Field(ge=0.0)
    tail_share: float = Field(ge=0.0, lt=1.0)
    tail_reach: float = Field(ge=0.0)
    iterations: int = Field(ge=1)
    tolerance: float = Field(gt=0.0)


def decompose(waves: Waveforms, strip: int, params: DecomposeParams) -> tuple[Table, Table]:
    """Echoes of a chunk, and the echo that every return belongs to.

    Fitted echoes are placed relative to the pulse's anchor return: P(t) = P_anchor + (anchor_time - t) step, with
    the anchor time moved onto the nearest echo if that is within `register_within`. A pulse whose waveform shows no
    echo, and every return without a usable packet, keeps its returns as echoes.

    Parameters
    ----------
    waves : pulses, returns and samples of a chunk.
    strip : index of the source file in the survey.
    params : `DecomposeParams`.

    Returns
    -------
    echoes : `ECHO_COLUMNS`, one row per echo in canonical order (pulse, echo_number).
    links : `LINK_COLUMNS`, one row per return, in file order: the nearest echo of its pulse.
    """
    fitted, alive = _fitted(waves, params)
    kept = _kept(waves, alive)
    echoes = {name: np.concatenate([fitted[name], kept[name]]) for name in fitted}
    order = np.lexsort((echoes["echo_number"], echoes["pulse"]))
    echoes = {name: values[order] for name, values in echoes.items()}
    links = _tie(waves.returns, echoes)
    echoes["strip"] = np.full(len(order), strip)
    for axis in "xyz":
        echoes[axis] = quantised(echoes[axis])
    return Table({name: echoes[name] for name in ECHO_COLUMNS}), links


def fit_waveforms(waves: Waveforms, params: DecomposeParams) -> dict[str, NDArray]:
    """The fit alone: count (n,), values (n, max_echoes, 3: amplitude [DN], time [ns], FWHM [ns]), baseline, misfit,
    flags (n, max_echoes); rows are `waves.pulses`."""
    n, most = waves.pulses.rows, params.max_echoes
    settings = np.empty(pulse_fit.SETTINGS)
    settings[pulse_fit.PULSE_WIDTH] = params.pulse_width
    settings[pulse_fit.DETECTION] = params.detection
    settings[pulse_fit.SPLIT_GAIN] = params.split_gain
    settings[pulse_fit.NARROWEST] = params.narrowest
    settings[pulse_fit.WIDEST] = params.widest
    settings[pulse_fit.SEPARATION] = params.separation
    settings[pulse_fit.NOISE_FLOOR] = params.noise_floor
    settings[pulse_fit.SHAPE_ERROR] = params.shape_error
    settings[pulse_fit.POOR_MISFIT] = params.poor_misfit
    settings[pulse_fit.ITERATIONS] = params.iterations
    settings[pulse_fit.TOLERANCE] = params.tolerance
    settings[pulse_fit.TAIL_SHARE] = params.tail_share
    settings[pulse_fit.TAIL_REACH] = params.tail_reach
    result: dict[str, NDArray] = {
        "count": np.zeros(n, np.int64),
        "values": np.full((n, most, 3), np.nan),
        "baseline": np.full(n, np.nan),
        "misfit": np.full(n, np.nan),
        "flags": np.zeros((n, most), np.uint8),
    }
    length = int(np.diff(waves.offsets).max(initial=0))
    pulse_fit.fit_all(
        waves.samples, waves.offsets, waves.pulses["sample_spacing"].astype(np.float64),
        waves.pulses["saturation"].astype(np.float64), settings, most, length, result["count"], result["values"],
        result["baseline"], result["misfit"], result["flags"],
    )  # fmt: skip
    return result


def _fitted(waves: Waveforms, params: DecomposeParams) -> tuple[dict[str, NDArray], NDArray]:
    """Columns of the fitted echoes, and the pulses that have some."""
    result = fit_waveforms(waves, params)
    count, pulses = result["count"], waves.pulses
    row, place = np.nonzero(np.arange(params.max_echoes) < count[:, None])
    amplitude, time, width = (result["values"][row, place, c] for c in range(3))
    step = np.stack([pulses[f"step_{axis}"] for axis in "xyz"], axis=1)
    flags = result["flags"][row, place]
    clear = (flags & pulse_fit.OVERLAPPING) == 0
    behind, gap = _behind_anchor(row, time, clear, pulses, params.register_within)
    far = np.where(gap[row] > params.vendor_tolerance, FAR_FROM_VENDOR, 0)
    columns = {
        "pulse": pulses["pulse"][row],
        "echo_number": place + 1,
        "number_of_echoes": count[row],
        "origin": np.full(len(row), FITTED, np.uint8),
        "gps_time": pulses["gps_time"][row],
        "amplitude": amplitude,
        "width": width,
        "time": time,
        "baseline": result["baseline"][row],
        "misfit": result["misfit"][row],
        "fit_flags": (flags | far).astype(np.uint8),
    }
    beam = -step / np.sqrt((step**2).sum(axis=1))[:, None]
    for c, axis in enumerate("xyz"):
        columns[axis] = pulses[f"anchor_{axis}"][row] + behind * step[row, c]
        columns[f"beam_{axis}"] = beam[row, c]
    return columns, pulses["pulse"][count > 0]


def _behind_anchor(
    row: NDArray, time: NDArray, clear: NDArray, pulses: Table, register_within: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How long before the anchor return every echo is [ns], and per pulse the distance of its nearest echo [ns].

    An echo that is not `clear` of others does not move its pulse: the vendor may have seen several as one.
    """
    behind = pulses["anchor_time"].astype(np.float64)[row] - time
    gap = np.full(pulses.rows, np.inf)
    np.minimum.at(gap, row, np.abs(behind))
    nearest = np.flatnonzero(np.abs(behind) == gap[row])
    shift = np.zeros(pulses.rows)
    shift[row[nearest[::-1]]] = (behind * clear)[nearest[::-1]]  # of two equally near ones the first is written last
    shift[gap > register_within] = 0.0
    return behind - shift[row], gap


def _kept(waves: Waveforms, alive: NDArray) -> dict[str, NDArray]:
    """Columns of the returns that are echoes themselves: of pulses not among `alive`."""
    table = waves.returns.take(~np.isin(waves.returns["pulse"], alive))
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
    columns = {
        "pulse": table["pulse"],
        "echo_number": rank,
        "number_of_echoes": size,
        "origin": origin,
        "gps_time": table["gps_time"],
        "amplitude": amplitude,
        "width": table["vendor_width"],
        "time": np.where(unseen, table["location"], np.nan),
        "baseline": nothing,
        "misfit": nothing,
        "fit_flags": np.where(unseen, VENDOR_KEPT, 0).astype(np.uint8),
    }
    at = np.searchsorted(waves.pulses["pulse"], table["pulse"])
    beam = _beams(waves.pulses, np.where(unseen, at, -1))
    for c, axis in enumerate("xyz"):
        columns[axis] = table[axis]
        columns[f"beam_{axis}"] = beam[:, c]
    return columns


def _beams(pulses: Table, row: NDArray) -> NDArray[np.float64]:
    """Unit vector from sensor to target of pulse rows; NaN for row -1."""
    step = np.stack([pulses[f"step_{axis}"] for axis in "xyz"], axis=1)
    beam = np.full((len(row), 3), np.nan)
    known = row >= 0
    chosen = step[row[known]]
    beam[known] = -chosen / np.sqrt((chosen**2).sum(axis=1))[:, None]
    return beam


def _tie(returns: Table, echoes: dict[str, NDArray]) -> Table:
    """Add `source_class` and `intensity` of the nearest return to `echoes`; the links of the returns."""
    order = np.lexsort((returns["return_number"], returns["pulse"]))
    pulse = returns["pulse"][order]
    places = np.stack([returns[axis][order] for axis in "xyz"], axis=1)
    targets = np.stack([echoes[axis] for axis in "xyz"], axis=1)
    to_return = np.empty(len(targets), np.int64)
    nearest_of_pulse(echoes["pulse"], targets, pulse, places, to_return)
    for name in ("source_class", "intensity"):
        echoes[name] = returns[name][order][to_return]
    to_echo = np.empty(len(places), np.int64)
    nearest_of_pulse(pulse, places, echoes["pulse"], targets, to_echo)
    number = np.empty(len(places), np.uint8)
    number[order] = echoes["echo_number"][to_echo]
    return Table({"pulse": returns["pulse"], "echo_number": number})


DECOMPOSE = Stage(
    name="decompose",
    version=1,
    kind="chunk",
    function=decompose,
    params=DecomposeParams,
    reads=tuple(dict.fromkeys((*PULSE_COLUMNS, *RETURN_COLUMNS))),
    writes=ECHO_COLUMNS,
)
