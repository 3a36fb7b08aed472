"""Pictures of waveforms and of the system's pulse as PNG; the same arrays give the same bytes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fwclass.publish.drawing import DPI, INK, PAPER, png
from fwclass.publish.wave_picture import WavePicture

SUM, ECHO, NEW, VENDOR, BAND = "#0072b2", "#d55e00", "#cc79a7", "#009e73", "#d5dbe1"
"""Colours of Okabe and Ito: told apart by colour-blind readers, and each with a line style or marker of its own."""

QUIET = "#8795a1"
"""Of frames, axes and what is not known."""

ACROSS = 3
PANEL = (4.3, 3.5)
"""Panels side by side at most, and the size of one [inches]."""

LONGEST = 100.0
"""A longer waveform is drawn around its echoes and returns alone [ns]."""

MARGIN = 30.0
"""Drawn before and after the echoes and returns of such a waveform [ns]."""

FOOT = 0.01
"""An echo's curve is drawn where it is above this share of its height."""

TAIL_ENLARGED = 20.0
"""Times that the second panel enlarges a pulse: it ends at 5 % of the peak, so that the tail is seen."""


def draw_waveforms(pictures: Sequence[WavePicture], heading: str) -> bytes:
    """Small multiples: per pulse its samples, fitted sum, echoes and vendor returns, and below the residual.

    Returns a PNG.
    """
    across = 2 if len(pictures) in (2, 4) else min(ACROSS, len(pictures))
    down = math.ceil(len(pictures) / across)
    wide, tall = max(across * PANEL[0], 1.6 * PANEL[0]), down * PANEL[1]
    top, bottom = 0.42, 0.46
    figure = Figure(figsize=(wide, tall + top + bottom), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    height = tall + top + bottom
    figure.text(0.1 / wide, 1 - 0.14 / height, heading, ha="left", va="top", fontsize=10, color=INK, weight="bold")
    for k, picture in enumerate(pictures):
        column, row = k % across, k // across
        cell = (column / across, (bottom + (down - 1 - row) * PANEL[1]) / height, 1 / across, PANEL[1] / height)
        _panel(figure, cell, picture)
    figure.legend(
        handles=_keys(),
        loc="lower center",
        ncol=7 if across > 2 else 4,
        frameon=False,
        fontsize=7.5,
        labelcolor=INK,
        bbox_to_anchor=(0.5, 0.0),
        handlelength=1.8,
        columnspacing=1.4,
        borderaxespad=0.3,
    )
    return png(figure)


def _panel(figure: Figure, cell: tuple[float, float, float, float], picture: WavePicture) -> None:
    left, low, wide, tall = cell
    width, height = figure.get_size_inches()
    x0, x1 = left + 0.56 / width, left + wide - 0.14 / width
    y0, y1 = low + 0.46 / height, low + tall - 0.5 / height
    split, gap = y0 + 0.27 * (y1 - y0), 0.09 / height
    main = figure.add_axes((x0, split + gap, x1 - x0, y1 - split - gap))
    rest = figure.add_axes((x0, y0, x1 - x0, split - y0), sharex=main)
    if len(picture.time):
        _record(main, picture)
        _residual(rest, picture)
        main.set_xlim(*_view(picture))
    else:
        main.text(0.5, 0.5, "no samples", transform=main.transAxes, ha="center", fontsize=7.5, color=QUIET)
    main.tick_params(labelbottom=False)
    main.set_ylabel("height [DN]", fontsize=7.5, color=INK)
    rest.set_ylabel("residual [DN]", fontsize=7.5, color=INK)
    rest.set_xlabel("time from the first sample [ns]", fontsize=7.5, color=INK, labelpad=2)
    for axes in (main, rest):
        axes.yaxis.set_label_coords(-0.38 / (width * (x1 - x0)), 0.5)
        _style(axes)
    at: dict[str, Any] = {"ha": "left", "va": "bottom", "color": INK}
    figure.text(x0, y1 + 0.2 / height, picture.title, fontsize=8, weight="bold", **at)
    figure.text(x0, y1 + 0.05 / height, picture.subtitle, fontsize=7, **at)


def _record(axes: Any, picture: WavePicture) -> None:
    """Samples, fit and returns."""
    axes.plot(picture.fine, picture.total, color=SUM, linewidth=1.6)
    for curve, new in zip(picture.curves, picture.new, strict=True):
        low, high = np.fmin.reduce(curve), np.fmax.reduce(curve)
        shown = np.where(curve - low > FOOT * (high - low), curve, np.nan)
        axes.plot(picture.fine, shown, color=NEW if new else ECHO, linewidth=1.1, dashes=(2, 1.5) if new else (4, 2))
    good = ~picture.clipped
    dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "zorder": 3}
    axes.plot(picture.time[good], picture.samples[good], color=INK, markersize=2.4, **dots)
    axes.plot(
        picture.time[~good], picture.samples[~good], markerfacecolor=PAPER, markeredgecolor=INK, markersize=3.4, **dots
    )
    known = [picture.samples, picture.total[np.isfinite(picture.total)]]
    low, high = min(v.min() for v in known if len(v)), max(v.max() for v in known if len(v))
    span = max(high - low, 1.0)
    axes.set_ylim(low - 0.06 * span, high + 0.2 * span)
    axes.plot(
        picture.vendor,
        np.full(len(picture.vendor), high + 0.14 * span),
        color=VENDOR,
        linestyle="none",
        marker="v",
        markersize=5,
        zorder=4,
    )
    axes.plot(
        picture.echoes[picture.new],
        picture.heights[picture.new] + 0.07 * span,
        color=NEW,
        linestyle="none",
        marker="*",
        markersize=6.5,
        zorder=4,
    )


