"""Points that try to lead the kernels of features, neighbours and ground out of their arrays."""

from __future__ import annotations

import contextlib

import numpy as np

from fwclass import conf
from fwclass.columns import FEATURES
from fwclass.errors import FwclassError
from fwclass.features.stage import features
from fwclass.grid import Tile
from fwclass.ground.filters import FILTERS, ground_points
from fwclass.ground.params import GroundParams
from fwclass.neighbours import nearest_within
from fwclass.schema import Table
from fwclass.stage import Chunk

ENDS = {"r": ("r50", "r120"), "c": ("c100", "c300"), "k": ("k1", "k7"), "g": ("g50",), "o": ("opt",)}
NAMES = tuple(f"{c.name}_{end}" for c in FEATURES for kind in c.scales for end in ENDS[kind]) + tuple(
    c.name for c in FEATURES if not c.scales
)
PARAMS = conf.section("features").model_copy(
    update={
        "noise_counts": True,
        "optimal_radii": (0.5, 1.0),
        "nearest_reach": 3.0,
        "orientation_rounds": 2,
        "pulse_reach": 3.0,
    }
)
GROUND = conf.section("ground").model_dump()
EAST, NORTH = 512_000.0, 5_403_200.0


def places(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y, z [m]: few or one, equal, on a line, on borders of cells, dense, tall, or far apart; whole millimetres."""
    n = int(rng.choice([1, 2, 3, 17, 120, 400]))
    x, y, z = rng.uniform(0.0, float(rng.choice([0.05, 3.0, 30.0])), (3, n))
    kind = rng.integers(0, 8)
    if kind == 0:
        x[:], y[:], z[:] = x[0], y[0], z[0]
    elif kind == 1:
        y, z = 2.0 * x, 0.5 * x
    elif kind == 2:
        x, y, z = np.floor(x * 2.0) / 2.0, np.floor(y * 2.0) / 2.0, np.floor(z)
    elif kind == 3:
        z = z * 500.0
    elif kind == 4:
        x[0], y[-1] = x[0] + 900.0, y[-1] - 900.0
    elif kind == 5:
        z[rng.random(n) < 0.1] -= 3000.0
    elif kind == 6:
        z[:] = 0.0
    far = float(rng.choice([0.0, 1.0, -1.0]))
    return (EAST * far + x).round(3), (NORTH * far + y).round(3), z.round(3)


def table_of(x, y, z, rng: np.random.Generator) -> Table:  # type: ignore[no-untyped-def]
    """Echoes with extreme attributes, or none."""
    n = len(x)
    of = rng.integers(1, 16, n)
    extreme = rng.choice([0.0, 1.0, 65535.0, 1e30, np.nan, np.inf], n)
    return Table(
        {
            "strip": rng.integers(0, 3, n),
            "pulse": np.sort(rng.integers(0, max(n // 2, 1), n)),
            "gps_time": rng.choice([0.0, 1.0, np.nan], n),
            "echo_number": rng.integers(0, of + 1),
            "number_of_echoes": of,
            "x": x,
            "y": y,
            "z": z,
            "amplitude": extreme,
            "width": -extreme,
            "intensity": rng.integers(0, 65536, n),
        }
    )


def drive(inputs: int, seed: int) -> int:
    rng = np.random.default_rng(seed)
    methods = list(FILTERS)
    for done in range(inputs):
        x, y, z = places(rng)
        core = np.flatnonzero(rng.random(len(x)) < rng.choice([0.0, 0.5, 1.0]))
        names = [NAMES[k] for k in rng.choice(len(NAMES), 40, replace=False)]
        few = PARAMS.model_copy(update={"dense_echoes": int(rng.choice([1, 64]))})
        with contextlib.suppress(FwclassError):
            features(Chunk(table_of(x, y, z, rng), core, Tile(0, 0, 1e7)), names if done else NAMES, few)
        with contextlib.suppress(FwclassError):
            nearest_within((x - 0.7, y + 900.0 * (done % 2), z), (x, y, z), float(rng.choice([0.001, 1.0, 50.0])))
        params = GroundParams(**{**GROUND, "method": methods[done % len(methods)]})
        with contextlib.suppress(FwclassError):
            ground_points(x, y, z, rng.random(len(x)) < 0.8, params)
    return inputs
