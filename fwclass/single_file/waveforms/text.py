"""What `fwclass info --waveforms` found, for a terminal."""

from __future__ import annotations

from typing import Any

from fwclass.decompose.quiet import NOISELESS
from fwclass.report.plausibility_remarks import PERIODIC, ROUNDED
from fwclass.report.pulse_remarks import descriptor_words


def describe(report: dict[str, Any]) -> str:
    """`look` for a terminal."""
    shape, lines = report["system_pulse"], [f"file         {report['path']}"]
    kind = "a Gaussian" if shape["shape"] == "gaussian" else f"measured on {shape['echoes']:,} echoes"
    lines.append(f"pulse        {shape['fwhm_ns']:.3f} ns wide, {kind}")
    if report["noise"]["lag1"] is not None:
        lines.append(f"noise        {_noise_words(report['noise'])}")
    elif report["noise"]["noise_still"] >= NOISELESS:
        lines.append(f"noise        none: {ROUNDED}")
    lines += [f"further      {text}" for text in further_words(report["noise"]["channels"])]
    steps = sorted({c["step"] for c in report["noise"]["channels"] if c["step"] > 1.0})
    lines += [f"samples      multiples of {step:g} DN, whose rounding counts as noise" for step in steps]
    lines += [f"places       {text}" for text in report["places"]["remarks"]]
    lines += [f"  ! {text}" for text in report["plausibility"]]
    if "waveforms" in report:
        lines.append(f"waveforms    {report['waveforms']:,} with {report['echoes']:,} echoes")
    for pulse in report["pulses"]:
        lines += ["", *_pulse_lines(pulse)]
    if report.get("unexplained"):
        lines += ["", *_missed_lines(report["unexplained"])]
    elif "waveforms" in report:
        lines += ["", "the file has no vendor returns to compare with"]
    return "\n".join([*lines, "", f"pictures     {report['png']}", f"             {report['pulse_png']}"])


def _noise_words(noise: dict[str, Any]) -> str:
    words = [f"neighbouring samples correlate by {noise['lag1']:.2f}"]
    if noise["noise_order"]:
        words.append(f"the fit takes the last {noise['noise_order']} into account")
    words.append(f"after the matched filter it is {noise['inflation']:.2f} times what the fit takes it for")
    if noise["noise_growth"]:
        words.append(f"its variance grows by {noise['noise_growth']:.3g} DN with every DN of signal")
    if noise["noise_periodic"] > PERIODIC:
        words.append(f"{noise['noise_periodic']:.0%} of it comes back every {noise['noise_period']} samples")
    return "; ".join(words)


def further_words(channels: list[dict[str, Any]]) -> list[str]:
    """Of every channel, how high further echoes of a waveform must be, and why."""
    lines = []
    for c in (c for c in channels if c["sample_spacing"] is not None):
        own = f", {descriptor_words(c['receivers'])}" if c["receivers"] else ""
        of = f"channel of {c['sample_spacing']:g} ns up to {c['saturation']:g} DN{own}: " if len(channels) > 1 else ""
        share = f"further echoes of a waveform need {c['further_detection']:.0%} of the threshold"
        why = "too few single ones are bright"
        if c["misfit"] is not None:
            why = f"single ones leave {c['misfit']:.2f} times the noise's variance"
        why += ", and the noise is correlated" * c["correlated"]
        lines.append(f"{of}{share}; {why}")
    return lines


def _pulse_lines(pulse: dict[str, Any]) -> list[str]:
    time = f"GPS time {pulse['gps_time']:.6f} s" if pulse["gps_time"] is not None else "no GPS time"
    head = f"pulse {pulse['pulse']}" + (f" ({pulse['why']})" if pulse["why"] else "") + f", {time}"
    level = f"baseline {_number(pulse['baseline'], 2)} DN, noise {_number(pulse['noise'], 2)} DN"
    lines = [head, f"  {pulse['samples']} samples, {level}, misfit {_number(pulse['misfit'], 2)}"]
    if not pulse["echoes"]:
        at = ", ".join(f"{t:.2f}" for t in pulse["returns"]) or "none"
        return [*lines, f"  no echo fitted; vendor returns at [ns]: {at}"]
    lines.append(f"  {'echo':>4} {'time [ns]':>17} {'height [DN]':>18} {'width [ns]':>15} {'A/σ':>7}  return")
    return lines + [f"  {k:>4} {_echo_words(e, bool(pulse['returns']))}" for k, e in enumerate(pulse["echoes"], 1)]


def _echo_words(echo: dict[str, Any], compared: bool) -> str:
    cells = [
        f"{_pair(echo['time'], echo['time_sigma'], 3):>17}",
        f"{_pair(echo['amplitude'], echo['amplitude_sigma'], 2):>18}",
        f"{_pair(echo['width'], echo['width_sigma'], 2):>15}",
        f"{_number(echo['significance'], 1):>7}",
    ]
    if echo["return"] is not None:
        back = f"{echo['return']} ({echo['from_return']:+.2f} ns)"
    else:
        by_noise = echo["noise_chance"]
        chance = "" if by_noise is None else f", noise makes one so high with {by_noise:.2g}"
        back = f"NONE OF THE VENDOR'S{chance}" if echo["missed"] else "none in the file" if compared else ""
    return " ".join(cells) + "  " + "; ".join(t for t in (back, ", ".join(echo["flags"])) if t)


def _missed_lines(missed: dict[str, Any]) -> list[str]:
    lines = [f"{missed['count']:,} echoes ({missed['share']:.1%}) are explained by no return of the vendor"]
    if missed["incomplete_pulses"]:
        lines.append(f"left out: {missed['incomplete_pulses']:,} pulses that lack returns in this file")
    if not missed["strongest"]:
        return lines
    lines += ["the strongest:", f"  {'pulse':>9} {'GPS time [s]':>18} {'time [ns]':>17} {'height [DN]':>18} {'A/σ':>7}"]
    lines[-1] += f" {'by noise':>9} {'nearest return [ns]':>20}  flags"
    for e in missed["strongest"]:
        lines.append(
            f"  {e['pulse']:>9} {_number(e['gps_time'], 6):>18} {_pair(e['time'], e['time_sigma'], 3):>17} "
            f"{_pair(e['amplitude'], e['amplitude_sigma'], 2):>18} {_number(e['significance'], 1):>7} "
            f"{_number(e['noise_chance'], 2, 'g'):>9} {_number(e['nearest_return'], 2):>20}  "
            f"{', '.join(e['flags'])}".rstrip()
        )
    return lines


def _number(value: float | None, digits: int, kind: str = "f") -> str:
    return "–" if value is None else f"{value:.{digits}{kind}}"


def _pair(value: float | None, sigma: float | None, digits: int) -> str:
    return f"{_number(value, digits)} ± {_number(sigma, digits)}"
