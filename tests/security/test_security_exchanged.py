"""What is looked at and then used is the same: models and corrections that are exchanged in between are told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import modelmaker
import numpy as np
import pytest
from smallsurvey import small_survey

from fwclass import conf
from fwclass.errors import InputError
from fwclass.formats.echo_labels import EchoLabels, echo_labels_bytes
from fwclass.graph import loaded_models
from fwclass.store import model_rows, models
from fwclass.store.run_store import Store
from fwclass.survey import reference
from fwclass.survey.file_digests import Digests


def test_corrections_are_looked_at_as_they_were_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who adds to the file, or exchanges it, while a run begins changes nothing of what was looked at."""
    config = conf.load(small_survey(tmp_path))
    rows: dict[str, Any] = {n: np.ones(1) for n in ("strip", "pulse", "echo_number", "x", "y", "z")}
    named = tmp_path / "run" / "labels" / "corrections.parquet"
    named.parent.mkdir(parents=True)
    sound, unknown = (echo_labels_bytes(EchoLabels.of(rows, [code], 0, "")) for code in (5, 77))
    named.write_bytes(sound)
    original = reference.read_echo_labels

    def exchanging(*args: Any) -> EchoLabels:
        labels = original(*args)
        named.write_bytes(unknown)
        return labels

    monkeypatch.setattr(reference, "read_echo_labels", exchanging)
    store = Store(tmp_path / "run")
    kept = reference.reference_corrections(config, tmp_path, Digests(store), store)
    assert kept is not None and Path(str(kept[0])).read_bytes() == sound


@pytest.mark.parametrize("when", [1, 2])
def test_a_model_that_is_exchanged_while_it_is_loaded_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: int
) -> None:
    """Its digest would have been one model's, its answers the other's."""
    place, other = tmp_path / "model", tmp_path / "other"
    models.save_model(place, modelmaker.models()["forest"])
    models.save_model(other, modelmaker.models()["boosting"])
    calls, original = [], models.model_digest

    def exchanging(path: Path) -> str:
        digest = original(path)
        calls.append(path)
        if len(calls) == when:
            place.rename(tmp_path / "gone")
            other.rename(place)
        return digest

    for module in (models, loaded_models):
        monkeypatch.setattr(module, "model_digest", exchanging)
    with pytest.raises(InputError, match="changed while the run was under way"):
        loaded_models.load_given(place)


def test_rows_of_a_base_model_that_are_exchanged_are_refused(tmp_path: Path) -> None:
    """A part that chooses among them has the digest that the run was planned with."""
    place, (name, kept) = tmp_path / "model", ("forest", np.zeros((3, 2), np.float32))
    rows = model_rows.ModelRows(kept, np.full(3, 2, np.uint8), np.empty((3, 0), np.uint8))
    model = modelmaker.models()[name]
    models.save_model(place, replace(model, card={**model.card, **model_rows.rows_facts(rows)}))
    model_rows.save_rows(place, rows)
    digest = model_rows.rows_digest(place)
    assert model_rows.load_same_rows(place, digest)[1].X.shape == (3, 2)
    np.save(place / "rows" / "X.npy", kept + 1)
    with pytest.raises(InputError, match="changed while the run was under way"):
        model_rows.load_same_rows(place, digest)
