"""A stage of the program's own, added as docs/extending.md says: four files, and it is planned, drawn and run."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

RECORD = '''"""How many echoes of a tile stand high."""

from __future__ import annotations

from fwclass.graph.stage import Stage
from fwclass.graph.stage_work import Result, StageInputs


def count_high(here: StageInputs, least: float) -> Result:
    """Echoes of a tile that stand `least` [m] above ground, at least."""
    table = here.rows()
    return {"rows": table.rows, "high": int((table["height_above_ground"] >= least).sum())}


COUNT_HIGH = Stage(
    "high-counts", 1, "tile", "echo", count_high, arguments=lambda plan: {"least": 2.0}, own=("height_above_ground",)
)
'''

RUN = """
import sys
sys.path.insert(0, sys.argv[1])
from runmaker import walk
runner, report = walk(sys.argv[2], __import__("pathlib").Path(sys.argv[3]))
assert not runner.failures, runner.failures
"""


def replaced(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1, f"{old!r} in {path}"
    path.write_text(text.replace(old, new))


@pytest.fixture(scope="module")
def changed(tmp_path_factory):
    """A copy of the program with one stage more."""
    tree = tmp_path_factory.mktemp("tree")
    for package in ("fwclass", "workflows", "conf"):
        shutil.copytree(ROOT / package, tree / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tree)
    (tree / "fwclass" / "graph" / "high.py").write_text(RECORD)
    stages = tree / "fwclass" / "graph" / "stages.py"
    replaced(stages, "JUDGING = (", "JUDGING = (COUNT_HIGH, ")
    replaced(
        stages,
        "from fwclass.graph.label import",
        "from fwclass.graph.high import COUNT_HIGH\nfrom fwclass.graph.label import",
    )
    costs = "  stages: "
    text = (tree / "conf" / "base.yaml").read_text().splitlines(keepends=True)
    at = next(k for k, line in enumerate(text) if line.startswith(costs))
    text.insert(at + 1, "    high-counts: {part: 2.0, each: 0.1, stored: 0.0, waves: 0.0, held: 60.0}\n")
    (tree / "conf" / "base.yaml").write_text("".join(text))
    replaced(tree / "pyproject.toml", "assess | features | ground | label", "assess | features | ground | high | label")
    return tree


def python(tree: Path, *words: object) -> str:
    ended = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.mark.slow
def test_a_stage_of_four_files_is_planned_and_its_imports_hold(changed):
    stages = {s["name"]: s for s in json.loads(python(changed, "-m", "fwclass", "plan", "demo", "--json"))["stages"]}
    assert stages["high-counts"]["unit"] == "echo" and stages["high-counts"]["seconds"] > 0
    assert stages["high-counts"]["parts"] == stages["features"]["parts"]
    assert "high-counts" in python(changed, "-m", "fwclass", "plan", "demo", "--graph")
    lint = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    ended = subprocess.run(lint, cwd=changed, env={**os.environ, "PYTHONPATH": str(changed)}, capture_output=True)
    assert ended.returncode == 0, ended.stdout.decode()


@pytest.mark.slow
def test_it_runs_and_nothing_else_does(changed, survey, finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run, symlinks=True)
    python(changed, "-c", RUN, ROOT / "tests", survey, run)
    report = json.loads((run / "report.json").read_text())
    made = {s["name"]: s["computed"] for s in report["stages"] if s["computed"]}
    assert made == {"high-counts": len(list((run / "store" / "tile").iterdir()))}
    high = [json.loads(p.read_text())["meta"] for p in (run / "store" / "high-counts").glob("*/receipt.json")]
    assert 0 < sum(m["high"] for m in high) < sum(m["rows"] for m in high) == report["counts"]["echoes_in_tiles"]
