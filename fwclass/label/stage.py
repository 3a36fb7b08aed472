"""Reference classes for echoes, from the source's own classes or from another cloud: polygons, labels by echo and
corrections have files of their own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import millimetres
from fwclass.kernel import kernel
from fwclass.neighbours import nearest_within
from fwclass.schema import Table
from fwclass.stage import Chunk, Computation

HIGHEST = 100
"""cm, from which on heights above a reference point are counted together."""


def from_cloud(chunk: Chunk, cloud: Table, max_distance: float) -> tuple[Table, NDArray[np.int64]]:
    """Class of the nearest reference point: of the same pulse if the cloud has one within reach, else of any; and how
    many labelled echoes lie how far above their point, int64 (201,), whole centimetres from -100 to 100.

    Parameters
    ----------
    chunk : core echoes with x, y, z, gps_time.
    cloud : reference points of the tile and `max_distance` around it: x, y, z, gps_time (NaN if unknown), source_class.

    Echoes without a reference point within `max_distance` get 0. Ties go to the point first in `cloud`'s order.
    """
    echoes = chunk.table.take(chunk.core)
    at = (echoes["x"], echoes["y"], echoes["z"])
    among = (cloud["x"], cloud["y"], cloud["z"])
    nearest = _same_pulse(echoes, cloud, max_distance)
    lacking = nearest < 0
    if lacking.any():
        rest = (at[0][lacking], at[1][lacking], at[2][lacking])
        nearest[lacking], _ = nearest_within(rest, among, max_distance)
    reference = np.zeros(echoes.rows, np.uint8)
    hit = nearest >= 0
    reference[hit] = cloud["source_class"][nearest[hit]]
    above = millimetres(echoes["z"][hit]) - millimetres(cloud["z"][nearest[hit]])
    centimetres = np.clip((above + 5) // 10, -HIGHEST, HIGHEST) + HIGHEST
    return Table({"reference": reference}), np.bincount(centimetres, minlength=2 * HIGHEST + 1).astype(np.int64)


def _same_pulse(echoes: Table, cloud: Table, limit: float) -> NDArray[np.int64]:
    """Row of the nearest cloud point with the echo's GPS time within `limit` [m], -1 if none."""
    order = np.argsort(cloud["gps_time"], kind="stable")
    times = cloud["gps_time"][order]
    low = np.searchsorted(times, echoes["gps_time"], "left")
    high = np.searchsorted(times, echoes["gps_time"], "right")
    high = np.where(np.isnan(echoes["gps_time"]), low, high)
    nearest = np.full(echoes.rows, -1, np.int64)
    _nearest_in_range(
        echoes["x"], echoes["y"], echoes["z"], cloud["x"], cloud["y"], cloud["z"], order, low, high, limit, nearest
    )
    return nearest


@kernel
def _nearest_in_range(px, py, pz, x, y, z, order, low, high, limit, nearest):  # type: ignore[no-untyped-def]
    for i in range(len(px)):
        best = limit * limit
        for k in range(low[i], high[i]):
            j = order[k]
            d = (px[i] - x[j]) ** 2 + (py[i] - y[j]) ** 2 + (pz[i] - z[j]) ** 2
            if d < best or (d == best and nearest[i] < 0):
                best = d
                nearest[i] = j


def from_source(chunk: Chunk) -> Table:
    """``reference``, uint8 (core,): the class that the source file gave to the echo's return (of a waveform's echo, to
    the nearest return of its pulse, as it was read)."""
    return Table({"reference": chunk.table["source_class"][chunk.core]})


LABEL = Computation(
    "label", 3, reads=("x", "y", "z", "gps_time", "source_class"), writes=("reference",), halo=lambda p: p.max_distance
)
