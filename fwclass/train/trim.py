"""Trimming of training rows that lie among those of another class.

Source: Li, Wang and Yuan 2003 (NN-SVM), as Shi 2019 takes it; the same rule as Wilson's editing with one neighbour.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

Trim = Literal["none", "nearest", "repeated"]

ROUNDS = 100
"""Rounds of `repeated`, at most."""

TIED = 1e-12
"""Relative: neighbours whose distances differ by less are equally near."""


def trim_rows(X: NDArray[np.float64], y: NDArray[np.uint8], trim: Trim) -> tuple[NDArray[np.bool_], tuple[int, ...]]:
    """Rows that stay, bool (rows,), and the classes that would have gone whole and stay untrimmed.

    A row stays if one of its nearest other rows has its class; all that are equally near count, and a row at the very
    same place is the nearest. `repeated` does it again among what stays until nothing goes. Rows' order changes
    nothing. X are prepared features without missing values.
    """
    clean = np.ones(len(y), bool)
    whole: set[int] = set()
    for _ in range({"none": 0, "nearest": 1, "repeated": ROUNDS}[trim]):
        rows = np.flatnonzero(clean)
        stays = _stay(X[rows], y[rows])
        for k in np.unique(y[rows]):
            mine = y[rows] == k
            if not stays[mine].any():
                stays[mine] = True
                whole.add(int(k))
        if stays.all():
            break
        clean[rows[~stays]] = False
    return clean, tuple(sorted(whole))


def _stay(X: NDArray[np.float64], y: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Rows with a nearest other row of their class, or without any other row."""
    places, place, count = np.unique(X, axis=0, return_inverse=True, return_counts=True)
    place = place.ravel()
    classes = int(y.max()) + 1 if len(y) else 1
    there = np.zeros((len(places), classes), bool)
    there[place, y] = True
    twins = np.bincount(place * classes + y, minlength=len(places) * classes)[place * classes + y] > 1
    alone = count[place] == 1
    stays = twins | (alone & (len(places) == 1))
    ask = np.flatnonzero(alone & ~stays)
    if len(ask) == 0 or len(places) == 1:
        return stays
    tree = scipy.spatial.cKDTree(places)
    distance, near = (np.asarray(a) for a in tree.query(places[place[ask]], k=2))
    other = np.where(near[:, 0] == place[ask], near[:, 1], near[:, 0])
    stays[ask] = there[other, y[ask]]
    doubt = ~stays[ask]  # another one as near may have the row's class
    for row, far in zip(ask[doubt], distance[doubt, 1], strict=True):
        tied = [t for t in tree.query_ball_point(places[place[row]], far * (1 + TIED)) if t != place[row]]
        stays[row] = there[tied, y[row]].any()
    return stays
