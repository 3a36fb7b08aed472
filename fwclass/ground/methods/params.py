"""Parameters of each ground filter; names are PDAL's or lidR's where these programs have the filter.

Lengths that follow from the largest building are null in the configuration and are filled in by `sized`.
"""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from fwclass.ground.methods import Voter
from fwclass.params import Params

LEAST_CELL = 0.01
"""No cell or cloth is finer [m]: a tenth of what the densest surveys have between two points."""

MAX_HALO = 1000.0
"""What a filter may read around a block [m]: ten times what the widest halls need, and still tens of millions of
points."""


class FilterParams(Params):
    """Base of one filter's parameters."""

    def sized(self, max_building_size: float) -> Self:
        """These parameters with every null length derived from the largest building's edge [m]."""
        return self

    @property
    def reach(self) -> float:
        """Distance [m] from which a point may decide about another; of `sized` parameters."""
        return 0.0

    @property
    def finest(self) -> float:
        """Edge of the finest raster cells that are made [m]; infinite for none."""
        return math.inf


FINEST, SIZES = 0.25, 5
"""m, smallest of the cells in 3 x 3 of which a surface is looked for, and how many sizes there are, each twice the one
before: the first is for 43 last echoes a square metre and more, the last, of 4 m, for 0.17."""

SURFACE_REACH = 5 * FINEST * (1 << (SIZES - 1))
"""m that the rule of surfaces looks at: its own and four more of the largest cells."""


class NoiseParams(Params):
    """What is no surface at all, looked for before any filter; `noise.noise` tells the rules.

    Attributes
    ----------
    low, high, sigma_rule : each rule's switch: groups far below, groups far above, Xiong's 3σ.
    cell : edge of the largest cells in which groups are looked for [m].
    points : largest number of points that can be a group.
    steepest : a gap must be steeper than this over the mean spacing, rise over run.
    low_gap, high_gap : least distance in height [m] between a group and everything around it.
    low_shape, high_shape : narrowest true pit or tower, its width over its height.
    sigma : standard deviations from the mean of the others around.
    sigma_radius : the others within this horizontal distance count [m].
    sigma_least : a point with another so near to its height stays [m].
    sigma_neighbours : with fewer others the rule is silent.
    sigma_above : the rule also removes points above the mean.
    surface : the switch of the rule of single echoes below a surface.
    surface_gap : least distance [m] below it.
    surface_share : of the last echoes around, that make a surface.
    """

    low: bool
    high: bool
    sigma_rule: bool
    cell: float = Field(ge=0.05, le=1000)
    points: int = Field(ge=1, le=1_000_000_000)
    steepest: float = Field(ge=0)
    low_gap: float = Field(gt=0)
    high_gap: float = Field(gt=0)
    low_shape: float = Field(ge=0)
    high_shape: float = Field(ge=0)
    sigma: float = Field(gt=0)
    sigma_radius: float = Field(gt=0, le=100)
    sigma_least: float = Field(ge=0)
    sigma_neighbours: int = Field(ge=2, le=1_000_000_000)
    sigma_above: bool
    surface: bool
    surface_gap: float = Field(gt=0, le=1000)
    surface_share: float = Field(gt=0, le=1)

    @property
    def reach(self) -> float:
        """Distance [m] from which a point may decide about another."""
        groups = 2.0 * self.cell if self.low or self.high else 0.0
        sigma = self.sigma_radius if self.sigma_rule else 0.0
        return groups + sigma + SURFACE_REACH if self.surface else max(groups, sigma)


