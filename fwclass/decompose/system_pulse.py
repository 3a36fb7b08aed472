"""The system's pulse: how the receiver records what a point-like target sends back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.autoregression import Autoregression
from fwclass.errors import InputError
from fwclass.units import FWHM_PER_SIGMA

DISAGREE = 1.15
"""From this ratio of two widths on, either way, one of the two is not the system's pulse."""

MOST_VALUES, MOST_CHANNELS, MOST_ORDER, MOST_RECEIVER, MOST_COPIES = 100_000, 64, 64, 255, 4096
"""Limits of a stored pulse."""


@dataclass(frozen=True)
class Channel:
    """What a receiver channel records without echoes.

    Attributes
    ----------
    sample_spacing : [ns], with `saturation` and `receivers` tells the channel.
    saturation : highest value that the digitiser can record [DN].
    baseline, baseline_sd : mean level of its waveforms, and how it differs between waveforms beyond the noise [DN].
    noise : standard deviation of the noise within a waveform, rounding included [DN].
    phi : how the noise of neighbouring samples hangs together, see `Autoregression`; empty: white.
    growth : what a DN of signal adds to the variance of the noise [DN].
    pulse : its own pulse, without channels; None: the strip's.
    clip : highest value that its samples reach [DN]: `saturation`, or less where the digitiser has fewer bits than
        its samples are stored in.
    freedom : how well `noise` holds for every single waveform, as the number of samples whose own estimate would be
        as good (the prior degrees of freedom of Smyth 2004); 0 says nothing.
    misfit : mean square of what bright single echoes leave under them over that of the noise beside them; 1 is a
        perfect model. None: not known.
    step : its samples are multiples of so many DN.
    recovery : time constant with which it comes back to its level behind saturated samples [ns]; 0: at once.
    recovery_depth : how far below its level it is right behind them, median [DN].
    recovery_doubt : how far the first samples behind them depart from that, as a share of the depth.
    parity : gain of samples of even number in their record over the mean of all, less 1: two digitisers in turn.
    copies : what it records of every echo once more: samples later, and share (`copies`).
    parity_walk : by how much that differs between quarters of the strip; 0: not surely.
    receivers : which it has of several that share spacing and saturation, and are not alike; empty: all the others.
    """

    sample_spacing: float
    saturation: float
    baseline: float
    baseline_sd: float
    noise: float
    freedom: float
    clip: float
    phi: tuple[float, ...] = ()
    growth: float = 0.0
    pulse: SystemPulse | None = None
    misfit: float | None = None
    step: float = 1.0
    recovery: float = 0.0
    recovery_depth: float = 0.0
    recovery_doubt: float = 0.0
    receivers: tuple[int, ...] = ()
    parity: float = 0.0
    parity_walk: float = 0.0
    copies: tuple[tuple[int, float], ...] = ()

    @property
    def special(self) -> bool:
        """Whether its waveforms are fitted otherwise than those of plain white noise and the strip's pulse."""
        return bool(self.phi) or self.growth > 0.0 or self.pulse is not None or self.misfit is not None

    def times(self, factor: float) -> Channel:
        """With its level and noise [DN] in a unit of which `factor` are one of theirs."""
        return replace(
            self, baseline=self.baseline * factor, baseline_sd=self.baseline_sd * factor, noise=self.noise * factor
        )

    @property
    def key(self) -> tuple[float, float, tuple[int, ...]]:
        """Sample spacing [ns], saturation [DN] and receivers, which tell channels apart."""
        return self.sample_spacing, self.saturation, self.receivers

    @property
    def copy_delays(self) -> list[list[float]]:
        """How long behind every echo it is recorded once more [ns], and what share of its height; one for neighbouring
        samples."""
        groups: list[list[tuple[int, float]]] = []
        for lag, share in self.copies:
            if groups and lag == groups[-1][-1][0] + 1:
                groups[-1].append((lag, share))
            else:
                groups.append([(lag, share)])
        sums = [(sum(share for _, share in g), sum(lag * share for lag, share in g)) for g in groups]
        return [[self.sample_spacing * moment / share, share] for share, moment in sums if share]

    @property
    def autoregression(self) -> Autoregression:
        """The correlation of the channel's noise, from one sample (index) to the next."""
        return Autoregression(self.phi)


