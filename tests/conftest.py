"""Shared fixtures: real data that may be absent, the project's default numbers, and the maker of small files."""

from __future__ import annotations

import gc
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from hypothesis import settings

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # as in the Makefile
sys.dont_write_bytecode = False  # every process that a test starts would compile the program anew, every run the tests
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as in the command, and before numpy is there: more wait busily

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import order  # noqa: E402 - found by the path above
import tiers  # noqa: E402
from defaults import BASE  # noqa: E402

from fwclass.isolation import kernel_cache  # noqa: E402

kernel_cache()  # one for all processes of the suite, also where the user has none
settings.register_profile("same", derandomize=True)
settings.load_profile("same")  # the same examples every time; `make fuzz` draws others


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> order.Files:
    return order.Files(config, log)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--unit", action="store_true", help="the first tier: tests that start no process and no server")


def pytest_configure(config: pytest.Config) -> None:
    shares = config.getoption("dist", "no") != "no"  # pytest-xdist's own processes, whose workers watch
    if config.getoption("--unit") and not shares:
        config.pluginmanager.register(tiers.Watch(), "watch")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    return True if config.getoption("--unit") and tiers.is_elsewhere(collection_path) else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if tiers.is_unit(item):
            item.add_marker(pytest.mark.unit)
    if config.getoption("--unit"):
        config.hook.pytest_deselected(items=[item for item in items if not item.get_closest_marker("unit")])
        items[:] = [item for item in items if item.get_closest_marker("unit")]
    items.sort(key=lambda item: order.place(item.nodeid))


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()  # some million objects of modules and tests, which stay: looking through them takes a twentieth


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """What a test writes need not outlast a power cut, but where that is what is tested: a small run waited for the
    disk a third of its time."""
    if "faults" in item.path.parts:
        return (yield)
    with mock.patch("os.fsync", lambda _: None):
        return (yield)


@pytest.fixture(scope="session", autouse=True)
def temporary_files(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What helpers put into the temporary directory lies with pytest's own files, which its later runs sweep."""
    tempfile.tempdir = str(tmp_path_factory.getbasetemp())


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The directory of real samples; the test is skipped where it is absent."""
    folder = ROOT / ".." / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("no real data beside the repository (../shared/data)")
    return folder.resolve()


@pytest.fixture(scope="session")
def base() -> dict[str, Any]:
    """`conf/base.yaml` as it stands."""
    return BASE
