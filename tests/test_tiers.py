"""What starts a process or a server is no unit test, and fails as one where the rule does not see it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CONFTEST = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
import tiers
tiers.TESTS = Path(__file__).parent

def pytest_configure(config):
    config.pluginmanager.register(tiers.Watch())

def pytest_collection_modifyitems(items):
    print("unit:", *(item.name for item in items if tiers.is_unit(item)))
"""
TESTS = """
import contextlib, importlib, multiprocessing, os, socket, subprocess
from dataclasses import dataclass
import pytest
from fwclass.cli import main

def helper():
    return subprocess.run(["true"])

@dataclass
class Server:
    def __enter__(self):
        return socket.socket()

@pytest.fixture
def server():
    with Server() as made:
        yield made

@pytest.fixture
def place(tmp_path):
    return tmp_path

def test_plain(place): assert place.exists()
def test_names_a_module(): subprocess.run(["true"])
def test_by_a_helper(): helper()
def test_by_a_fixture(server): server.bind(("127.0.0.1", 0))
def test_imports_inside():
    from multiprocessing import Process
    Process(target=int).start()
def test_runs_commands(): main()
@pytest.mark.slow
def test_slow(): pass

def hidden(name): return importlib.import_module(name)
def test_loads_matplotlib(): hidden("matplotlib.text")
def test_hidden_and_caught():
    with contextlib.suppress(Exception):
        hidden("sub" + "process").run(["true"])
def test_hidden_shell(): os.system("true")
def test_hidden_fork():
    if os.fork() == 0:
        os._exit(0)
def test_hidden_server(): hidden("sock" + "et").create_server(("127.0.0.1", 0))
def test_hidden_worker(): hidden("multi" + "processing").get_context("spawn").Process(target=int).start()
"""
PLAIN = {"test_plain", "test_loads_matplotlib"}
HIDDEN = {f"test_hidden_{what}" for what in ("and_caught", "shell", "fork", "server", "worker")}


def test_what_starts_something_is_not_chosen_or_fails(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST.format(tests=str(Path(__file__).parent)))
    (tmp_path / "test_made.py").write_text(TESTS)
    line = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", "-rA", "-s", str(tmp_path)]
    fresh = {**os.environ, "MPLCONFIGDIR": str(tmp_path / "fresh")}  # a machine that has never drawn
    told = subprocess.run(line, capture_output=True, text=True, cwd=tmp_path, env=fresh, timeout=300).stdout
    (chosen,) = (line.split()[1:] for line in told.splitlines() if line.startswith("unit:"))
    assert set(chosen) == {*PLAIN, *HIDDEN}
    ended = {word.rpartition("::")[2] for word in told.split() if word.startswith("test_made.py::")}
    assert ended >= {*PLAIN, *HIDDEN}
    passed = {line.rpartition("::")[2] for line in told.splitlines() if line.startswith("PASSED")}
    spoilt = {
        line.split(" - ")[0].rpartition("::")[2] for line in told.splitlines() if line.startswith(("FAILED", "ERROR"))
    }
    assert spoilt >= HIDDEN and passed - spoilt >= PLAIN
