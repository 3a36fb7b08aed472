"""The models that this process used last, kept for the next part."""

from __future__ import annotations

from pathlib import Path

from fwclass.graph.stage_work import StageInputs
from fwclass.model import Model
from fwclass.store.models import load_model, load_same, model_digest

MODEL = "model"
"""Directory of a model in the part that made it."""

_loaded: dict[tuple[str, str], Model] = {}


def model_at(path: Path, digest: str, foreign: bool, beside: int = 0) -> Model:
    """The model in `path`, kept in this process as long as its digest is the same, and `beside` it those of before.

    A `foreign` model, which no receipt names, must still have it.
    """
    key = (str(path), digest)
    if key not in _loaded:
        while len(_loaded) > beside:
            del _loaded[next(iter(_loaded))]
        _loaded[key] = load_same(path, digest) if foreign else load_model(path)
    return _loaded[key]


def used_model(here: StageInputs, digest: str | None, stage: str = "train", beside: int = 0) -> Model:
    """The model that is given, by its digest; None: the run's own, which `stage` made. `beside`: as of `model_at`."""
    if digest is not None:
        return model_at(here.file(), digest, True, beside)
    return model_at(here.inputs.path(stage, "model", MODEL), here.inputs.digest(stage, "model"), False, beside)


def load_given(path: Path) -> tuple[Model, str]:
    """The model in `path`, and its digest; `InputError` where there is none. It is kept for the parts to come."""
    digest = model_digest(path)
    model = load_same(path, digest)
    _loaded.clear()
    _loaded[str(path), digest] = model
    return model, digest
