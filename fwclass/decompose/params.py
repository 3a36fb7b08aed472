"""Parameters of the system's pulse, of the decomposition, and of what it may give."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from fwclass.params import Params

FEWEST = 8
"""Echoes below which not even a width is believed."""


class CopyParams(Params):
    """When a receiver records every echo once more (`copies`); the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    waveforms, most_waveforms : of a bright echo, whose records reach a delay, that tell of a copy there.
    bright : height by which such an echo stands out, in standard deviations of the noise.
    behind, beside : distance of a copy from its echo at least, and of what it is held against from it, in pulse widths.
    least, sure : share of the echo's height by which a copy stands out of what is beside, and in standard errors.
    scatter : by how much of itself that share may differ between waveforms.
    highest : share that a copy has at most; what is higher is a second surface.
    most : delays of a channel.
    """

    waveforms: int = Field(ge=2, le=10_000_000)
    most_waveforms: int = Field(ge=2, le=10_000_000)
    bright: float = Field(gt=0.0, le=1e9)
    behind: float = Field(gt=0.0, le=1000.0)
    beside: float = Field(gt=0.0, le=1000.0)
    least: float = Field(ge=0.0, le=1.0)
    sure: float = Field(ge=0.0, le=1e9)
    scatter: float = Field(gt=0.0, le=1.0)
    highest: float = Field(gt=0.0, le=1.0)
    most: int = Field(ge=1, le=100)


class ParityParams(Params):
    """When samples of even and of odd number have two gains (`sample_parity`); the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    waveforms : bright ones of either kind, whose highest sample has an even or an odd number, that tell it.
    pieces : parts along a strip that are asked on their own.
    bright : sum of a waveform's samples, in standard deviations of its noise.
    ends : how far its first and last two samples may lie off the level, in standard deviations of its noise.
    least, most, sure : half the difference of both gains that is made good, at least, at most, in standard errors.
    alike, chance : share of it, or standard errors, by which what both kinds of waveforms tell may differ.
    """

    waveforms: int = Field(ge=2, le=10_000_000)
    pieces: int = Field(ge=1, le=1000)
    bright: float = Field(gt=0.0, le=1e9)
    ends: float = Field(gt=0.0, le=1e9)
    least: float = Field(ge=0.0, lt=1.0)
    most: float = Field(gt=0.0, lt=1.0)
    sure: float = Field(ge=0.0, le=1e9)
    alike: float = Field(ge=0.0, le=1.0)
    chance: float = Field(ge=0.0, le=1e9)


class BeamLengthParams(Params):
    """What lengths of beam vectors may be (`beam_lengths`); the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    moved : distance along the beam by which a length may move an echo [m].
    walk : share by which lengths may differ within a strip.
    unlike : share by which they may differ from light's way in air.
    """

    moved: float = Field(gt=0.0, le=1000.0)
    walk: float = Field(ge=0.0, le=1.0)
    unlike: float = Field(ge=0.0, le=1.0)


class PulseParams(Params):
    """Parameters of the estimate of the system's pulse; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    shape : ``gaussian`` or ``measured``, or ``auto``: measured where that predicts recorded echoes better.
    width : FWHM of the pulse [ns], which then is a Gaussian; null: estimated.
    fallback_width : FWHM where nothing can be estimated [ns].
    sample, seed : waveforms of a strip that are looked at, about, and which.
    bright : least height of an echo that counts, in standard deviations of the noise.
    min_echoes, max_echoes : fewer echoes give no shape; of more the surest are taken.
    isolation : share of an echo's height by which its waveform may rise again elsewhere.
    tail : time after the peak that the pulse is followed [ns]; up to four times as long where it still is not over.
    worth : least mean gain of chi-square, per echo that the shape was not made of, that a measured shape must bring.
    copies, parity : when echoes recorded once more, and two gains in turn, are taken off.
    """

    shape: Literal["auto", "gaussian", "measured"]
    width: float | None = Field(gt=0.0, le=1000.0)
    fallback_width: float = Field(gt=0.0, le=1000.0)
    sample: int = Field(ge=1, le=100_000_000)
    seed: int = Field(ge=0, lt=2**63)
    bright: float = Field(gt=0.0)
    min_echoes: int = Field(ge=FEWEST, le=10_000_000)
    max_echoes: int = Field(ge=FEWEST, le=10_000_000)
    isolation: float = Field(gt=0.0, lt=1.0)
    tail: float = Field(ge=0.0, le=1000.0)
    worth: float = Field(ge=0.0)
    copies: CopyParams
    parity: ParityParams

    @model_validator(mode="after")
    def _one_width(self) -> PulseParams:
        if self.width is not None and self.shape == "measured":
            raise ValueError("a measured shape has a width of its own: leave width out, or take shape: gaussian")
        return self


class DecomposeParams(Params):
    """Parameters of the fit and of placing its echoes; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    detection : least height of a peak after the matched filter, in standard deviations of the noise.
    further_detection : share of `detection` that is asked of further echoes of a waveform, where what bright single
        echoes leave under them is white noise alone; as much more, up to all of it, as they leave more
        (`Channel.misfit`).
    split_gain : least drop of chi-square that pays for one more echo (three parameters).
    narrowest, widest : range of an echo's width, in pulse widths.
    separation : least distance of two echoes of a pulse [ns].
    max_echoes : echoes of a waveform at most.
    noise_floor : least standard deviation of the noise, from digitisation [DN].
    poor_misfit : reduced chi-square above which a fit is flagged poor.
    vendor_tolerance : a pulse without an echo this close to its anchor return is flagged [ns].
    vendor_offset : ``auto``: what fitted times differ from the vendor's locations by over the whole strip, a constant
        and a curve over the echo's height, is taken off where returns show it; ``keep``: locations are taken as stored.
    offset_echoes : fewer echoes beside a return, of a channel of a strip, show nothing.
    outgoing_time : ``subtract`` or ``keep`` the time of a recorded outgoing pulse; ``auto``: what makes ranges smooth.
    register_within : in strips with too few returns to tell, the pulse is shifted so that the echo nearest to its
        anchor return falls on it, if they are this close [ns]. 0 shifts no pulse, not even where all the strip's
        locations lack the phase of the digitiser's clock, half a sample.
    tail_share, tail_reach : an echo lower than this share of an earlier one, up to this long after it [ns], is the
        receiver's ringing and is left out; a share of 0 keeps all.
    recovery : ``auto``: where saturated waveforms show that a receiver swings below its level behind them and comes
        back exponentially, that is taken off, and so is what is recorded of every echo once more; ``keep``: samples
        are taken as stored.
    envelope_cell, envelope_margin : an echo that no return explains is implausible this far below [m] the lowest return
        in the 3 x 3 cells of this edge [m] around it, or outside of the heights of the strip's returns by as much.
    white_noise : correlation of neighbouring quiet samples up to which noise counts as white; above it the last echoes
        of a pulse that no return explains must stand out of the noise as it is.
    iterations, tolerance : end of the fit: steps, and gain of chi-square in one step.
    beam_lengths : what is told of lengths of beam vectors.
    """

    detection: float = Field(gt=0.0)
    further_detection: float = Field(ge=0.5, le=1.0)
    split_gain: float = Field(gt=0.0)
    narrowest: float = Field(ge=0.05, le=1.0)
    widest: float = Field(ge=1.0, le=100.0)
    separation: float = Field(ge=0.0)
    max_echoes: int = Field(ge=1, le=64)
    noise_floor: float = Field(gt=0.0)
    poor_misfit: float = Field(gt=0.0)
    vendor_tolerance: float = Field(gt=0.0)
    vendor_offset: Literal["auto", "keep"]
    offset_echoes: int = Field(ge=8, le=10_000_000)
    outgoing_time: Literal["auto", "subtract", "keep"]
    register_within: float = Field(ge=0.0)
    tail_share: float = Field(ge=0.0, lt=1.0)
    tail_reach: float = Field(ge=0.0)
    recovery: Literal["auto", "keep"]
    envelope_cell: float = Field(ge=1.0, le=10_000.0)
    envelope_margin: float = Field(ge=0.0, le=10_000.0)
    white_noise: float = Field(ge=0.0, le=1.0)
    iterations: int = Field(ge=1, le=10_000)
    tolerance: float = Field(gt=0.0)
    beam_lengths: BeamLengthParams


class BathymetryParams(Params):
    """Parameters of water under green lasers: surface, column and bottom; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    enabled : waveforms are tried for water, and their echoes have `BATHYMETRY_COLUMNS`.
    refractive_index, group_index : of water, the one that bends the beam and the one that slows the light down.
    gain : least drop of chi-square that pays for water, beyond what both models' parameters cost
        (a third of `decompose.split_gain` each).
    least_decay, most_decay : of the column's light [1/ns of two-way time].
    least_depth : of a bottom, along the beam [m].
    """

    enabled: bool
    refractive_index: float = Field(ge=1.0, le=2.0)
    group_index: float = Field(ge=1.0, le=2.0)
    gain: float = Field(gt=0.0, le=1e6)
    least_decay: float = Field(gt=0.0, le=10.0)
    most_decay: float = Field(gt=0.0, le=10.0)
    least_depth: float = Field(gt=0.0, le=100.0)

    @model_validator(mode="after")
    def _range(self) -> BathymetryParams:
        if self.least_decay >= self.most_decay:
            raise ValueError("least_decay must be less than most_decay")
        return self


class PlausibilityParams(Params):
    """What a strip's echoes may be before the command ends with exit code 4; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    max_implausible : share of the echoes that returns could explain.
    max_unmatched_returns : share of the returns without an echo within `decompose.vendor_tolerance`.
    max_poor : share of the fitted echoes that fit poorly, misfit above `decompose.poor_misfit`.
    max_unreadable : share of the returns (of the pulses in a file without) whose waveform cannot be read.
    max_blank : share of the waveforms whose samples are all 0, or all at the digitiser's limit.
    max_downward : share of the waveforms whose echoes point downward.
    max_floored : share of the waveforms a quarter of whose samples are 0, as if their level had been taken off.
    max_swapped : share of the waveforms whose samples are smooth with their two bytes exchanged alone.
    max_doubled : share of the waveforms all of whose samples are there twice.
    max_stuck : share of the waveforms with a bit that never changes between such as do.
    max_late : share of the waveforms that begin behind the peak of an echo, which is lost.
    max_recurring : share of the waveforms with echoes that have one no scene makes: always as long behind the highest
        one and as high beside it, or always at one place of the record and as high.
    max_uneven : share of the echoes that the length of their beam vector moves.
    max_unlike : share of neighbouring returns the stronger of which has the lower echo.
    max_misplaced : share of neighbouring returns of one pulse that do not lie apart, along their beam, as their
        locations in time do.
    max_unsettled : share of the variance of bright echoes' samples by which the last two fits differ.
    max_repeated : share of the survey's echoes that have place and time of another.
    max_shared : share of a file's echoes that another file has too: as they are, or moved by less than half a metre.
    max_height_step : median step in height between files, or lines, that see one surface or lie beside each other [m].
    max_apart : distance from the nearest other file, beyond which few files of many are of another survey [m].
    coarse_places : step that all places of a file are multiples of [m].
    max_intensity_ratio : between the files' medians of single returns, where features of amplitude decide.
    max_uncounted : share of the classified echoes whose reference is a code that no class counts.
    max_on_halls : share of the ground that lies on things that look like halls.
    max_pits : share of the ground that lies in pits of one echo.
    sunken, max_sunken : so far below a given ground [m], more than this share of the points says that it is none.
    max_label_offset : that polygons or a cloud of labels are moved by to fit the echoes best [m].
    least : echoes, or returns, of that kind below which nothing is refused.
    accept : deliver all the same, and end as if nothing were wrong; it is still told.
    """

    max_implausible: float = Field(ge=0.0, le=1.0)
    max_unmatched_returns: float = Field(ge=0.0, le=1.0)
    max_poor: float = Field(ge=0.0, le=1.0)
    max_unreadable: float = Field(ge=0.0, le=1.0)
    max_blank: float = Field(ge=0.0, le=1.0)
    max_downward: float = Field(ge=0.0, le=1.0)
    max_floored: float = Field(ge=0.0, le=1.0)
    max_swapped: float = Field(ge=0.0, le=1.0)
    max_doubled: float = Field(ge=0.0, le=1.0)
    max_stuck: float = Field(ge=0.0, le=1.0)
    max_late: float = Field(ge=0.0, le=1.0)
    max_recurring: float = Field(ge=0.0, le=1.0)
    max_uneven: float = Field(ge=0.0, le=1.0)
    max_unlike: float = Field(ge=0.0, le=1.0)
    max_misplaced: float = Field(ge=0.0, le=1.0)
    max_unsettled: float = Field(ge=0.0, le=1.0)
    max_repeated: float = Field(ge=0.0, le=1.0)
    max_shared: float = Field(ge=0.0, le=1.0)
    max_height_step: float = Field(gt=0.0, le=1000.0)
    max_apart: float = Field(gt=0.0, le=40_000_000.0)
    coarse_places: float = Field(gt=0.0, le=1000.0)
    max_intensity_ratio: float = Field(gt=1.0, le=100_000.0)
    max_uncounted: float = Field(ge=0.0, le=1.0)
    max_on_halls: float = Field(ge=0.0, le=1.0)
    max_pits: float = Field(ge=0.0, le=1.0)
    sunken: float = Field(gt=0.0, le=10_000.0)
    max_sunken: float = Field(ge=0.0, le=1.0)
    max_label_offset: float = Field(gt=0.0, le=1000.0)
    least: int = Field(ge=0, le=1_000_000_000)
    accept: bool


class StackParams(Params):
    """Parameters of stacking pulses along the terrain; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    enabled : weak echoes are looked for, and the terrain is made once more with those of the ground.
    surfaces : along which: ``ground`` is the terrain, ``roof`` planes of strong echoes, ``water`` the level of the
        bodies in `water.file`.
    pulses, least : pulses that are added up at most and at least, the nearest ones in plan.
    radius : none is further from the middle one [m].
    gap : where a single pulse has shown the ground this close [m], nothing is looked for.
    window : the surface may be off by so much, up and down along the beam [m].
    clear : a pulse with an echo less than this above the surface, or below it, is not looked at [m].
    threshold : least height of the sum over its standard deviation.
    decoy : so far beneath the surface the same is tried where nothing can be [m], to tell how often noise does it.
    max_false : share of the echoes of a block that noise may have made; a higher threshold is taken for it.
    plane_residual : root mean square distance of a roof's echoes from their plane, at most [m].
    plane_reach : a roof is carried on no further from its strong echoes [m].
    """

    enabled: bool
    surfaces: tuple[Literal["ground", "roof", "water"], ...] = Field(min_length=1, max_length=3)
    pulses: int = Field(ge=2, le=49)
    least: int = Field(ge=2, le=49)
    radius: float = Field(gt=0.0, le=100.0)
    gap: float = Field(ge=0.0, le=100.0)
    window: float = Field(gt=0.0, le=20.0)
    clear: float = Field(ge=0.0, le=100.0)
    threshold: float = Field(gt=0.0)
    decoy: float = Field(gt=0.0, le=100.0)
    max_false: float = Field(ge=0.0, le=1.0)
    plane_residual: float = Field(gt=0.0, le=10.0)
    plane_reach: float = Field(gt=0.0, le=100.0)

    @model_validator(mode="after")
    def _apart(self) -> StackParams:
        if self.least > self.pulses:
            raise ValueError("least must not exceed pulses")
        if self.decoy < 2.0 * self.window:
            raise ValueError("decoy must be at least twice the window: else it sees the surface itself")
        return self


class SampleParams(Params):
    """Parameters of waveforms freed of the pulse; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    write : the samples are delivered as points.
    method : ``gold`` or ``richardson-lucy``.
    iterations : how often the ratio is taken; more are sharper, and make spikes of noise.
    threshold : a sample belongs to a signal that is so high, behind the matched filter, in standard deviations.
    least : lower ones are left out afterwards, in standard deviations of the noise.
    """

    write: bool
    method: Literal["gold", "richardson-lucy"]
    iterations: int = Field(ge=1, le=10_000)
    threshold: float = Field(ge=0.0)
    least: float = Field(ge=0.0, le=1000.0)
