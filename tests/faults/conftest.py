"""A small simulated survey, and an undisturbed run over it to compare with."""

from __future__ import annotations

from pathlib import Path

import pytest
from faultmaker import SMALL, running, words
from runmaker import SETTINGS, delivered

from fwclass import conf
from fwclass.graph.simulation import simulation
from fwclass.graph.stage import Plan
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner


@pytest.fixture(scope="session")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One strip with its reference."""
    root = tmp_path_factory.mktemp("survey")
    with Display() as display:
        runner = Runner(root, Loop(), display)
        runner.do(simulation(".").tasks(Plan(conf.load("demo", (*SETTINGS, *SMALL)))))
        assert not runner.failures
    return root


@pytest.fixture(scope="session")
def finished(survey: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run directory of an undisturbed run."""
    root = tmp_path_factory.mktemp("undisturbed") / "run"
    with running(root.parent / "told", *words(survey, root), "--workers", "0") as run:
        assert run.code() == 0, run.said
    return root


@pytest.fixture(scope="session")
def expected(finished: Path) -> dict[str, str]:
    """Digest of every file that an undisturbed run delivers."""
    return delivered(finished)
