"""Which echoes cannot be: far below all returns around, or after them and not to be told from the noise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose import belonging, odd_samples
from fwclass.decompose.envelope import Envelope
from fwclass.decompose.fitted_echoes import POOR
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.placing import beams
from fwclass.decompose.quiet import QuietNoise
from fwclass.decompose.water_column import BOTTOM
from fwclass.units import LAND
from fwclass.waveforms import IMPLAUSIBLE, Waveforms

_FITTED, _VENDOR_KEPT = 0, 16

COUNTS = (
    "fitted",
    "checked",
    "unexplained",
    "below",
    "outside",
    "weak",
    "implausible",
    "poor",
    "returns_without_echo",
    *odd_samples.COUNTS,
    *belonging.COUNTS,
    "off_earth",
)
"""What `Plausibility.counts` holds, in this order."""


@dataclass(frozen=True)
class Surroundings:
    """What a strip's echoes are held against: its returns, and its receiver's noise."""

    envelope: Envelope
    noise: QuietNoise


UNKNOWN = Surroundings(Envelope.nothing(1.0), QuietNoise(None, 1.0, 0))
"""Nothing to hold echoes against: all are plausible."""


@dataclass(frozen=True)
class Plausibility:
    """What became of a chunk's echoes.

    Attributes
    ----------
    implausible : bool (echoes,).
    counts : echoes by `COUNTS`. fitted: to waveforms; checked: of pulses all of whose returns are in the file;
        unexplained: of these, without a return of their pulse within `vendor_tolerance`; below, outside, weak: see
        `flag_implausible`; off_earth: at heights where no land is; implausible: below, weak or off_earth; poor: fitted,
        with a misfit above `poor_misfit`.
    """

    implausible: NDArray[np.bool_]
    counts: Mapping[str, int] = field(default_factory=dict)


def flag_implausible(
    echoes: Mapping[str, NDArray],
    to_return: NDArray[np.int64],
    waves: Waveforms,
    around: Surroundings,
    params: DecomposeParams,
) -> Plausibility:
    """Hold the fitted echoes of a chunk against the returns of their strip.

    An echo that a return of its pulse explains is plausible, and so is every echo of a pulse whose returns are not all
    in the file. Of the others implausible are those
    - `below`: more than `envelope_margin` below the lowest return around (`Envelope.below`);
    - `weak`: behind the last return of their pulse and its last echo that stands out, or above all returns of the
      strip, where the strip's noise is correlated by more than `white_noise` and the echo is lower than `detection`
      says for such noise,
    - `off_earth`: outside of `LAND`: times or directions have another unit.
    Pulses of a format without returns can only have weak ones. `outside`, more than `envelope_margin` above the highest
    or below the lowest return of the strip, is counted: leaves and wires that the vendor has not are there too.

    Parameters
    ----------
    echoes : columns of all echoes of the chunk, sorted by pulse.
    to_return : row of ``waves.returns`` that is nearest to every echo in its pulse, -1 where the pulse has none.
    """
    rows = len(echoes["pulse"])
    fitted = (echoes["origin"] == _FITTED) & (echoes["fit_flags"] & _VENDOR_KEPT == 0)
    if rows == 0 or waves.pulses.rows == 0 or not fitted.any():
        return Plausibility(np.zeros(rows, bool), dict.fromkeys(COUNTS, 0))
    returns, known = waves.returns, to_return >= 0
    complete = _complete(echoes["pulse"], returns["pulse"], returns["number_of_returns"]) & known
    checked = fitted & (complete if returns.rows else True)
    near = np.zeros(rows, bool)
    gap = sum((echoes[a][known] - returns[a][to_return[known]]) ** 2 for a in "xyz")
    near[known] = np.sqrt(gap) <= params.vendor_tolerance * beams(waves)[1].max()
    if "water" in echoes:
        near |= echoes["water"] == BOTTOM  # where the vendor has none, returns end at the surface
    alone = checked & ~near
    margin, envelope = params.envelope_margin, around.envelope
    with np.errstate(invalid="ignore"):
        below = alone & (echoes["z"] < envelope.below(echoes["x"], echoes["y"]) - margin)
        high = alone & (echoes["z"] > envelope.top + margin)
        outside = high | (alone & (echoes["z"] < envelope.bottom - margin))
    faint = _faint(echoes, fitted, around.noise, params)
    weak = alone & faint & (high | _last(echoes, ~faint, returns)) if faint.any() else faint
    off_earth = fitted & ((echoes["z"] < LAND[0]) | (echoes["z"] > LAND[1]))
    implausible = below | weak | off_earth
    poor = fitted & (echoes["fit_flags"] & POOR > 0)
    counted = (fitted, checked, alone & known, below, outside, weak, implausible, poor)
    counts = dict(zip(COUNTS, (int(c.sum()) for c in counted), strict=False))
    return Plausibility(implausible, {**counts, "off_earth": int(off_earth.sum())})


def add_counts(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    """Sum of the counts of several chunks."""
    whole = dict.fromkeys(COUNTS, 0)
    for one in counts:
        for name, n in one.items():
            whole[name] += n
    return whole


def renumber(echoes: Mapping[str, NDArray], implausible: NDArray[np.bool_]) -> dict[str, NDArray]:
    """Columns of `echoes`, (echoes,) each, for those that are `implausible`, bool (echoes,): the flag set, the class of
    a return taken away, and all echoes of a pulse numbered so that implausible ones come after the others, which do not
    count them: the last plausible echo of a pulse is its last."""
    if not implausible.any():
        return dict(echoes)
    flags = echoes["fit_flags"] | np.where(implausible, IMPLAUSIBLE, 0).astype(np.uint8)
    columns = {**echoes, "fit_flags": flags, "source_class": np.where(implausible, 0, echoes["source_class"])}
    order = np.lexsort((echoes["echo_number"], implausible, echoes["pulse"]))
    columns = {name: values[order] for name, values in columns.items()}
    hit, pulse = implausible[order], columns["pulse"]
    touched = np.isin(pulse, np.unique(pulse[hit]))
    first = np.concatenate([[True], pulse[1:] != pulse[:-1]])
    start = np.maximum.accumulate(np.where(first, np.arange(len(pulse)), 0))
    group = np.cumsum(first) - 1
    sound = np.bincount(group, weights=~hit).astype(np.int64)[group]
    whole = np.bincount(group)[group]
    columns["echo_number"] = np.where(touched, np.arange(len(pulse)) - start + 1, columns["echo_number"])
    columns["number_of_echoes"] = np.where(touched, np.where(hit, whole, sound), columns["number_of_echoes"])
    return columns


def _complete(pulse: NDArray, of_return: NDArray, declared: NDArray) -> NDArray[np.bool_]:
    """For every echo's pulse, whether the file has as many returns of it as they declare."""
    if len(of_return) == 0:
        return np.zeros(len(pulse), bool)
    ids, group, count = np.unique(of_return, return_inverse=True, return_counts=True)
    most = np.zeros(len(ids), np.int64)
    np.maximum.at(most, group, declared.astype(np.int64))
    at = np.minimum(np.searchsorted(ids, pulse), len(ids) - 1)
    return np.asarray((ids[at] == pulse) & (count >= most)[at])


