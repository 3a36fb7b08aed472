"""The way past what stands beside the road: things are as long along it as they are high, and their edges are upright.

Crowns, shrubs, façades and what stands before them look alike along the road and upwards, over a metre or so: if they
seem drawn out along it, the vehicle was slower than its speed says. Edges of houses, poles, trunks and vehicles are
upright; if they lean, the scanner does.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fwclass.street.params import StreetParams
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.way_kernels import LEAN, LEANS, SIZES, add_along, add_leans, add_upwards

STEP, SPARSE = 0.05, 0.1
"""m of road from one frame that is looked at to the next, and at most where edges are."""

EVERY = 4
"""Of the frames looked at, from one that sizes are measured on to the next."""

ABOVE, NEAR, FAR = 0.4, 1.5, 15.0
"""m: what stands beside the road is as high above it, as far aside, and as near."""

EDGE = 0.5
"""m, by which the depth changes along the road at an edge."""

REACH = 1.5
"""m of road, over which edges are held."""

FEWEST_CHANGES = 0.1
"""Share of the pairs, along the road and upwards, that must change: less is a wall, or a field."""

ENOUGH = 300.0
"""m of road, after which no more is looked at."""

LONG, SOME = 100.0, 30.0
"""m of road, that tell how long things are, and how edges lean."""

FEWEST_PAIRS = 2000
"""Pairs of returns of one size that tell how often they change."""

MOST_EDGES = 200
"""Returns of a frame that are held as edges: of simulated streets half have 11, none more than this. Of noise all are
edges, and each is held against all others."""

FEWEST_EDGES = 2000
"""Pairs of returns that tell how edges lean."""


@dataclass(frozen=True)
class _Seen:
    """A frame's place along the road; x, depth (y; NaN of what does not stand beside it) and z of its beams [m]."""

    at: float
    ahead: NDArray[np.float32]
    depth: NDArray[np.float32]
    up: NDArray[np.float32]


@dataclass
class Way:
    """Adds up what the frames of a moving vehicle show; nothing of one that stands.

    `upwards`, `along`: float64 (bins of `SIZES`, 2), pairs of returns that change in depth, and all. `leans`: int64,
    pairs of returns of one edge by how it leans. `metres`: of road that were looked at.
    """

    params: StreetParams
    upwards: NDArray[np.float64] = field(default_factory=lambda: np.zeros((len(SIZES) - 1, 2)))
    along: NDArray[np.float64] = field(default_factory=lambda: np.zeros((len(SIZES) - 1, 2)))
    leans: NDArray[np.int64] = field(default_factory=lambda: np.zeros(2 * LEANS, np.int64))
    metres: float = 0.0
    _held: deque[_Seen] = field(default_factory=lambda: deque(maxlen=math.ceil(SIZES[-1] / STEP) + 1))
    _edges: deque[tuple[float, NDArray[np.float64]]] = field(default_factory=deque)
    _seen: int = 0

    def see(
        self, place: int, x: NDArray[np.int32], y: NDArray[np.int32], z: NDArray[np.int32], r: NDArray[np.float32]
    ) -> None:
        """A frame at `place` [units]; x, which may be empty, y, z [units] and r [m] of its returns."""
        if self.metres > ENOUGH:
            return
        at = place * UNIT
        gone = at - self._held[-1].at if self._held else math.inf
        if 0.0 <= gone < STEP:
            return
        if not 0.0 <= gone <= SIZES[-1]:
            self._held.clear()
            self._edges.clear()
            gone = math.inf
        else:
            self.metres += gone
        ahead, aside, up = ((v * UNIT).astype(np.float32) for v in (x if len(x) else np.zeros_like(y), y, z))
        beside = (r < FAR) & (up > ABOVE - self.params.mounting.height) & (np.abs(aside) > NEAR)
        one = _Seen(at, at + ahead, np.where(beside, aside, np.float32(np.nan)), up)
        if gone <= SPARSE:
            self._add_edges(one, self._held[-1])
        self._held.append(one)
        if self._seen % EVERY == 0:
            self._add_sizes(one)
        self._seen += 1

    def _add_sizes(self, one: _Seen) -> None:
        change = self.params.sound.change
        slant = math.cos(math.radians(self.params.mounting.pitch))
        add_upwards(one.depth, one.up / np.float32(slant), change, self.upwards)
        size = len(SIZES) - 2
        for other in self._held:  # the furthest first: one frame of every size
            apart = one.at - other.at
            while size >= 0 and apart < SIZES[size]:
                size -= 1
            if size >= 0 and apart < SIZES[size + 1]:
                add_along(one.depth, other.depth, change, self.along[size])
                size -= 1

    def _add_edges(self, one: _Seen, last: _Seen) -> None:
        change = np.abs(one.depth) - np.abs(last.depth)
        rows = np.flatnonzero((np.abs(change) > EDGE) & (one.depth * last.depth > 0.0))
        rows = rows[:: max(1, -(-len(rows) // MOST_EDGES))]
        begins = change[rows] < 0.0
        x, depth, up = (
            np.where(begins, a[rows], b[rows])
            for a, b in ((one.ahead, last.ahead), (one.depth, last.depth), (one.up, last.up))
        )
        new = np.column_stack([x, up, depth, begins]).astype(np.float64)
        while self._edges and self._edges[0][0] < one.at - REACH:
            self._edges.popleft()
        old = [edges for _, edges in self._edges]
        add_leans(np.concatenate([*old, new]), sum(map(len, old)), self.leans)
        self._edges.append((one.at, new))

    @property
    def stretch(self) -> float | None:
        """How many times longer things seem along the road than upwards; None where too little stands beside it."""
        if self.metres < LONG or min(self.upwards[:, 1].min(), self.along[:, 1].max()) < FEWEST_PAIRS:
            return None
        here = self.along[:, 1] >= FEWEST_PAIRS  # a fast vehicle's frames are further apart than the smallest sizes
        size = np.log(np.sqrt(SIZES[1:] * SIZES[:-1]))[here]
        up, on = (v[here, 0] / v[here, 1] for v in (self.upwards, self.along))
        if len(size) < 4 or min(up.mean(), on.mean()) < FEWEST_CHANGES:
            return None
        rise = float(np.polyfit(np.tile(size, 2), np.concatenate([up - up.mean(), on - on.mean()]), 1)[0])
        return math.exp(min(max((up.mean() - on.mean()) / rise, -5.0), 5.0)) if rise > 0.0 else None

    def lean(self, least: float) -> dict[str, float | None]:
        """`lean_deg`, by which of all angles of `least` degrees and more most edges lean, forwards above 0, and
        `lean_share`, how many these are beyond the usual, to the usual or those that are upright; None of too few."""
        if self.metres < SOME or self.leans.sum() < FEWEST_EDGES:
            return {"lean_deg": None, "lean_share": None}
        usual = float(np.median(self.leans))
        beyond = 0.5 * (self.leans[1:] + self.leans[:-1]) - usual
        angle = LEAN * (np.arange(1, 2 * LEANS) - LEANS)  # between two bins: an edge there falls into both
        upright = float(beyond[np.abs(angle) < 2.0 * LEAN].max())
        top = int(np.where(np.abs(angle) >= least, beyond, -np.inf).argmax())
        return {"lean_deg": float(angle[top]), "lean_share": float(beyond[top]) / max(upright, usual, 1.0)}
