"""The model that this process used last, kept for the next part."""

from __future__ import annotations

from pathlib import Path

from fwclass.errors import InputError
from fwclass.model import Model
from fwclass.store.models import load_model, model_digest

_loaded: dict[tuple[str, str], Model] = {}


def model_at(path: Path, digest: str, foreign: bool) -> Model:
    """The model in `path`, kept in this process as long as its digest is the same.

    A `foreign` model, which no receipt names, must still have it.
    """
    key = (str(path), digest)
    if key not in _loaded:
        _loaded.clear()
        model = load_model(path)
        if foreign and model_digest(path) != digest:
            raise InputError(
                "the model was changed while the run was under way",
                where=path,
                do="run the same again with one of them",
            )
        _loaded[key] = model
    return _loaded[key]


def load_given(path: Path) -> tuple[Model, str]:
    """The model in `path`, and its digest; `InputError` where there is none. It is kept for the parts to come."""
    model = load_model(path)
    digest = model_digest(path)
    _loaded.clear()
    _loaded[str(path), digest] = model
    return model, digest
