"""A small simulated survey, made once, and a run over it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from commandline import coarse
from runmaker import SETTINGS, walk

from fwclass import conf
from fwclass.graph.simulation import simulation
from fwclass.graph.stage import Plan
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner


@pytest.fixture(autouse=True)
def coarse_pictures() -> Iterator[None]:
    """Of one test: tests of other directories draw as users see it."""
    with coarse():
        yield


@pytest.fixture(scope="session")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two strips over 80 m x 80 m with their reference."""
    root = tmp_path_factory.mktemp("survey")
    with Display() as display:
        runner = Runner(root, Loop(), display)
        config = conf.load("demo", SETTINGS)
        runner.do(simulation(".").tasks(Plan(config)))
        assert not runner.failures
    return root


@pytest.fixture(scope="session")
def finished(survey: Path, tmp_path_factory: pytest.TempPathFactory):
    """The survey run in the plain loop: (root, report)."""
    root = tmp_path_factory.mktemp("loop")
    runner, report = walk(survey, root)
    assert not runner.failures, runner.failures
    return root, report


@pytest.fixture(scope="session")
def begun(finished, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Makes run directories in which the survey is read and its features are there: a run that asks for something else
    makes only that, which `test_run_resume.py` holds to be what it makes from the beginning."""

    def make(name: str) -> Path:
        root = tmp_path_factory.mktemp(name) / "run"
        shutil.copytree(finished[0] / "store", root / "store", symlinks=True)
        return root

    return make