@dataclass(frozen=True)
class SystemPulse:
    """Shape of the system's pulse, and its receiver.

    Attributes
    ----------
    shape : "gaussian" (only `fwhm` counts) or "measured" (`values` counts).
    fwhm : full width at half maximum [ns].
    first, step : time of ``values[0]`` after the peak, and between values [ns].
    values : height over time, 1 at the peak, 0 far from it.
    shape_error : root mean square departure of recorded pulses from `values`, as a share of their height.
    echoes : how many recorded echoes the shape stands on; 0: it was given, not measured.
    channels : the receiver's channels; may be empty.
    outgoing : the shape is that of so many recorded outgoing pulses, for the echoes show none.
    """

    shape: Literal["gaussian", "measured"]
    fwhm: float
    first: float = 0.0
    step: float = 0.0
    values: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    shape_error: float = 0.0
    echoes: int = 0
    channels: tuple[Channel, ...] = ()
    outgoing: int = 0

    @classmethod
    def gaussian(cls, fwhm: float, shape_error: float = 0.0) -> SystemPulse:
        """A Gaussian pulse of `fwhm` [ns]."""
        return cls("gaussian", fwhm, shape_error=shape_error)

    def at(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height at `time` [ns] after the peak; 0 outside of what is known."""
        if self.shape == "gaussian":
            return np.asarray(np.exp(-0.5 * (time * FWHM_PER_SIGMA / self.fwhm) ** 2))
        times = self.first + self.step * np.arange(len(self.values))
        return np.interp(time, times, self.values, left=0.0, right=0.0)

    @property
    def energy(self) -> float:
        """Integral of the squared pulse [ns]."""
        if self.shape == "measured":
            return float((self.values**2).sum() * self.step)
        return math.sqrt(math.pi) * self.fwhm / FWHM_PER_SIGMA

    def of(self, channel: Channel | None) -> SystemPulse:
        """The pulse that `channel` records."""
        return (channel and channel.pulse) or self

    def to_json(self) -> dict[str, Any]:
        """Numbers, texts and lists of them, as `from_json` takes them."""
        plain = {f.name: getattr(self, f.name) for f in fields(self)}
        return {**plain, "values": self.values.tolist(), "channels": [_channel_json(c) for c in self.channels]}

    @classmethod
    def from_json(cls, stored: Mapping[str, Any], where: object = "") -> SystemPulse:
        """A stored pulse, whoever wrote it.

        `InputError`: a key too few or too many, a number that is none or out of its range, too many values.
        """
        names = {f.name for f in fields(cls)}
        if not isinstance(stored, Mapping) or set(stored) != names:
            raise _refusal("other keys", where, sorted(names), _names(stored))
        if stored["shape"] not in ("gaussian", "measured"):
            raise _refusal("an unknown shape", where, "gaussian or measured", stored["shape"])
        pulse = cls(
            shape=stored["shape"],
            fwhm=_number(stored, "fwhm", where, 0.0, 1e4, above=True),
            first=_number(stored, "first", where, -1e6, 1e6),
            step=_number(stored, "step", where, 0.0, 1e4),
            values=_values(stored["values"], where),
            shape_error=_number(stored, "shape_error", where, 0.0, 1.0),
            echoes=int(_number(stored, "echoes", where, 0, 2**53)),
            outgoing=int(_number(stored, "outgoing", where, 0, 2**53)),
            channels=_channels(stored["channels"], where),
        )
        if pulse.shape == "measured":
            _check_values(pulse, where)
        return pulse


def disagree(fwhm: float, recorded: float | None) -> bool:
    """Whether a system pulse of `fwhm` [ns] is not the one that was `recorded` as it left; False where none was."""
    return recorded is not None and not recorded / DISAGREE <= fwhm <= recorded * DISAGREE


def _refusal(what: str, where: object, expected: object, got: object) -> InputError:
    return InputError(
        f"the stored system pulse has {what}",
        where=where,
        expected=expected,
        got=str(got)[:200],
        do="estimate it again, or use the file as it was written",
    )


def _names(stored: object) -> object:
    return sorted(map(str, stored)) if isinstance(stored, Mapping) else type(stored).__name__


def _number(
    stored: Mapping[str, Any], key: str, where: object, least: float, most: float, above: bool = False
) -> float:
    value = stored[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise _refusal(f"a {key} out of range", where, f"{least:g} to {most:g}", value)
    if above and value <= least:
        raise _refusal(f"a {key} out of range", where, f"above {least:g}", value)
    return float(value)


def _values(stored: object, where: object) -> NDArray[np.float64]:
    if not isinstance(stored, list) or len(stored) > MOST_VALUES:
        raise _refusal("values of another kind", where, f"a list of at most {MOST_VALUES}", type(stored).__name__)
    for v in stored:
        if isinstance(v, bool) or not isinstance(v, int | float) or not abs(v) <= 1.0 + 1e-6:
            raise _refusal("values out of range", where, "numbers from -1 to 1", v)
    return np.array(stored, np.float64)


def _check_values(pulse: SystemPulse, where: object) -> None:
    """A measured pulse rises to 1 at time 0 and lasts longer than its width."""
    n = len(pulse.values)
    if n < 8 or pulse.step <= 0.0:
        raise _refusal("too few values", where, "at least 8, with a step above 0", f"{n}, step {pulse.step:g}")
    last = pulse.first + (n - 1) * pulse.step
    if not (pulse.first < -0.5 * pulse.fwhm and last > 0.5 * pulse.fwhm):
        raise _refusal("values beside the peak", where, "its width around 0", f"{pulse.first:g} to {last:g} ns")
    top = int(pulse.values.argmax())
    if abs(pulse.values[top] - 1.0) > 1e-3 or abs(pulse.first + top * pulse.step) > pulse.step:
        raise _refusal("no peak at time 0", where, "1 at 0 ns", f"{pulse.values[top]:g}")


def _channels(stored: object, where: object) -> tuple[Channel, ...]:
    if not isinstance(stored, list) or len(stored) > MOST_CHANNELS:
        raise _refusal("channels of another kind", where, f"a list of at most {MOST_CHANNELS}", type(stored).__name__)
    names = {f.name for f in fields(Channel)}
    for one in stored:
        if not isinstance(one, Mapping) or set(one) != names:
            raise _refusal("a channel with other keys", where, sorted(names), _names(one))
    return tuple(
        Channel(
            sample_spacing=_number(one, "sample_spacing", where, 0.0, 1e6, above=True),
            saturation=_number(one, "saturation", where, 0.0, 2.0**32),
            baseline=_number(one, "baseline", where, -(2.0**32), 2.0**32),
            baseline_sd=_number(one, "baseline_sd", where, 0.0, 2.0**32),
            noise=_number(one, "noise", where, 0.0, 2.0**32),
            freedom=_number(one, "freedom", where, 0.0, 1e9),
            clip=_number(one, "clip", where, 0.0, 2.0**32),
            phi=_coefficients(one["phi"], where),
            growth=_number(one, "growth", where, 0.0, 2.0**32),
            pulse=_own_pulse(one["pulse"], where),
            misfit=None if one["misfit"] is None else _number(one, "misfit", where, 0.0, 1e300),
            step=_number(one, "step", where, 1.0, 2.0**16),
            recovery=_number(one, "recovery", where, 0.0, 1e6),
            recovery_depth=_number(one, "recovery_depth", where, 0.0, 2.0**32),
            recovery_doubt=_number(one, "recovery_doubt", where, 0.0, 1.0),
            receivers=_receivers(one["receivers"], where),
            parity=_number(one, "parity", where, -0.5, 0.5),
            parity_walk=_number(one, "parity_walk", where, 0.0, 1.0),
            copies=_copies(one["copies"], where),
        )
        for one in stored
    )


def _channel_json(channel: Channel) -> dict[str, Any]:
    plain = {f.name: getattr(channel, f.name) for f in fields(channel)}
    own = channel.pulse and channel.pulse.to_json()
    return {
        **plain,
        "phi": list(channel.phi),
        "receivers": list(channel.receivers),
        "copies": list(channel.copies),
        "pulse": own,
    }


def _own_pulse(stored: object, where: object) -> SystemPulse | None:
    if stored is None:
        return None
    if not isinstance(stored, Mapping) or stored.get("channels"):
        raise _refusal("a channel's pulse of another kind", where, "a pulse without channels", _names(stored))
    return SystemPulse.from_json(stored, where)


def _receivers(stored: object, where: object) -> tuple[int, ...]:
    if not isinstance(stored, list | tuple) or len(stored) > MOST_RECEIVER or not all(type(v) is int for v in stored):
        raise _refusal("receivers of another kind", where, f"at most {MOST_RECEIVER} whole numbers", stored)
    return tuple(stored)


def _copies(stored: object, where: object) -> tuple[tuple[int, float], ...]:
    if not isinstance(stored, list | tuple) or len(stored) > MOST_COPIES or not all(map(_is_copy, stored)):
        raise _refusal("copies of another kind", where, "pairs of samples later and a share", stored)
    return tuple((lag, share) for lag, share in stored)


def _is_copy(one: object) -> bool:
    if not isinstance(one, list | tuple) or len(one) != 2:
        return False
    lag, share = one
    return type(lag) is int and lag > 0 and type(share) is float and abs(share) < 1.0


def _coefficients(stored: object, where: object) -> tuple[float, ...]:
    if not isinstance(stored, list | tuple) or len(stored) > MOST_ORDER:
        raise _refusal("coefficients of another kind", where, f"at most {MOST_ORDER} numbers", type(stored).__name__)
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in stored)
    if not numbers or not Autoregression(tuple(stored)).stationary:
        raise _refusal("coefficients of no stationary noise", where, "partial correlations within -1 to 1", stored)
    return tuple(float(v) for v in stored)
