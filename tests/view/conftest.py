"""A small finished run with waveforms and a reference, its viewer's server, and smaller runs that tests may change."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from runmaker import SETTINGS, walk
from smallsurvey import deliver, small_survey

from fwclass import conf
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.graph.simulation import simulation
from fwclass.graph.stage import Plan
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.view.server import Server

FEATURES = "survey.features=[zc, echo_number, amplitude, width, echo_ratio_r100]"


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two strips of 120 m × 120 m in tiles of 40 m."""
    root = tmp_path_factory.mktemp("viewed")
    with Display() as display:
        runner = Runner(root / "survey", Loop(), display)
        runner.do(simulation(".").tasks(Plan(conf.load("demo", SETTINGS))))
        assert not runner.failures
    walk(root / "survey", root / "run", FEATURES, "tile.size=40")
    return root / "run"


@pytest.fixture(scope="session")
def scene(run: Path) -> ViewedRun:
    return ViewedRun(open_run(run), conf.section("view", ("view.block=2000", "view.together=6000")))


@pytest.fixture
def server(scene: ViewedRun) -> Iterator[Server]:
    """Hears a request for two seconds, of eight at a time."""
    with Server([scene], conf.section("view", ("view.request=2.0", "view.connections=8"))) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture(scope="session")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a survey of 6000 discrete returns and its finished run."""
    place = tmp_path_factory.mktemp("small")
    small_survey(place, tile=25)
    deliver(place)
    return place


@pytest.fixture
def small_run(pristine: Path, tmp_path: Path) -> Path:
    """That run, for one test."""
    shutil.copytree(pristine, tmp_path / "survey", symlinks=True)
    return tmp_path / "survey" / "run"
