"""The wheel: it claims no top-level name but `fwclass`, and a fresh environment runs a workflow from it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from smallsurvey import small_survey

ROOT = Path(__file__).resolve().parents[1]
OWN = """from fwclass.workflows.ground import ground
from fwclass.graph.own_stage import delivery_stage

def write(table, directory, tile):
    (directory / f"{tile}.txt").write_text(str(table.rows))

workflow = ground.with_stage(delivery_stage("rows", write, reads=("z",)), after="publish-tile")
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    words = ("-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", out, ROOT)
    made = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, timeout=300)
    if made.returncode and any(w in made.stderr for w in ("No matching distribution", "Connection", "resolve")):
        pytest.skip("no package index within reach, and the wheel's builder is not installed")
    assert made.returncode == 0, made.stderr
    return next(out.glob("*.whl"))


@pytest.mark.slow
def test_the_wheel_claims_one_name(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {n.split("/")[0] for n in names} == {
        "fwclass",
        next(n for n in names if n.endswith("/RECORD")).split("/")[0],
    }
    here = {p.name for p in (ROOT / "workflows").glob("*.py")}
    assert {n.split("/")[-1] for n in names if n.startswith("fwclass/_workflows/")} == here
    assert "fwclass/_conf/base.yaml" in names and not any("/tests/" in n or n.endswith(".pyc") for n in names)


@pytest.mark.slow
def test_a_fresh_environment_runs_workflows_from_the_wheel(wheel: Path, tmp_path: Path) -> None:
    venv.create(tmp_path / "venv", with_pip=False)
    python = tmp_path / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"
    lib = subprocess.check_output([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], text=True)
    into = Path(lib.strip())
    words = (sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", into, wheel)
    subprocess.run(list(map(str, words)), check=True, timeout=300)
    (into / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")  # what it needs, and no link to the checkout
    (into / "workflows").mkdir()
    (into / "workflows" / "__init__.py").write_text("raise ImportError('another program of this name')")
    place = tmp_path / "survey"
    place.mkdir()
    small_survey(place)
    (place / "own.py").write_text(OWN)

    def run(*more: str | Path) -> subprocess.CompletedProcess[str]:
        line = [python, "-m", "fwclass", *more]
        return subprocess.run(list(map(str, line)), cwd=tmp_path, capture_output=True, text=True, timeout=300)

    where = subprocess.check_output([python, "-c", "import fwclass; print(fwclass.__file__)"], text=True, cwd=tmp_path)
    assert Path(where.strip()).is_relative_to(into)
    for workflow, out, workers in (("ground", "a", "2"), (place / "own.py", "b", "0")):
        words = ("run", place / "s.yaml", "--workflow", workflow, "--out", tmp_path / out, "--workers", workers)
        done = run(*words)
        assert done.returncode == 0, done.stderr
        assert json.loads((tmp_path / out / "report.json").read_text())["ground"]["ground"] > 1000
