"""Hosts with networks, names and directories of their own (Linux namespaces; root alone may make them): the scheduler,
two workers and the command see the S3 server and each other, and nothing else. One worker's cable is pulled."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from manyhosts import LIMIT, Hosts, receipts, until
from objectstore import serving
from runmaker import delivered

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0 or not shutil.which("ip"), reason="root makes networks"),
]

NET = "10.213.87"
NAMES = ("scheduler", "first", "second", "driver")
BRIDGE = "fwclass0"


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


def cable(name: str) -> str:
    return f"fwc-{name}"


@pytest.fixture
def network() -> Iterator[str]:
    """A bridge and a namespace for every host; the bridge's address."""
    try:
        ip("link", "add", BRIDGE, "type", "bridge")
    except subprocess.CalledProcessError as fault:
        pytest.skip(f"no networks can be made here: {fault.stderr}")
    try:
        ip("addr", "add", f"{NET}.1/24", "dev", BRIDGE)
        ip("link", "set", BRIDGE, "up")
        for k, name in enumerate(NAMES):
            space = cable(name)
            ip("netns", "add", space)
            ip("link", "add", space, "type", "veth", "peer", "name", "eth0", "netns", space)
            ip("link", "set", space, "master", BRIDGE, "up")
            ip("-n", space, "addr", "add", f"{NET}.{k + 2}/24", "dev", "eth0")
            ip("-n", space, "link", "set", "eth0", "up")
            ip("-n", space, "link", "set", "lo", "up")
        inside = "hostname probe && mount -t tmpfs none /mnt"
        probe = ["ip", "netns", "exec", cable("driver"), "unshare", "--uts", "--mount", "sh", "-c", inside]
        if subprocess.run(probe, check=False, capture_output=True).returncode:
            pytest.skip("no file systems of their own can be mounted here")
        yield f"{NET}.1"
    finally:
        for name in NAMES:
            subprocess.run(["ip", "netns", "del", cable(name)], check=False, capture_output=True)
        subprocess.run(["ip", "link", "del", BRIDGE], check=False, capture_output=True)


class Apart(Hosts):
    """Hosts whose processes have a network, a host name, and none of the others' directories nor the survey's."""

    hidden: tuple[Path, ...] = ()

    def entered(self, name: str) -> list[str]:
        others = [self._root / n for n in NAMES if n != name]
        for path in others:
            path.mkdir(exist_ok=True)
        mounts = "".join(f"mount -t tmpfs none '{p}' && " for p in (*others, *self.hidden))
        inside = f'hostname {name} && {mounts}exec "$@"'
        return ["ip", "netns", "exec", cable(name), "unshare", "--uts", "--mount", "sh", "-c", inside, "--"]


def test_hosts_that_see_nothing_but_each_other_and_one_falls_silent(network, survey, finished, tmp_path):
    with serving(network) as s3:
        place, out = s3.url("survey"), s3.url()
        s3.write_all(place, survey, "strips", "reference")
        s3.write(place / "trajectory.csv", (survey / "trajectory.csv").read_bytes())
        hosts = Apart(s3, tmp_path, f"{NET}.2")
        hosts.hidden = (survey, finished[0])
        try:
            address = hosts.scheduler()
            assert address.startswith(f"tcp://{NET}.2:")
            hosts.worker("first", address)
            hosts.worker("second", address)
            run = hosts.run("driver", place, out, "--scheduler", address)
            until(lambda: receipts(s3, out) > 30, run)
            ip("link", "set", cable("first"), "down")
            assert run.wait(LIMIT) == 0, hosts.log("driver").read_text()
        finally:
            hosts.stop()
        made = {key.rpartition("/")[2]: value for key, value in s3.read(out).items() if "/logs/" in f"/{key}"}
        told = b"".join(made.values())
        assert b"host=second" in told and b"host=driver" not in told
        assert s3.delivered(out) == delivered(finished[0])
