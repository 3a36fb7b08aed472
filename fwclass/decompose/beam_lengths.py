"""How far echoes lie off because of the lengths of their beam vectors: light goes as far in a nanosecond for every
pulse, so vectors that differ, by numbers of few digits or by a scale in a part of the file, move echoes along the beam
by their distance from the anchor."""

from __future__ import annotations

import math

import numpy as np

from fwclass.decompose.fitting import Fits
from fwclass.decompose.params import BeamLengthParams
from fwclass.decompose.placing import beams
from fwclass.units import METRES_PER_NS
from fwclass.waveforms import Waveforms


def uneven_echoes(sample: Waveforms, fits: Fits, params: BeamLengthParams) -> tuple[int, int]:
    """Echoes that the length of their beam vector moves by more than `moved` [m], and all that were asked, of
    `sample_runs`.

    A vector's length is held against those of the pulses before and behind, as one that walks along a scan line is
    sound, against the strip's median, and against light's way.
    """
    if len(fits.row) == 0:
        return 0, 0
    _, speed = beams(sample)
    number, middle = sample.pulses["pulse"].astype(np.int64), float(np.median(speed))
    unlike = np.abs(speed - METRES_PER_NS) - params.unlike * METRES_PER_NS
    wrong = np.maximum(np.abs(speed - middle) - params.walk * middle, unlike)
    follows = np.diff(number) == 1
    inner = np.flatnonzero(follows[:-1] & follows[1:]) + 1
    jump = (2.0 * speed[inner] - speed[inner - 1] - speed[inner + 1]) / math.sqrt(6.0)
    wrong[inner] = np.maximum(wrong[inner], np.abs(jump))
    after = np.abs(fits.time - sample.pulses["anchor_time"].astype(np.float64)[fits.row])
    return int((after * wrong[fits.row] > params.moved).sum()), len(fits.row)