class SmrfParams(FilterParams):
    """Simple morphological filter, Pingel et al. 2013; names of PDAL's filters.smrf where it has the setting.

    Attributes
    ----------
    cell : edge of a raster cell [m].
    slope : steepest terrain, rise over run.
    window : radius of the largest opening [m]; null: half the largest building.
    scalar, threshold : a point within threshold + scalar × slope [m] of the terrain is ground.
    low_slope : a cell further below the closed surface than low_slope × cell is a low outlier.
    low_first : low outliers go before the openings; false (Pingel): the openings see them, the terrain does not.
    low_companions, low_radius, low_level : with low_first, a cell with so many others within low_radius [m], each at
        most low_level [m] higher, is no outlier.
    survey_edge : the openings see nothing beyond the surveyed area; false (Pingel): the filled surface.
    restore_rounds : rounds in which edges of cliffs and banks are restored; 0 (Pingel): none.
    restore_radius : how far the terrain that such an edge continues may be away [m].
    restore_tolerance : greatest distance of the edge from a plane through that terrain [m].
    restore_share : greatest share of object cells, about as high or higher, around such an edge.
    """

    cell: float = Field(ge=LEAST_CELL, le=MAX_HALO)
    slope: float = Field(ge=0)
    window: float | None = Field(gt=0)
    scalar: float = Field(ge=0)
    threshold: float = Field(ge=0)
    low_slope: float = Field(gt=0)
    low_first: bool
    low_companions: int = Field(ge=1, le=1000)
    low_radius: float = Field(ge=0, le=MAX_HALO)
    low_level: float = Field(ge=0)
    survey_edge: bool
    restore_rounds: int = Field(ge=0, le=1000)
    restore_radius: float = Field(gt=0, le=MAX_HALO)
    restore_tolerance: float = Field(ge=0)
    restore_share: float = Field(ge=0, le=1)

    def sized(self, max_building_size: float) -> Self:
        return self if self.window else self.model_copy(update={"window": max_building_size / 2.0})

    @property
    def reach(self) -> float:
        # every round of restoring starts from what the one before has found, but only a few go on at the same place
        return 2.0 * (self.window or 0.0) + min(self.restore_rounds, 3) * self.restore_radius

    @property
    def finest(self) -> float:
        return self.cell


class PmfParams(FilterParams):
    """Progressive morphological filter, Zhang et al. 2003; names of PDAL's filters.pmf.

    Attributes
    ----------
    cell_size : edge of a raster cell [m].
    exponential : windows grow as powers of two, not linearly.
    initial_distance, max_distance : least and greatest height difference [m] of a step.
    max_window_size : largest window [cells]; null: the largest building.
    slope : steepest terrain, rise over run.
    """

    cell_size: float = Field(ge=LEAST_CELL, le=MAX_HALO)
    exponential: bool
    initial_distance: float = Field(ge=0)
    max_distance: float = Field(gt=0)
    max_window_size: float | None = Field(gt=0)
    slope: float = Field(ge=0)

    def sized(self, max_building_size: float) -> Self:
        if self.max_window_size:
            return self
        return self.model_copy(update={"max_window_size": max_building_size / self.cell_size})

    @property
    def reach(self) -> float:
        return (self.max_window_size or 0.0) * self.cell_size

    @property
    def finest(self) -> float:
        return self.cell_size


class SlopeParams(FilterParams):
    """Slope based filter, Vosselman 2000.

    Attributes
    ----------
    radius : reach of the filter's kernel [m]; null: half the largest building.
    slope : steepest terrain, rise over run.
    tolerance : height difference [m] that measurement errors alone may bring.
    """

    radius: float | None = Field(gt=0)
    slope: float = Field(ge=0)
    tolerance: float = Field(ge=0)

    def sized(self, max_building_size: float) -> Self:
        return self if self.radius else self.model_copy(update={"radius": max_building_size / 2.0})

    @property
    def reach(self) -> float:
        return self.radius or 0.0


class MovingSurfaceParams(FilterParams):
    """Moving surface filter (He 2023 compares it): a polynomial surface through the lowest points around.

    Attributes
    ----------
    cell : edge of the finest cells whose lowest points are seeds [m].
    max_cell : the coarsest cells are no larger than this [m]; null: half the largest building.
    neighbours : a surface is fitted to the seeds of so many cells to each side.
    threshold, scalar : a point within threshold + scalar × slope [m] above the terrain is ground.
    slope : a seed may lie threshold + slope × cell [m] above the surface of these coarser cells.
    """

    cell: float = Field(ge=LEAST_CELL, le=MAX_HALO)
    max_cell: float | None = Field(gt=0)
    neighbours: int = Field(ge=1, le=50)
    threshold: float = Field(gt=0)
    scalar: float = Field(ge=0)
    slope: float = Field(ge=0)

    def sized(self, max_building_size: float) -> Self:
        return self if self.max_cell else self.model_copy(update={"max_cell": max_building_size / 2.0})

    @property
    def reach(self) -> float:
        return (self.neighbours + 1.0) * (self.max_cell or 0.0)

    @property
    def finest(self) -> float:
        return self.cell


