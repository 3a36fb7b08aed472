"""The features of Fan 2013, and those of a neighbourhood's shape, for the core rows of a chunk."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from fwclass.features.walk import SHAPE, walk
from fwclass.grid import millimetres, whole_millimetres
from fwclass.neighbours import CellIndex
from fwclass.schema import Table, require, scaled
from fwclass.stage import Chunk, Params, Stage
from fwclass.units import QUANTUM


class FeaturesParams(Params):
    """Parameters of the features.

    Attributes
    ----------
    radii : radii of the neighbourhoods [m], one walk each; names carry them, as in ``planarity_r100``.
    cell_x, cell_y : edges of the cells of `zc` [m].
    platform_altitude : height of the sensor in the survey's height system [m]; None leaves `backscatter`
        without values.
    calibration : the constant C_cal of `backscatter`.
    max_incidence : incidence angles above this [deg] count as this in `backscatter`.
    """

    radii: tuple[float, ...] = Field(min_length=1)
    cell_x: float = Field(gt=0)
    cell_y: float = Field(gt=0)
    platform_altitude: float | None
    calibration: float = Field(gt=0)
    max_incidence: float = Field(ge=0, lt=90)

    @field_validator("radii")
    @classmethod
    def _nameable(cls, radii: tuple[float, ...]) -> tuple[float, ...]:
        centimetres = [round(radius * 100) for radius in radii]
        exact = all(math.isclose(r * 100, cm) and cm > 0 for r, cm in zip(radii, centimetres, strict=True))
        if not exact or len(set(centimetres)) < len(radii):
            raise ValueError("radii must differ and be positive whole centimetres, as columns are named by them")
        return radii


def names(params: FeaturesParams) -> tuple[str, ...]:
    """Columns that `features` writes under `params`, in order."""
    return ("zc", *(scaled(base, radius) for radius in params.radii for base in (*SHAPE, "backscatter")))


def features(chunk: Chunk, params: FeaturesParams) -> Table:
    """Features of the core rows; neighbours come from all rows.

    ``zc`` is z minus the lowest z of the cell (plain minimum, as the paper has it) of a grid that hangs on
    the global origin. For every radius: `SHAPE` from the sphere and the vertical cylinder, the point itself
    included, and ``backscatter``, see there. With fewer than three neighbours, or all at one place, the
    shape (linearity, planarity, sphericity, roughness) and the inclination are NaN; on a line the
    inclination is NaN.

    Sums over neighbours are of exact integer millimetres, so that the results depend on the set of
    neighbours only.

    Source: Fan 2013, 2; the shape of the neighbourhood: Demantké 2011, Xiong 2018.
    """
    require(chunk.table, FEATURES.reads, chunk.tile.key)
    out: dict[str, NDArray] = {}
    echoes = chunk.table.select(("z", "amplitude", "width", "beam_x", "beam_y", "beam_z")).take(chunk.core)
    for radius in params.radii:
        shape = neighbourhoods(chunk, radius)
        for k, base in enumerate(SHAPE):
            out[scaled(base, radius)] = shape[:, k]
        out[scaled("backscatter", radius)] = backscatter(echoes, shape[:, -3:], params)
    return Table({"zc": height_in_cell(chunk, params), **out})


def height_in_cell(chunk: Chunk, params: FeaturesParams) -> NDArray[np.float64]:
    """z of the core rows minus the lowest z of all rows in their cell [m]."""
    z = millimetres(chunk.table["z"])
    if len(z) == 0:
        return np.empty(0)
    col = millimetres(chunk.table["x"]) // whole_millimetres(params.cell_x, "features.cell_x")
    row = millimetres(chunk.table["y"]) // whole_millimetres(params.cell_y, "features.cell_y")
    cell = (row - row.min()) * (col.max() - col.min() + 1) + (col - col.min())
    lowest = np.full(int(cell.max()) + 1, z.max())
    np.minimum.at(lowest, cell, z)
    return (z[chunk.core] - lowest[cell[chunk.core]]) * QUANTUM


def neighbourhoods(chunk: Chunk, radius: float) -> NDArray[np.float32]:
    """`SHAPE` and the upward unit normal at one radius [m]; shape (core rows, len(SHAPE) + 3)."""
    table = chunk.table
    out = np.empty((len(chunk.core), len(SHAPE) + 3), np.float32)
    if len(out) == 0:
        return out
    index = CellIndex.build(table["x"], table["y"], table["z"], cell=radius)
    wanted = np.full(table.rows, -1, np.int64)
    wanted[chunk.core] = np.arange(len(chunk.core))
    first = table["echo_number"] == 1
    last = table["echo_number"] == table["number_of_echoes"]
    walk(
        index.x.astype(np.float64), index.y.astype(np.float64), index.z.astype(np.float64),
        first[index.order].astype(np.float64), last[index.order].astype(np.float64),
        wanted[index.order], index.start, index.ncols, index.nrows, index.cell, out,
    )  # fmt: skip
    return out


def backscatter(echoes: Table, normals: NDArray[np.float32], params: FeaturesParams) -> NDArray[np.float64]:
    """Backscatter coefficient γ = σ / (A_i cos θ) of echoes with known local normals.

    With σ = C R⁴ P S_p and the beam's cross-section A_i = π R² β² / 4 this is γ = C_cal R² P S_p / cos θ;
    C_cal holds the constants. For an extended Lambertian surface γ is proportional to its reflectance,
    whatever its slope and range.

    R = (platform_altitude − z) / −beam_z [m], P amplitude [DN], S_p echo width [ns], θ the angle between
    beam and normal, at most `max_incidence` (cos θ would vanish on walls). NaN where the beam, normal,
    amplitude, width or altitude is missing, or the sensor is not above the echo.

    Source: Fan 2013, eq. 3; Wagner 2008.
    """
    if params.platform_altitude is None:
        return np.full(echoes.rows, np.nan)
    down = -echoes["beam_z"].astype(np.float64)
    drop = params.platform_altitude - echoes["z"]
    range_ = np.divide(drop, down, out=np.full(len(down), np.nan), where=(down > 0) & (drop > 0))
    beam = np.stack([echoes["beam_x"], echoes["beam_y"], echoes["beam_z"]], axis=1)
    cosine = np.abs(np.einsum("ij,ij->i", beam, normals, dtype=np.float64))
    cosine = np.clip(cosine, np.cos(np.radians(params.max_incidence)), 1.0)
    return params.calibration * range_**2 * echoes["amplitude"] * echoes["width"] / cosine


FEATURES = Stage(
    name="features",
    version=1,
    kind="tile",
    function=features,
    params=FeaturesParams,
    reads=(
        "x", "y", "z", "echo_number", "number_of_echoes", "amplitude", "width", "beam_x", "beam_y", "beam_z"
    ),
    writes=("zc", *SHAPE, "backscatter"),
    halo=lambda params: float(max(*params.radii, params.cell_x, params.cell_y)),
)  # fmt: skip
"""`writes` has the features without their scale; `names` has the columns under given params."""
