"""The features of Fan 2013, and those of a neighbourhood's shape, for the core rows of a chunk."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

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
    normal_radius : the one of `radii` whose normals are kept, for radiometry [m]; None is the smallest.
    """

    radii: tuple[float, ...] = Field(min_length=1)
    cell_x: float = Field(gt=0)
    cell_y: float = Field(gt=0)
    normal_radius: float | None

    @field_validator("radii")
    @classmethod
    def _nameable(cls, radii: tuple[float, ...]) -> tuple[float, ...]:
        centimetres = [round(radius * 100) for radius in radii]
        exact = all(math.isclose(r * 100, cm) and cm > 0 for r, cm in zip(radii, centimetres, strict=True))
        if not exact or len(set(centimetres)) < len(radii):
            raise ValueError("radii must differ and be positive whole centimetres, as columns are named by them")
        return radii

    @model_validator(mode="after")
    def _normals(self) -> FeaturesParams:
        if self.normal_radius is not None and self.normal_radius not in self.radii:
            raise ValueError(f"normal_radius {self.normal_radius:g} must be one of radii")
        return self


NORMAL = ("normal_x", "normal_y", "normal_z")


def names(params: FeaturesParams) -> tuple[str, ...]:
    """Columns that `features` writes under `params`, in order."""
    return ("zc", *(scaled(base, radius) for radius in params.radii for base in SHAPE), *NORMAL)


def features(chunk: Chunk, params: FeaturesParams) -> Table:
    """Features of the core rows; neighbours come from all rows.

    ``zc`` is z minus the lowest z of the cell (plain minimum, as the paper has it) of a grid that hangs on
    the global origin. For every radius: `SHAPE` from the sphere and the vertical cylinder, the point itself
    included; ``normal_x, normal_y, normal_z`` at `normal_radius`. With fewer than three neighbours, or all at one
    place, the shape (linearity, planarity, sphericity, roughness), the inclination and the normal are NaN; on a line
    the inclination and the normal are NaN.

    Sums over neighbours are of exact integer millimetres, so that the results depend on the set of
    neighbours only.

    Source: Fan 2013, 2; the shape of the neighbourhood: Demantké 2011, Xiong 2018.
    """
    require(chunk.table, FEATURES.reads, chunk.tile.key)
    out: dict[str, NDArray] = {}
    for radius in params.radii:
        shape = neighbourhoods(chunk, radius)
        for k, base in enumerate(SHAPE):
            out[scaled(base, radius)] = shape[:, k]
        if radius == (params.normal_radius or min(params.radii)):
            normals = {name: shape[:, len(SHAPE) + k] for k, name in enumerate(NORMAL)}
    return Table({"zc": height_in_cell(chunk, params), **out, **normals})


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


FEATURES = Stage(
    name="features",
    version=2,
    kind="tile",
    function=features,
    params=FeaturesParams,
    reads=("x", "y", "z", "echo_number", "number_of_echoes"),
    writes=("zc", *SHAPE, *NORMAL),
    halo=lambda params: float(max(*params.radii, params.cell_x, params.cell_y)),
)
"""`writes` has the features without their scale; `names` has the columns under given params."""
