"""What sets the program apart: tile size, chunk size, workers and order change nothing."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster
from runmaker import delivered, walk

from fwclass.run.cluster import Cluster

COLUMNS = [
    "strip",
    "pulse",
    "echo_number",
    "x",
    "y",
    "z",
    "classification",
    "confidence",
    "ground",
    "height_above_ground",
    "zc",
    "echo_ratio_r100",
    "inclination_r100",
    "amplitude",
    "width",
    "energy",
    "range_sigma",
    "deviation",
    "amplitude_db",
    "range",
    "incidence",
    "cross_section",
    "backscatter",
    "reflectance",
]


def echoes(root: Path) -> dict[str, np.ndarray]:
    """Every echo of the delivered tiles, by identity."""
    parts = [pq.read_table(p, columns=COLUMNS) for p in sorted((root / "parquet").glob("*.parquet"))]
    columns = {n: np.concatenate([p.column(n).to_numpy() for p in parts]) for n in COLUMNS}
    order = np.lexsort((columns["echo_number"], columns["pulse"], columns["strip"]))
    return {n: v[order] for n, v in columns.items()}


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["tile.size=37.5", "tile.size=12.8", "tile.size=1000", "read.chunk_pulses=2500"])
def test_tiles_and_chunks_change_no_number_of_any_echo(setting, survey, finished, tmp_path):
    road, report = walk(survey, tmp_path, setting)
    assert not road.failures
    before, after = echoes(finished[0]), echoes(tmp_path)
    for name in COLUMNS:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)
    assert report["accuracy"] == finished[1]["accuracy"]
    assert report["distribution"] == finished[1]["distribution"]


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_workers_give_the_same_bytes_as_the_loop(workers, survey, finished, tmp_path):
    road, _ = walk(survey, tmp_path, executor=Cluster(None, workers, 4.0, 1000))
    assert not road.failures
    assert delivered(tmp_path) == delivered(finished[0])


@pytest.mark.slow
def test_a_scheduler_by_address_gives_the_same_bytes(survey, finished, tmp_path):
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster:
        road, _ = walk(survey, tmp_path, executor=Cluster(cluster.scheduler_address, 0, 4.0, 1000))
    assert not road.failures
    assert delivered(tmp_path) == delivered(finished[0])


def test_the_count_of_echoes_is_kept(finished):
    counts = finished[1]["counts"]
    assert counts["echoes_decomposed"] == counts["echoes_in_tiles"] == len(echoes(finished[0])["x"]) > 10_000


def test_the_forest_is_better_than_the_commonest_class(finished):
    """Kappa is 0 for a forest that always answers the commonest class."""
    assert finished[1]["accuracy"]["kappa"] > 0.4
