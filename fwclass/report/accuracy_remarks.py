"""What a run or a training says beside its accuracy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from fwclass.assess.remarks import Extent, remarks
from fwclass.classify.context import halo_of
from fwclass.conf import Config
from fwclass.features.names import FeatureRequest, is_feature

OF_A_GIVEN_MODEL = (
    "The model, or its base, was given, and nothing here tells where it learned: if it was in this survey, the figure "
    "is too good: name those places in areas.train, and they are not tested."
)

OF_CORRECTIONS = (
    "The labels are corrections, and answers of a model that were confirmed: who confirms sees the answer first, so "
    "the figure is rather too good."
)


def accuracy_remarks(
    accuracy: Mapping[str, Any],
    config: Config,
    names: tuple[str, ...],
    echoes: int,
    others: Mapping[str, int] | None = None,
    nearest: float | None = None,
    cells: Iterable[float] = (),
    lines: bool = False,
) -> list[str]:
    """Remarks on the accuracy of a classifier by the features `names` over a survey of so many `echoes`.

    `others`: echoes by codes that no class counts. `nearest`: distance of the nearest tested echo from a training area
    [m], where it was measured; elsewhere it is `areas.gap`. `cells`: edges of those that a second layer decides by [m];
    `lines`: classes of echoes have changed along lines.
    """
    scored = int(np.sum(accuracy["confusion"])) + int(np.sum(accuracy.get("unclassified") or 0))
    apart = None if config.survey.model else max(config.areas.gap, nearest or 0.0)
    reach = FeatureRequest.of(n for n in names if is_feature(n)).reach(config.features) + halo_of(cells)
    field = config.classify.regularize
    reach += field.halo if field.strength > 0 else 0.0
    reach = max(reach, config.classify.lines.halo) if lines else reach
    sentences = remarks(accuracy, Extent(echoes, scored, others or {}, apart, reach), config.assess)
    unknown_where_learned = (config.survey.model or config.survey.base_model) and not config.areas.train
    return [
        *sentences,
        *([OF_A_GIVEN_MODEL] if unknown_where_learned else []),
        *([OF_CORRECTIONS] if config.survey.reference.kind == "corrections" else []),
    ]
