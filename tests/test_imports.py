"""The import contracts of pyproject.toml, attacked: each breach below is planted on a copy, and each must be named."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FORBIDDEN = [  # file, what it shall not import
    ("fwclass/graph/files.py", "dask"),
    ("fwclass/graph/report.py", "distributed"),
    ("fwclass/operate/history.py", "dask"),
    ("fwclass/features/sums.py", "pydantic"),
    ("fwclass/features/sums.py", "yaml"),
    ("fwclass/features/sums.py", "click"),
    ("fwclass/run/progress.py", "zarr"),
    ("fwclass/read/las.py", "obstore"),
    ("fwclass/run/part.py", "fwclass.operate.schedule.loop"),
    ("fwclass/read/las.py", "fwclass.decompose.stage"),
    ("fwclass/run/tasks.py", "fwclass.run.runner"),
    ("fwclass/store/atomic.py", "fwclass.store.run_store"),
    ("fwclass/novelty/__init__.py", "dask"),
]


def test_every_planted_breach_is_caught(tmp_path: Path) -> None:
    for package in ("fwclass", "workflows"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for name, imported in FORBIDDEN:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"{path.read_text() if path.exists() else ''}\nimport {imported}\n")
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "COLUMNS": "400"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    said = re.sub(r"\s+", " ", done.stdout)
    assert done.returncode == 1, done.stdout + done.stderr
    for name, imported in FORBIDDEN:
        module = name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        assert f"{module} -> {imported} " in said, f"{module} -> {imported} passes\n{done.stdout}"
    assert re.search(r"not listed as layers:.{0,80}fwclass[.]novelty", said), "a room that no contract lists passes"
