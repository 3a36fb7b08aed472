"""The features of the core rows of a chunk, as a list of names asks for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from fwclass.features.cells import cells, height_in_cell
from fwclass.features.dense import thin_dense
from fwclass.features.names import ORIENTED, FeatureRequest
from fwclass.features.nearest import nearest_echoes
from fwclass.features.orientation import sides
from fwclass.features.params import COLLINEAR, LINEAR, NORMAL, FeaturesParams
from fwclass.features.pulses import MEASURED, pulse_variances
from fwclass.features.spheres import optimal, spheres
from fwclass.schema import Scale, Table, require, scaled
from fwclass.stage import Chunk, Computation


def features(chunk: Chunk, names: Iterable[str], params: FeaturesParams) -> Table:
    """The features `names` of the core rows, and their normals; neighbours come from all rows but noise.

    What each is stands in `fwclass.columns.FEATURES`; names carry the scale. The echo itself and echoes at the same
    place count as neighbours; one at exactly the radius does. ``normal_x, normal_y, normal_z`` is the upward unit
    normal at ``params.normal_radius``, NaN where the neighbours are nearly collinear (`features.params.COLLINEAR`).

    With fewer than three neighbours, or all at one place, everything that comes from the covariance is NaN; on a line
    the inclination, the normal and what refers to the fitted plane are NaN. Heights and shares always have a value;
    skewness and kurtosis are 0 where all heights are equal. Means and deviations of what the echoes measured leave out
    those without a value, and are NaN without any. Deviations and variances divide by N. Where echoes are dense beyond
    any survey, few of them count (`fwclass.features.dense`). An echo that is `noise` has all others as neighbours, and
    is nobody's but other noise's; with ``params.noise_counts`` it is like any other.

    `InputError`: a column that the features are computed from is missing. `KeyError`: a name that is no feature.

    Source: the columns' own; the shape of a neighbourhood is the same for every kind of it.
    """
    request = FeatureRequest.of(names)
    require(chunk.table, request.columns(params), chunk.tile.key)
    sound = without_noise(chunk, params)
    of_sound = _features(sound, request, params)
    if sound is chunk:
        return of_sound
    is_noise = chunk.table["noise"][chunk.core]
    if not is_noise.any():
        return of_sound
    of_noise = _features(Chunk(chunk.table, chunk.core[is_noise], chunk.tile), request, params)
    return Table({name: _joined(is_noise, of_sound[name], of_noise[name]) for name in of_sound})


def _joined(second: NDArray[np.bool_], of_first: NDArray, of_second: NDArray) -> NDArray:
    """Values of the rows that are not `second`, and of those that are, in the order of the rows."""
    values = np.empty(len(second), of_first.dtype)
    values[~second], values[second] = of_first, of_second
    return values


def without_noise(chunk: Chunk, params: FeaturesParams) -> Chunk:
    """`chunk` without its noise; the same one where noise counts, or there is none."""
    if params.noise_counts or not chunk.table["noise"].any():
        return chunk
    noise = chunk.table["noise"]
    sound = np.flatnonzero(~noise)
    core = np.searchsorted(sound, chunk.core[~noise[chunk.core]])
    return Chunk(chunk.table.take(sound), core, chunk.tile)


def _features(chunk: Chunk, request: FeatureRequest, params: FeaturesParams) -> Table:
    """As `features`, whoever is noise."""
    thin = thin_dense(chunk, params)
    columns = _of_neighbours(thin.chunk if thin else chunk, request, params)
    if thin:
        columns = {name: values[thin.source] for name, values in columns.items()}
    for scale, bases in request.of_kind("g").items():
        columns |= name_features(cells(chunk, scale, bases), scale)
    if variances := tuple(n for n in request.plain if n in MEASURED):
        columns |= pulse_variances(chunk, variances, params.pulse_reach)
    if "zc" in request.plain:
        columns["zc"] = height_in_cell(chunk, params.cell_x, params.cell_y)
    line = columns[scaled(LINEAR, params.normal_radius)] > COLLINEAR
    columns |= {name: np.where(line, np.float32(np.nan), columns[name]) for name in NORMAL}
    return Table({name: columns[name] for name in (*request.names, *NORMAL)})


def _of_neighbours(chunk: Chunk, request: FeatureRequest, params: FeaturesParams) -> dict[str, NDArray]:
    """What is asked of spheres, cylinders and nearest echoes, of the core rows."""
    columns: dict[str, NDArray] = dict(spheres(chunk, without(request.of_kind("rc"), ORIENTED), params))
    for scale, bases in request.of_kind("r").items():
        if ORIENTED in bases:
            columns[f"{ORIENTED}_{scale.suffix}"] = oriented_inclination(chunk, scale, params)
    chosen, radius = [b for bases in request.of_kind("o").values() for b in bases], "optimal_radius" in request.plain
    if chosen or radius:
        columns |= optimal(chunk, chosen, radius, params)
    for scale, bases in request.of_kind("k").items():
        columns |= name_features(nearest_echoes(chunk, scale, bases, params.nearest_reach), scale)
    return columns


def oriented_inclination(chunk: Chunk, scale: Scale, params: FeaturesParams) -> NDArray[np.float32]:
    """Angle between consistently oriented normal and vertical [deg], 0 to 180; NaN where there is no normal.

    A normal points up for sure where it is within 30 degrees of the vertical and no echo of the vertical cylinder is
    higher by more than the radius. In each of ``params.orientation_rounds`` rounds every normal without a side looks
    at those neighbours in its sphere that have one, and takes the side of sum (n_i . n_j), all at once: so a side goes
    round edges, where normals turn gradually, and no further than a radius per round. What is not reached points up.

    Every row of the chunk takes part; those of the core are right where the halo holds the rounds and one radius more
    (`FeatureRequest.reach`).

    Source: Fan 2013, 2.2; rounds in place of a spanning tree give it a bounded support.
    """
    whole = Chunk(chunk.table, np.arange(chunk.table.rows), chunk.tile)
    own = params.model_copy(update={"normal_radius": scale.metres})
    components = spheres(whole, {}, own)
    normals = np.stack([components[name] for name in NORMAL], axis=1).astype(np.float64)
    side = sides(whole, normals, scale.metres, params.orientation_rounds)[chunk.core]
    upward = normals[chunk.core, 2] * np.where(side == 0, 1, side)
    return np.degrees(np.arccos(np.clip(upward, -1.0, 1.0))).astype(np.float32)


def without(scales: Mapping[Scale, tuple[str, ...]], base: str) -> dict[Scale, tuple[str, ...]]:
    """`scales` without `base`, and without scales that nothing is left of."""
    scales_left = {scale: tuple(b for b in bases if b != base) for scale, bases in scales.items()}
    return {scale: bases for scale, bases in scales_left.items() if bases}


def name_features(by_base: Mapping[str, NDArray], scale: Scale) -> dict[str, NDArray]:
    """Values by base, (echoes,) each, as values by name."""
    return {f"{base}_{scale.suffix}": values for base, values in by_base.items()}


FEATURE_COMPUTATION = Computation(name="features", version=9, writes=NORMAL)
"""It reads and writes what a list of names asks for: `FeatureRequest.columns`, within `FeatureRequest.halo`."""
