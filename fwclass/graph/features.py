"""The stage of neighbourhood features, tile by tile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.features.dense import Crowd, crowd_facts
from fwclass.features.names import FeatureRequest, is_feature
from fwclass.features.params import NORMAL, FeaturesParams
from fwclass.features.stage import FEATURE_COMPUTATION, features, without_noise
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.thin import features_of_some, sampled_columns
from fwclass.schema import Table


def neighbourhood_features(plan: Plan) -> FeatureRequest:
    """The features of a neighbourhood that a run computes, in an order that does not depend on the survey's list."""
    return FeatureRequest.of(sorted(n for n in plan.computed if is_feature(n)))


def compute_features(here: StageInputs, params: FeaturesParams, names: tuple[str, ...]) -> Result:
    """Neighbourhood features of a tile's echoes; of a thinned run's, of the sampled ones."""
    sampled = here.own_rows()["sampled"] if here.own else None
    tables, rows, crowds = [], [], []
    for these, chunk in here.chunks():
        some = None if sampled is None else sampled[these]
        tables.append(features(chunk, names, params) if some is None else features_of_some(chunk, some, names, params))
        rows.append(these)
        crowds.append(crowd_facts(without_noise(chunk, params), params))
    crowded = Crowd.of_parts(crowds)
    return tile_table(tables, rows), ({"dense": crowded.facts()} if crowded else {})


def tile_table(pieces: list[Table], rows: list[NDArray[np.int64]]) -> Table:
    """A tile's rows in their order, from pieces of which each has `rows`."""
    if len(pieces) == 1:
        return pieces[0]
    return Table.concat(pieces).take(np.argsort(np.concatenate(rows), kind="stable"))


COMPUTE_FEATURES = Stage(
    FEATURE_COMPUTATION.name,
    FEATURE_COMPUTATION.version,
    "tile",
    "echo",
    compute_features,
    arguments=lambda plan: {"params": plan.config.features, "names": neighbourhood_features(plan).names},
    silent=frozenset({"also"}),
    reads=lambda plan: neighbourhood_features(plan).columns(plan.config.features),
    own=sampled_columns,
    writes=lambda plan: (*neighbourhood_features(plan).names, *NORMAL),
    halo=lambda plan: neighbourhood_features(plan).halo(plan.config.features),
    row_digests=True,
    bulky=True,
)