def _faint(
    echoes: Mapping[str, NDArray], fitted: NDArray[np.bool_], noise: QuietNoise, params: DecomposeParams
) -> NDArray[np.bool_]:
    """Fitted echoes that correlated noise makes too."""
    if noise.lag1 is None or noise.lag1 <= params.white_noise:
        return np.zeros(len(fitted), bool)
    with np.errstate(invalid="ignore"):
        return np.asarray(fitted & (echoes["amplitude_db"] < 10.0 * np.log10(noise.inflation)))


def _last(
    echoes: Mapping[str, NDArray], strong: NDArray[np.bool_], returns: Mapping[str, NDArray]
) -> NDArray[np.bool_]:
    """Echoes behind every return, and behind every `strong` echo, of their pulse."""
    place = np.stack([echoes[a] for a in "xyz"], axis=1)
    beam = np.stack([echoes[f"beam_{a}"] for a in "xyz"], axis=1).astype(np.float64)
    ids, group = np.unique(echoes["pulse"], return_inverse=True)
    centre, axis = np.zeros((len(ids), 3)), np.zeros((len(ids), 3))
    centre[group], axis[group] = place, np.where(np.isfinite(beam), beam, 0.0)
    last = np.full(len(ids), -np.inf)
    along = ((place - centre[group]) * axis[group]).sum(axis=1)
    np.maximum.at(last, group[strong], along[strong])
    at = np.minimum(np.searchsorted(ids, returns["pulse"]), len(ids) - 1)
    mine = ids[at] == returns["pulse"]
    back = np.stack([returns[a] for a in "xyz"], axis=1)[mine] - centre[at[mine]]
    np.maximum.at(last, at[mine], (back * axis[at[mine]]).sum(axis=1))
    return np.asarray(along > last[group])
