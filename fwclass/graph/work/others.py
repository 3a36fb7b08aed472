"""Work of the part that trains a classifier that is no forest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fwclass.model import ClassDef, Model
from fwclass.run.inputs import PartInputs
from fwclass.store.models import save_model
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.stage import train_other
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample

MODEL, SAMPLE = "model", "sample.zarr"


def merged_sample(inputs: PartInputs, names: tuple[str, ...]) -> Sample:
    """The sample of the whole survey."""
    arrays, _ = inputs.arrays("training", "all", SAMPLE)
    return Sample.from_arrays(names, arrays)


def stamped(model: Any, computed: Mapping[str, Any]) -> Any:
    """`model` with what its features were computed with in its card."""
    return replace(model, card={**model.card, "computed": dict(computed)})


def fitted(
    names: tuple[str, ...],
    params: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
    computed: Mapping[str, Any],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """The classifier that ``train.method`` names, delivered as the run's model."""
    found: Model = stamped(train_other(merged_sample(inputs, names), params, compare, classes, params.method), computed)
    save_model(directory / MODEL, found)
    return {"card": dict(found.card), "trees": None}
