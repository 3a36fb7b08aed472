"""What `conf/site/` says to the tools that start clusters."""

from __future__ import annotations

from pathlib import Path

import dask.config
import pytest
import yaml

SITE = Path(__file__).resolve().parents[2] / "conf" / "site"


@pytest.mark.parametrize("name", ["slurm", "pbs"])
def test_jobs_have_workers_of_one_thread_with_the_memory_of_the_base(name, base):
    found = dask.config.collect([str(SITE / f"{name}.yaml")], env={})
    job = found["jobqueue"][name]
    assert job["processes"] == job["cores"]
    memory = dask.utils.parse_bytes(job["memory"]) / job["processes"] / 2**30
    assert memory >= base["run"]["worker_memory_gib"] + 1


def test_the_cluster_of_kubernetes_hangs_together(base):
    cluster, scaler, job = yaml.safe_load_all((SITE / "kubernetes.yaml").read_text())
    name = cluster["metadata"]["name"]
    assert scaler["spec"]["cluster"] == name
    [scheduler] = [s for s in job["spec"]["template"]["spec"]["containers"][0]["args"] if s.startswith("tcp://")]
    ports = {p["name"]: p["port"] for p in cluster["spec"]["scheduler"]["service"]["ports"]}
    assert scheduler == f"tcp://{name}-scheduler:{ports['tcp-comm']}"
    pods = (cluster["spec"]["worker"]["spec"], cluster["spec"]["scheduler"]["spec"], job["spec"]["template"]["spec"])
    assert len({pod["containers"][0]["image"] for pod in pods}) == 1
    for pod in pods[::2]:  # worker and command keep copies
        gib = float(pod["volumes"][-1]["emptyDir"]["sizeLimit"].removesuffix("Gi"))
        assert gib > base["store"]["scratch_gib"]
    args = pods[0]["containers"][0]["args"]
    assert args[args.index("--nthreads") + 1] == "1"


@pytest.mark.parametrize("site", ["kubernetes", "pbs", "slurm"])
def test_workers_of_a_site_go_on_whatever_they_hold_between_two_parts(site):
    assert "DASK_DISTRIBUTED__WORKER__MEMORY__PAUSE" in (SITE / f"{site}.yaml").read_text()
