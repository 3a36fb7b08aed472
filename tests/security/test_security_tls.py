"""The connection to a Dask scheduler is encrypted, and nobody without a certificate is let in."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from runmaker import SETTINGS

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-c", "from fwclass.cli import main; main()"]


def openssl(*words: object) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl on this machine")
    subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True)


def authority(folder: Path) -> Path:
    """A certificate authority of its own in `folder`, and one certificate for this machine that it signed."""
    folder.mkdir()
    ca, key, request, cert = (folder / n for n in ("ca.pem", "key.pem", "request.pem", "cert.pem"))
    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", 2)
    openssl("req", "-x509", *curve, "-subj", "/CN=authority", "-keyout", folder / "ca.key", "-out", ca)
    openssl("req", *curve[:5], "-subj", "/CN=127.0.0.1", "-keyout", key, "-out", request)
    openssl("x509", "-req", "-in", request, "-CA", ca, "-CAkey", folder / "ca.key", "-days", 2, "-out", cert)
    return folder


def environment(folder: Path | None) -> dict[str, str]:
    """Variables that tell Dask the certificates, as docs/security.md has them; none without a folder."""
    plain = {k: v for k, v in os.environ.items() if not k.startswith("DASK_DISTRIBUTED")}
    plain["PYTHONPATH"] = os.pathsep.join([str(ROOT), plain.get("PYTHONPATH", "")])
    if folder is None:
        return plain
    tls = {"CA_FILE": folder / "ca.pem"}
    for who in ("CLIENT", "SCHEDULER", "WORKER"):
        tls |= {f"{who}__CERT": folder / "cert.pem", f"{who}__KEY": folder / "key.pem"}
    told = {f"DASK_DISTRIBUTED__COMM__TLS__{name}": str(path) for name, path in tls.items()}
    return {**plain, **told, "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "true"}


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def answers(port: int, process: subprocess.Popen[bytes]) -> bool:
    until = time.monotonic() + 60
    while time.monotonic() < until and process.poll() is None:
        with socket.socket() as one:
            if one.connect_ex(("127.0.0.1", port)) == 0:
                return True
        time.sleep(0.2)
    return False


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return authority(tmp_path_factory.mktemp("tls") / "ours")


@pytest.fixture(scope="module")
def scheduler(certificates: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A scheduler and a worker as processes of their own, which speak TLS only."""
    folder, port = tmp_path_factory.mktemp("cluster"), free_port()
    address, processes = f"tls://127.0.0.1:{port}", []
    dask = [sys.executable, "-m", "dask"]
    try:
        for words in (
            ["scheduler", "--host", "tls://127.0.0.1", "--port", port, "--no-dashboard"],
            ["worker", address, "--host", "tls://127.0.0.1", "--nthreads", 1, "--no-dashboard", "--no-nanny"],
        ):
            log = (folder / f"{words[0]}.log").open("wb")
            processes.append(
                subprocess.Popen([*dask, *map(str, words)], env=environment(certificates), stdout=log, stderr=log)
            )
            assert answers(port, processes[-1]), (folder / f"{words[0]}.log").read_text()
        yield address
    finally:
        for process in reversed(processes):  # a worker whose scheduler has gone first looks for it for long
            process.terminate()
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(60)


def simulated(out: Path, address: str, folder: Path | None) -> subprocess.CompletedProcess[str]:
    """`fwclass run` of a tiny survey on the scheduler at `address`, with the certificates of `folder`."""
    settings = (*SETTINGS, "simulate.size=60", "simulate.strips=1", "train.trees=2")
    words = [w for s in settings for w in ("--set", s)]
    line = [*COMMAND, "run", "demo", "--out", str(out), "--scheduler", address, *words]
    return subprocess.run(line, capture_output=True, text=True, timeout=300, env=environment(folder), cwd=out.parent)


@pytest.mark.slow
def test_a_survey_runs_over_tls(scheduler: str, certificates: Path, tmp_path: Path) -> None:
    ended = simulated(tmp_path / "out", scheduler, certificates)
    assert ended.returncode == 0, ended.stderr
    assert list((tmp_path / "out" / "laz").rglob("*.laz"))


@pytest.mark.slow
def test_nobody_without_a_certificate_is_let_in(scheduler: str, tmp_path: Path) -> None:
    ended = simulated(tmp_path / "out", scheduler, None)
    assert ended.returncode == 1 and "Traceback" not in ended.stderr
    assert "no Dask scheduler answers, or not to this certificate" in ended.stderr and "ca-file" in ended.stderr
    ended = simulated(tmp_path / "out", scheduler.replace("tls://", "tcp://"), None)
    assert ended.returncode == 1 and "no Dask scheduler answers" in ended.stderr and "tls://" in ended.stderr


@pytest.mark.slow
def test_a_certificate_of_another_authority_is_not_enough(scheduler: str, tmp_path: Path) -> None:
    ended = simulated(tmp_path / "out", scheduler, authority(tmp_path / "theirs"))
    assert ended.returncode == 1 and "or not to this certificate" in ended.stderr, ended.stderr
    assert not list((tmp_path / "out").rglob("*.laz"))


LOCAL = """
import sys
from fwclass.run.cluster import Cluster

if __name__ == "__main__":
    with Cluster(None, 1, 1.0, 10) as cluster:
        client = cluster._client
        print(client.scheduler.address, *client.scheduler_info()["workers"], client.dashboard_link)
"""


@pytest.mark.slow
@pytest.mark.parametrize("encrypted", [False, True])
def test_workers_of_this_machine_listen_to_it_alone(encrypted: bool, certificates: Path, tmp_path: Path) -> None:
    """On 127.0.0.1; by TLS where the configuration of Dask asks for it."""
    script = tmp_path / "local.py"
    script.write_text(LOCAL)
    env = environment(certificates if encrypted else None)
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120, env=env)
    assert ended.returncode == 0, ended.stderr
    *found, page = ended.stdout.split()
    assert len(found) == 2 and all(a.startswith(f"{'tls' if encrypted else 'tcp'}://127.0.0.1:") for a in found)
    assert page.startswith("http://127.0.0.1:")