def _residual(axes: Any, picture: WavePicture) -> None:
    rest = np.where(picture.clipped, np.nan, picture.samples - picture.model)
    band = 2 * picture.sigma
    axes.fill_between(picture.time, -band, band, color=BAND, linewidth=0, step="mid")
    axes.axhline(0, color=QUIET, linewidth=0.6)
    axes.plot(picture.time, rest, color=INK, linestyle="none", marker="o", markersize=1.9, zorder=3)
    most = max(np.nanmax(np.abs(rest), initial=0.0), np.nanmax(band, initial=0.0))
    most = 1.12 * most if np.isfinite(most) and most > 0 else 1.0
    axes.set_ylim(-most, most)
    if not np.isfinite(rest).any():
        axes.text(0.5, 0.5, "no fit", transform=axes.transAxes, ha="center", va="center", fontsize=7.5, color=QUIET)


def _view(picture: WavePicture) -> tuple[float, float]:
    """The part of the time axis to draw."""
    low, high = float(picture.time.min()), float(picture.time.max())
    if high - low > LONGEST:
        marks = np.concatenate([picture.echoes, picture.vendor])
        marks = marks[(marks >= low) & (marks <= high)]
        if len(marks):
            low, high = max(low, float(marks.min()) - MARGIN), min(high, float(marks.max()) + MARGIN)
    edge = max(0.02 * (high - low), 0.5)
    return low - edge, high + edge


