"""Curves of kappa against the parameters of a ground filter, as figure 4 of He 2023."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from fwclass.publish.drawing import INK, dress, png, sheet

LINE, CHOSEN = "#17697a", "#d0742e"
ACROSS = 3
"""Panels in a row."""

LOGARITHMIC = 8.0
"""A range whose last value is so many times its first is drawn on a logarithmic axis."""


def draw_curves(
    curves: Mapping[str, Sequence[Sequence[float]]], best: Mapping[str, float], method: str, held_out: float | None
) -> bytes:
    """PNG with one panel per parameter: kappa over its range, every other parameter at its best value.

    `curves`: (value, kappa) by parameter, by rising value. `best`: the chosen values, marked in the panels. `held_out`:
    kappa on points that took no part in the choice; a dotted line, none where it is None.
    """
    rows = math.ceil(len(curves) / ACROSS)
    figure = sheet(8.4, 2.5 * rows + 0.5)
    kappas = [k for line in curves.values() for _, k in line]
    low, high = min(kappas), max([*kappas, held_out or -1.0])
    room = max(0.06 * (high - low), 0.005)
    for place, (name, line) in enumerate(curves.items()):
        axes = figure.add_subplot(rows, ACROSS, place + 1)
        x, y = zip(*line, strict=True)
        axes.plot(x, y, color=LINE, linewidth=1.4, marker="o", markersize=2.8)
        axes.plot([best[name]], [y[x.index(best[name])]], "o", color=CHOSEN, markersize=6)
        if held_out is not None:
            axes.axhline(held_out, color=INK, linewidth=0.8, linestyle=":")
        if x[0] > 0 and x[-1] / x[0] >= LOGARITHMIC:
            axes.set_xscale("log")
            ticks = x[:: max(1, math.ceil(len(x) / 6))]
            axes.set_xticks(ticks, [f"{v:g}" for v in ticks])
            axes.minorticks_off()
        axes.set_ylim(low - room, high + room)
        dress(axes, f"{name} = {best[name]:g}", "kappa" if place % ACROSS == 0 else "")
    note = "" if held_out is None else f"; dotted: kappa {held_out:.3f} on points held out"
    figure.suptitle(f"{method}: kappa against each parameter, the others at their best{note}", fontsize=9, color=INK)
    return png(figure)
