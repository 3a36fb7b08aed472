"""Parameters of the decomposition."""

from __future__ import annotations

from pydantic import Field

from fwclass.stage import Params


class DecomposeParams(Params):
    """Parameters of the fit and of placing its echoes; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    detection : least height of a peak after the matched filter, in standard deviations of the noise.
    split_gain : least drop of chi-square that pays for one more echo (three parameters).
    narrowest, widest : range of an echo's width, in pulse widths.
    separation : least distance of two echoes of a pulse [ns].
    max_echoes : echoes of a waveform at most.
    noise_floor : least standard deviation of the noise, from digitisation [DN].
    poor_misfit : reduced chi-square above which a fit is flagged poor.
    vendor_tolerance : a pulse without an echo this close to its anchor return is flagged [ns].
    register_within : the pulse is shifted so that the echo nearest to its anchor return falls on it, if they are this
        close [ns]; 0 trusts the stored return location. Without the outgoing pulse the location of some systems
        jitters by half a sample.
    tail_share, tail_reach : an echo lower than this share of an earlier one, up to this long after it [ns], is the
        receiver's ringing and is left out; a share of 0 keeps all.
    iterations, tolerance : end of the fit: steps, and gain of chi-square in one step.
    """

    detection: float = Field(gt=0.0)
    split_gain: float = Field(gt=0.0)
    narrowest: float = Field(gt=0.0, le=1.0)
    widest: float = Field(ge=1.0)
    separation: float = Field(ge=0.0)
    max_echoes: int = Field(ge=1, le=64)
    noise_floor: float = Field(gt=0.0)
    poor_misfit: float = Field(gt=0.0)
    vendor_tolerance: float = Field(gt=0.0)
    register_within: float = Field(ge=0.0)
    tail_share: float = Field(ge=0.0, lt=1.0)
    tail_reach: float = Field(ge=0.0)
    iterations: int = Field(ge=1)
    tolerance: float = Field(gt=0.0)
