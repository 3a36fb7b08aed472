"""Which waveforms of a strip the system's pulse is estimated from."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fwclass.hashing import hashed
from fwclass.schema import Table
from fwclass.stage import Params
from fwclass.waveforms import RETURN_COLUMNS, Waveforms

FEWEST = 8
"""Echoes below which not even a width is believed."""


class PulseParams(Params):
    """Parameters of the estimate of the system's pulse; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    shape : ``gaussian`` or ``measured``, or ``auto``: measured where that predicts recorded echoes better.
    width : FWHM of the pulse [ns]; null: estimated.
    fallback_width : FWHM where nothing can be estimated [ns].
    sample, seed : waveforms of a strip that are looked at, about, and which.
    bright : least height of an echo that counts, in standard deviations of the noise.
    min_echoes, max_echoes : fewer echoes give no shape; of more the surest are taken.
    isolation : share of an echo's height by which its waveform may rise again elsewhere.
    tail : longest time after the peak that the pulse is followed [ns].
    worth : least mean gain of chi-square, per echo that the shape was not made of, that a measured shape must bring.
    """

    shape: Literal["auto", "gaussian", "measured"]
    width: float | None = Field(gt=0.0)
    fallback_width: float = Field(gt=0.0)
    sample: int = Field(ge=1)
    seed: int = Field(ge=0)
    bright: float = Field(gt=0.0)
    min_echoes: int = Field(ge=FEWEST)
    max_echoes: int = Field(ge=FEWEST)
    isolation: float = Field(gt=0.0, lt=1.0)
    tail: float = Field(ge=0.0, le=1000.0)
    worth: float = Field(ge=0.0)


def sample_pulses(waves: Waveforms, strip: int, n_pulses: int, params: PulseParams) -> Waveforms:
    """The waveforms of `waves` that fall into the sample of their strip, without returns.

    A hash of (strip, pulse) decides, so that cutting into chunks cannot matter.

    Parameters
    ----------
    waves : any part of a strip.
    strip : its index in the survey.
    n_pulses : pulses of the whole strip.
    """
    pulse = waves.pulses["pulse"].astype(np.uint64)
    chosen = np.ones(len(pulse), np.bool_)
    if n_pulses > params.sample:
        key = (np.uint64(strip) << np.uint64(40)) | (pulse << np.uint64(8))
        chosen = hashed(params.seed, key) < np.uint64(int(params.sample / n_pulses * 2.0**64))
    return rows_of(waves, np.flatnonzero(chosen))


def join_samples(parts: Iterable[Waveforms]) -> Waveforms:
    """Samples of several chunks as one, without returns and outgoing pulses, by (pulse, segment)."""
    kept = list(parts)
    if not kept:
        raise ValueError("nothing to join")
    lengths = np.concatenate([np.diff(part.offsets) for part in kept])
    whole = Waveforms(
        Table.concat([part.pulses for part in kept]),
        Table.empty(RETURN_COLUMNS),
        np.concatenate([part.samples[part.offsets[0] : part.offsets[-1]] for part in kept]),
        np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
    )
    return rows_of(whole, np.lexsort((whole.pulses["segment_start"], whole.pulses["pulse"])))


def rows_of(waves: Waveforms, rows: NDArray) -> Waveforms:
    """Waveforms `rows` of `waves`, in that order, without returns and outgoing pulses."""
    length = np.diff(waves.offsets)[rows]
    offsets = np.concatenate([[0], np.cumsum(length)]).astype(np.int64)
    at = np.arange(offsets[-1]) + np.repeat(waves.offsets[rows] - offsets[:-1], length)
    return Waveforms(waves.pulses.take(rows), Table.empty(RETURN_COLUMNS), waves.samples[at], offsets)