def _style(axes: Any) -> None:
    axes.tick_params(labelsize=7, colors=INK, length=2.5, width=0.6)
    axes.grid(True, color="#eceff2", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.locator_params(axis="y", nbins=5)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(QUIET)
        spine.set_linewidth(0.7)


def _keys() -> list[Any]:
    dot: dict[str, Any] = {"linestyle": "none", "marker": "o"}
    return [
        Line2D([], [], color=INK, markersize=3, label="sample", **dot),
        Line2D([], [], markerfacecolor=PAPER, markeredgecolor=INK, markersize=4, label="saturated", **dot),
        Line2D([], [], color=SUM, linewidth=1.6, label="fitted sum"),
        Line2D([], [], color=ECHO, linewidth=1.0, dashes=(4, 2), label="echo"),
        Line2D([], [], color=NEW, linewidth=1.0, dashes=(2, 1.5), marker="*", label="echo without vendor return"),
        Line2D([], [], color=VENDOR, linestyle="none", marker="v", markersize=5, label="vendor return"),
        Patch(facecolor=BAND, label="±2σ of the noise"),
    ]


@dataclass(frozen=True)
class ReceiverPicture:
    """What is known of a receiver; arrays of its channels, each under a name.

    Attributes
    ----------
    title : line above.
    time, pulse, gaussian : [ns] after the peak; heights as shares of the peak's.
    recorded : likewise, the outgoing pulse as it was recorded; None where it was not.
    spectra : name, frequency [GHz] and power of the noise over that of white noise of its variance.
    offsets : name, height of echoes [DN] and how much later than the vendor's location they are [ns].
    """

    title: str
    time: NDArray[np.float64]
    pulse: NDArray[np.float64]
    gaussian: NDArray[np.float64]
    recorded: NDArray[np.float64] | None
    spectra: Sequence[tuple[str, NDArray[np.float64], NDArray[np.float64]]]
    offsets: Sequence[tuple[str, NDArray[np.float64], NDArray[np.float64]]]


def draw_receiver(picture: ReceiverPicture) -> bytes:
    """PNG of the system's pulse beside the recorded one, the spectrum of the noise, and the vendor's offset."""
    figure = Figure(figsize=(7.6, 5.9), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    panels = [figure.add_axes((left, low, 0.41, 0.34)) for low in (0.56, 0.08) for left in (0.075, 0.575)]
    limit = 1.0 / TAIL_ENLARGED
    for axes, (low, high) in zip(panels, ((-0.08, 1.08), (-0.6 * limit, 1.08 * limit)), strict=False):
        axes.axhline(0, color=QUIET, linewidth=0.6)
        axes.plot(
            picture.time, picture.gaussian, color=ECHO, linewidth=1.1, dashes=(4, 2), label="Gaussian of that width"
        )
        axes.plot(picture.time, picture.pulse, color=SUM, linewidth=1.5, label="system's pulse")
        if picture.recorded is not None:
            axes.plot(
                picture.time, picture.recorded, color=VENDOR, linewidth=1.1, dashes=(1, 1), label="recorded outgoing"
            )
        axes.set_xlim(float(picture.time.min()), float(picture.time.max()))
        axes.set_ylim(low, high)
    for axes, (across, up) in zip(panels, _RECEIVER, strict=True):
        axes.set_xlabel(across, fontsize=8, color=INK)
        axes.set_ylabel(up, fontsize=8, color=INK)
        _style(axes)
    for axes, curves, style in ((panels[2], picture.spectra, "-"), (panels[3], picture.offsets, "o-")):
        for (name, x, y), colour in zip(curves, (SUM, ECHO, VENDOR, NEW), strict=False):
            axes.plot(x, y, style, color=colour, linewidth=1.3, markersize=3.5, label=name)
        if not curves:
            axes.text(
                0.5, 0.5, "not known", ha="center", va="center", transform=axes.transAxes, fontsize=9, color=QUIET
            )
    panels[2].axhline(1.0, color=QUIET, linewidth=0.6, dashes=(4, 2))
    panels[3].axhline(0.0, color=QUIET, linewidth=0.6)
    if picture.offsets:
        panels[3].set_xscale("log")
        for axis in (panels[3].xaxis.set_major_formatter, panels[3].xaxis.set_minor_formatter):
            axis(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "125" else "")
    for axes in (panels[0], panels[2], panels[3]):
        if axes.get_legend_handles_labels()[1]:
            axes.legend(frameon=False, fontsize=7.0, labelcolor=INK, loc="best", borderaxespad=0.1)
    figure.text(0.075, 0.975, picture.title, ha="left", va="top", fontsize=10, color=INK, weight="bold")
    return png(figure)


_RECEIVER = (
    ("time after the peak [ns]", "height, share of the peak"),
    ("time after the peak [ns]", f"the same, {TAIL_ENLARGED:.0f} times enlarged"),
    ("frequency [GHz]", "power of the noise, over white"),
    ("height of the echo [DN]", "later than the vendor's place [ns]"),
)
"""Labels of the panels of `draw_receiver`."""


def draw_pulse(
    time: NDArray[np.float64], values: NDArray[np.float64], gaussian_values: NDArray[np.float64], title: str
) -> bytes:
    """The system's pulse beside a Gaussian of the same width: whole, and its foot enlarged.

    `time`: [ns] after the peak, shape (n,). `values`, `gaussian_values`: height as a share of the peak's, shape (n,).

    Returns a PNG.
    """
    figure = Figure(figsize=(7.6, 3.1), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    panels = [figure.add_axes((left, 0.16, 0.41, 0.66)) for left in (0.075, 0.575)]
    limit = 1.0 / TAIL_ENLARGED
    for axes, (low, high) in zip(panels, ((-0.08, 1.08), (-0.6 * limit, 1.08 * limit)), strict=True):
        axes.axhline(0, color=QUIET, linewidth=0.6)
        axes.plot(time, gaussian_values, color=ECHO, linewidth=1.1, dashes=(4, 2), label="Gaussian of that width")
        axes.plot(time, values, color=SUM, linewidth=1.5, label="system's pulse")
        axes.set_xlabel("time after the peak [ns]", fontsize=8, color=INK)
        axes.set_ylim(low, high)
        _style(axes)
        if len(time):
            axes.set_xlim(float(time.min()), float(time.max()))
    panels[0].set_ylabel("height, share of the peak", fontsize=8, color=INK)
    panels[1].set_ylabel(f"the same, {TAIL_ENLARGED:.0f} times enlarged", fontsize=8, color=INK)
    panels[0].legend(frameon=False, fontsize=7.5, labelcolor=INK, loc="upper right", borderaxespad=0.1)
    figure.text(0.075, 0.96, title, ha="left", va="top", fontsize=10, color=INK, weight="bold")
    return png(figure)
