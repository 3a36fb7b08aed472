"""What trains is stored once: tiles keep which of their rows may train, the survey's sample has their values."""

import numpy as np

from fwclass.run.inputs import PartInputs
from fwclass.schema import canonical_key
from fwclass.store.run_store import Store


def test_the_survey_s_sample_has_the_values_that_the_features_have(finished):
    inputs = PartInputs(Store(finished[0], read_only=True))
    sample, _ = inputs.arrays("training", "all", "sample")
    names = finished[1]["training"]["features"]
    parts = {name: sorted(p.name for p in (finished[0] / "store" / name).iterdir()) for name in ("tile", "sample")}
    rows = {}
    for tile in parts["tile"]:
        tables = [inputs.table(stage, tile) for stage in ("tile", "features", "height", "radiometry")]
        columns = {n: t[n] for t in reversed(tables) for n in t}
        mm = np.rint(np.stack([columns["x"], columns["y"]], axis=1) * 1000).astype(np.int64)
        values = np.stack([columns[n].astype(np.float32) for n in names], axis=1)
        rows |= {k: (v, p) for k, v, p in zip(canonical_key(tables[0]).tolist(), values, mm, strict=True)}
    assert len(sample["key"]) > 1000 and len(parts["sample"]) > 1
    for key, values, place in zip(sample["key"].tolist(), sample["X"], sample["place"], strict=True):
        np.testing.assert_array_equal(values, rows[key][0])
        np.testing.assert_array_equal(place, rows[key][1])
    drawn = [inputs.arrays("sample", tile, "sample")[0] for tile in parts["sample"]]
    assert all(one["X"].shape == (len(one["key"]), 0) for one in drawn)
    assert sum(len(one["key"]) for one in drawn) > len(sample["key"])
