"""Numbers of the outputs."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from fwclass.params import Params


class PublishParams(Params):
    """Settings of every output; none of them changes a class.

    Attributes
    ----------
    class_cell : edge of a cell of the class raster [m].
    chunk_points : points of a strip held in memory at once.
    copc_leaf : a node of the octree of a tile that has at most so many echoes keeps them all.
    row_group : rows of a Parquet row group.
    parquet_features : which features delivered Parquet has: all that were computed, those that are used by the
        classifier, or none.
    parquet_bits : numbers of delivered Parquet are rounded to a relative step of 2^-bits; 23 keeps them as they are.
    zstd_level : effort of Zstandard in Parquet.
    cog_block : edge of a raster's internal tile [cells].
    cog_compression : compression of the rasters.
    raster_cache : memory that GDAL keeps blocks of rasters in while they are written [MiB].
    overview_echoes : an overview has at most so many echoes.
    overview_square : edge of the squares of the fixed lattice that have an overview of their own, where a survey of
        several has more echoes than one overview [m].
    figure_pixels : longer edge of the report's maps [pixels]; a map is never drawn finer than its raster.
    sun_azimuth : where the light of shaded relief comes from, clockwise from north [deg].
    sun_altitude : its height above the horizon [deg].
    exaggeration : factor on heights in shaded relief.
    """

    class_cell: float = Field(ge=0.001, le=100_000)
    chunk_points: int = Field(gt=0, le=50_000_000)
    copc_leaf: int = Field(ge=100, le=10_000_000)
    row_group: int = Field(gt=0, le=100_000_000)
    parquet_features: Literal["all", "used", "none"]
    parquet_bits: int = Field(ge=4, le=23)
    zstd_level: int = Field(ge=1, le=22)
    cog_block: int = Field(ge=128, le=4096, multiple_of=16)
    cog_compression: Literal["deflate", "zstd"]
    raster_cache: int = Field(ge=16, le=65_536)
    overview_echoes: int = Field(ge=1000, le=100_000_000)
    overview_square: float = Field(ge=10, le=1_000_000)
    figure_pixels: int = Field(ge=200, le=4000)
    sun_azimuth: float = Field(ge=0, le=360)
    sun_altitude: float = Field(gt=0, le=90)
    exaggeration: float = Field(gt=0, le=1000)
