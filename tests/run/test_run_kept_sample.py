"""Parts of one process that learn from the same sample, or answer by the same models, read them once."""

from types import SimpleNamespace

import numpy as np
import pytest

from fwclass.graph import loaded_models, training_rows
from fwclass.train.sample import Sample


def inputs_of(sample, digest):
    """A part's inputs that hold the sample, and a list that grows where it is read."""
    reads = []

    def arrays(stage, part, name):
        reads.append(f"{stage}/{part}/{name}")
        return sample.arrays(), {}

    inputs = SimpleNamespace(
        arrays=arrays, arrays_path=lambda stage, part, name: f"{stage}/{part}/{name}", digest=lambda stage, part: digest
    )
    return inputs, reads


def sample_of(value):
    key = np.arange(4, dtype=np.uint64)
    return Sample(("a",), np.full((4, 1), value, np.float32), np.zeros(4, np.uint8), key, key, np.array([4]))


@pytest.mark.parametrize("most, times", [(1 << 20, 1), (8, 3)])
def test_a_sample_is_read_once_where_it_is_small_enough(monkeypatch, most, times):
    monkeypatch.setattr(training_rows, "KEPT", most)
    monkeypatch.setattr(training_rows, "_kept", {})
    inputs, reads = inputs_of(sample_of(1), "one")
    for _ in range(3):
        assert training_rows.survey_sample(inputs, ("a",)).X[0, 0] == 1
    assert len(reads) == times


def test_another_sample_at_the_same_place_is_read(monkeypatch):
    monkeypatch.setattr(training_rows, "_kept", {})
    for value, digest in ((1, "one"), (2, "two"), (1, "one")):
        inputs, reads = inputs_of(sample_of(value), digest)
        assert training_rows.survey_sample(inputs, ("a",)).X[0, 0] == value
        assert reads == ["training/all/sample"]


def test_models_that_are_used_in_turn_are_loaded_once(tmp_path, monkeypatch):
    loads = []
    monkeypatch.setattr(loaded_models, "_loaded", {})
    monkeypatch.setattr(loaded_models, "load_model", lambda path: loads.append(path.name) or path.name)
    for name in "abcabc":
        assert loaded_models.model_at(tmp_path / name, "digest", False, beside=2) == name
    assert loads == ["a", "b", "c"]
    for name in "da":
        loaded_models.model_at(tmp_path / name, "digest", False)
    assert loads == ["a", "b", "c", "d", "a"], "one alone is kept where nobody asks for more"
