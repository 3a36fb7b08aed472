"""A configuration is read, and a workflow is named, without what the work needs: commands start at once."""

from __future__ import annotations

import subprocess
import sys

import pytest

from fwclass import conf
from fwclass.conf import files
from fwclass.workflows import WORKFLOWS

HEAVY = {"numba", "scipy", "matplotlib", "pyproj", "rasterio", "pyogrio", "laspy", "pyarrow", "zarr", "dask"}


@pytest.mark.parametrize(
    "statement",
    [
        "import fwclass.conf",
        "from fwclass.workflows import WORKFLOWS; 'classification' in WORKFLOWS",
        "import fwclass.cli",
    ],
)
def test_nothing_heavy_is_loaded(statement: str) -> None:
    line = [sys.executable, "-c", f"import sys; {statement}; print(*sys.modules)"]
    loaded = subprocess.run(line, capture_output=True, text=True, check=True, timeout=60).stdout.split()
    assert "sys" in loaded and not HEAVY & set(loaded)


def test_a_section_alone_is_copied_where_it_alone_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command on one file asks for some twenty, and copied all of them each time."""
    copied: list[object] = []
    copy = files._copy
    monkeypatch.setattr(files, "_copy", lambda value: [copied.append(value), copy(value)][1])
    whole = files.read(files.conf_directory() / "base.yaml")
    every = len(copied)
    copied.clear()
    assert conf.section("features") == conf.checked("features", whole["features"], "base.yaml")
    assert 0 < len(copied) < every / 10


def test_every_workflow_is_a_function_of_its_name() -> None:
    assert len(WORKFLOWS) == len(list(WORKFLOWS)) >= 3
    for name in WORKFLOWS:
        workflow = WORKFLOWS[name]
        assert workflow.name == name and workflow.what and (workflow.stages or workflow.walk)
    assert "nonsense" not in WORKFLOWS
    with pytest.raises(KeyError):
        WORKFLOWS["nonsense"]