class PtdParams(FilterParams):
    """Progressive TIN densification, Axelsson 2000; names of lidR's `ptd`.

    Attributes
    ----------
    res : edge of the squares whose lowest points are the seeds [m]; null: the largest building.
    first_angle, first_distance : as the two below, of a first pass that takes what is ground beyond doubt.
    angle : greatest angle at a triangle's vertices [deg].
    distance : greatest distance to a triangle's plane [m].
    angle_of_slope : after the first pass, the angle is at most so many times the slope that nine tenths of the TIN's
        triangles do not exceed, taken anew for every size of cells, and at least first_angle; null: `angle` alone.
    max_slope : on steeper triangles, a point whose image beyond the nearest vertex is ground is ground too [deg].
    spacing : triangles with all edges shorter than this are not made denser [m].
    offset, scalar : at the end, a point within offset + scalar × slope [m] of the TIN is ground.
    cell : only the lowest point of every cell of this edge may join the TIN [m].
    low_slope : a point further below its surroundings than low_slope × cell is no seed.
    """

    res: float | None = Field(gt=0)
    first_angle: float = Field(gt=0, lt=90)
    first_distance: float = Field(gt=0)
    angle: float = Field(gt=0, lt=90)
    distance: float = Field(gt=0)
    angle_of_slope: float | None = Field(gt=0)
    max_slope: float = Field(gt=0, lt=90)
    spacing: float = Field(ge=0)
    offset: float = Field(ge=0)
    scalar: float = Field(ge=0)
    cell: float = Field(ge=LEAST_CELL, le=MAX_HALO)
    low_slope: float = Field(gt=0)

    def sized(self, max_building_size: float) -> Self:
        return self if self.res else self.model_copy(update={"res": max_building_size})

    @property
    def reach(self) -> float:
        return 2.0 * (self.res or 0.0)

    @property
    def finest(self) -> float:
        return self.cell


class IptdParams(PtdParams):
    """Improved progressive TIN densification, Zhao et al. 2016, as Shi 2019 uses it.

    Attributes
    ----------
    res : diameter of the disk that the lowest points are opened with [m]; null: the largest building.
    cell : edge of the raster cells whose lowest points are opened, and may join the TIN [m].
    tolerance : a cell that the opening lowers by no more than this is a seed [m].
    """

    tolerance: float = Field(ge=0)


class CsfParams(FilterParams):
    """Cloth simulation filter, Zhang et al. 2016; names of lidR's `csf`.

    Attributes
    ----------
    cloth_resolution : distance of the cloth's particles [m].
    class_threshold, scalar : a point within class_threshold + scalar × slope [m] of the cloth is ground, slope rise
        over run; scalar 0 is Zhang's program.
    rigidness : 1 (steep), 2 or 3 (flat).
    iterations : steps at most.
    time_step : of a simulation step.
    slope_smooth : let the cloth down on steep slopes at the end.
    """

    cloth_resolution: float = Field(ge=LEAST_CELL, le=MAX_HALO)
    class_threshold: float = Field(gt=0)
    scalar: float = Field(ge=0)
    rigidness: int = Field(ge=1, le=3)
    iterations: int = Field(ge=1, le=1_000_000)
    time_step: float = Field(gt=0)
    slope_smooth: bool

    @property
    def reach(self) -> float:
        # the cloth starts from the lowest points within 60 m
        return 64.0

    @property
    def finest(self) -> float:
        return self.cloth_resolution


class CsfSmrfParams(FilterParams):
    """Cloth first, then SMRF on what the cloth keeps (He 2023)."""

    csf: CsfParams
    smrf: SmrfParams

    def sized(self, max_building_size: float) -> Self:
        update = {"csf": self.csf.sized(max_building_size), "smrf": self.smrf.sized(max_building_size)}
        return self.model_copy(update=update)

    @property
    def reach(self) -> float:
        return self.csf.reach + self.smrf.reach

    @property
    def finest(self) -> float:
        return min(self.csf.finest, self.smrf.finest)


class ConsensusParams(FilterParams):
    """Several filters, each with its own section's parameters, vote.

    Attributes
    ----------
    methods : the filters that are asked.
    votes : so many must call a point ground.
    """

    methods: tuple[Voter, ...] = Field(min_length=2)
    votes: int = Field(ge=1)

    @model_validator(mode="after")
    def _can_be_met(self) -> Self:
        if len(set(self.methods)) < len(self.methods):
            raise ValueError(f"a filter votes once; methods names one twice: {', '.join(self.methods)}")
        if self.votes > len(self.methods):
            raise ValueError(f"votes is {self.votes}, but methods are only {len(self.methods)}")
        return self
