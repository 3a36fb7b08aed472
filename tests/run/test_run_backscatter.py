"""Voxels, profiles, samples as points and stacked echoes through a whole run; nothing is classified, so no class,
label or training area is asked for."""

import hashlib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr
from commandline import fwclass
from rawmaker import scene, write_parquet
from runmaker import walk

from fwclass.workflows import WORKFLOWS

pytestmark = pytest.mark.slow

HEAD = {"crs": "EPSG:32632", "spacing_ns": "1.0"}
PRODUCTS = ("voxels.write=true", "profile.write=true", "samples.write=true", "stack.enabled=true", "stack.gap=0.5")


@pytest.fixture(scope="module")
def made(survey, tmp_path_factory):
    root = tmp_path_factory.mktemp("backscatter")
    runner, report = walk(survey, root, *PRODUCTS, workflow="backscatter")
    assert not runner.failures, runner.failures
    listed = report["outputs"]["backscatter"]
    assert {"voxels.zarr", "profiles.zarr"} < set(listed) and any(n.startswith("samples/") for n in listed)
    assert report["outputs"]["other"] == []
    return root, report


def arrays(root, name):
    group = zarr.open_group(str(root / name), mode="r")
    return group, {n: group[n][...] for n in group.array_keys()}


def samples(root):
    tables = [pq.read_table(p) for p in sorted((root / "samples").glob("*.parquet"))]
    return {
        n: np.concatenate([t.column(n).to_numpy() for t in tables]) for n in ("x", "y", "z", "returned_energy", "share")
    }


def test_voxels_hold_what_the_samples_sent_back(made):
    root, _ = made
    group, v = arrays(root, "voxels.zarr")
    points = samples(root)
    size = group.attrs["cell_size_m"]
    inside = np.ones(len(points["x"]), bool)
    index = []
    for axis in "zyx":
        cell = np.floor((points[axis] - (v[axis][0] - 0.5 * size)) / size).astype(int)
        inside &= (cell >= 0) & (cell < len(v[axis]))
        index.append(cell)
    assert inside.mean() > 0.98  # the voxels reach from the lowest to the highest echo of a block
    again = np.zeros(v["hits"].shape)
    np.add.at(again, tuple(c[inside] for c in index), points["returned_energy"][inside])
    there = v["returned_energy"] > 0
    assert np.allclose(again[there], v["returned_energy"][there], rtol=1e-5)
    assert again[~there].sum() <= 0.01 * again.sum()


def test_beams_pass_until_their_light_is_spent(made):
    root, report = made
    _, v = arrays(root, "voxels.zarr")
    assert v["hits"].sum() > 0.98 * report["counts"]["echoes_in_tiles"]
    assert (v["entering"] <= v["passes"] + 1e-3).all()
    assert (v["path"] <= np.sqrt(3.0) * v["passes"] + 1e-3).all()
    assert (v["passes"] > 0)[v["hits"] > 0].mean() > 0.999
    assert (v["intercepted"] <= v["entering"] + 1e-3)[v["hits"] > 0].mean() > 0.998
    assert v["intercepted"].sum() == pytest.approx(report["counts"]["pulses"], rel=0.03)
    below = v["occluded"] > 0
    assert below.any() and np.cumsum(v["hits"][::-1], axis=0)[::-1][below].astype(bool).mean() > 0.8  # beneath echoes


def test_profiles_are_shares_of_a_metre(made):
    root, _ = made
    group, p = arrays(root, "profiles.zarr")
    there = p["pulses"] > 0
    assert there.any() and np.isnan(p["cover"][~there]).all()
    step = np.diff(p["height"]).mean()
    assert np.allclose(p["profile"][:, there].sum(axis=0) * step, 1.0, atol=1e-4)
    assert (np.diff(p["relative_height"][:, there], axis=0) >= -1e-5).all()
    assert ((p["cover"][there] >= 0.0) & (p["cover"][there] <= 1.0)).all()
    assert p["percent"].tolist() == [25, 50, 75, 90, 95, 98, 100] and "PROJCRS" in group.attrs["crs_wkt"]


def digests(root):
    names = [p for p in sorted(root.glob("*")) if p.name in ("voxels.zarr", "profiles.zarr", "samples", "stacked")]
    files = [f for n in names for f in sorted(n.rglob("*")) if f.is_file()]
    return {str(f.relative_to(root)): hashlib.blake2b(f.read_bytes()).hexdigest() for f in files}


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["tile.size=37.5", "read.chunk_pulses=2500"])
def test_tiles_and_chunks_change_no_byte(setting, survey, made, tmp_path):
    runner, _ = walk(survey, tmp_path, *PRODUCTS, setting, workflow="backscatter")
    assert not runner.failures
    one, two = digests(made[0]), digests(tmp_path)
    assert one == two and any(n.startswith("voxels.zarr") for n in one)


def test_the_workflow_has_stages_of_the_classification_in_its_order():
    order = [s.name for s in WORKFLOWS["classification"].stages]
    places = [order.index(s.name) for s in WORKFLOWS["backscatter"].stages]
    assert places == sorted(places)


@pytest.mark.parametrize("command", ["voxels", "profile"])
def test_a_survey_without_classes(tmp_path: Path, command: str) -> None:
    write_parquet(tmp_path / "a.parquet", scene(pulses=300).columns(), HEAD)
    (tmp_path / "s.yaml").write_text("survey: {name: s, directory: ., sources: [a.parquet]}\n")
    for source, root in (("s.yaml", "survey"), ("a.parquet", "file")):
        ended = fwclass(command, tmp_path / source, "--out", tmp_path / root, "--workers", 0)
        assert ended.returncode == 0, ended.stderr
    one, other = (zarr.open_group(next((tmp_path / r).glob("*.zarr")), mode="r") for r in ("survey", "file"))
    assert sorted(one) == sorted(other) and len(list(one))
    for name in one:
        np.testing.assert_array_equal(one[name][...], other[name][...])
    other = {"voxels": "profile", "profile": "voxels"}[command]
    ended = fwclass(other, tmp_path / "s.yaml", "--out", tmp_path / "survey", "--workers", 0)
    assert ended.returncode == 0 and "of an earlier delivery" in ended.stderr, ended.stderr


def test_the_store_of_a_classified_run_serves(tmp_path: Path) -> None:
    write_parquet(tmp_path / "a.parquet", scene(pulses=300).columns(), HEAD)
    (tmp_path / "s.yaml").write_text("survey: {name: s, directory: ., sources: [a.parquet]}\n")
    assert (
        fwclass("run", tmp_path / "s.yaml", "--out", tmp_path / "r", "--workers", 0, "--workflow", "ground").returncode
        == 0
    )
    ended = fwclass("voxels", tmp_path / "s.yaml", "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 0
    lines = {words[0]: line for line in ended.stderr.splitlines() if (words := line.split())}
    for stage in ("read", "pulse", "decompose", "tile", "ground"):
        assert "computed" not in lines.get(stage, ""), lines[stage]
