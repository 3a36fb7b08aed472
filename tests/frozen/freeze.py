"""Digests of what runs and single-file commands deliver, to hold a refactored program against the one before it.

`python tests/frozen/freeze.py record DIRECTORY FILE` runs everything below DIRECTORY and writes the digests;
`python tests/frozen/freeze.py compare BEFORE AFTER` names what differs and ends with 1. Both records are to be made on
one machine: another processor may round otherwise. `--root TREE` records the program of another checkout, `--only p1`
(more than once) one run of them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
RUNS = {  # name: arguments of `fwclass run`
    "demo": ["demo"],  # strips of more than `pulse.sample` pulses
    "thinned": ["demo", "--set", "thin.rate=0.5"],
    "riegl-sample": ["riegl-sample"],
    "p1": ["p1"],
    "fan2013": ["fan2013-urban", "--workflow", "fan2013"],
}
REAL = ("riegl-sample", "p1", "fan2013")
STRIP = "demo/survey/strips/strip_01.las"
FILES = {  # name: arguments of a command on one file, with its output
    "decompose": ["decompose", STRIP, "{out}/decomposed.laz"],
    "ground": ["ground", STRIP, "{out}/ground.laz"],
    "normalize": ["normalize", "{out}/ground.laz", "{out}/normalized.laz"],
    "features": ["features", "{out}/ground.laz", "{out}/features.parquet", "--skip-missing"],
    "classify": ["classify", STRIP, "--model", "demo/model", "{out}/classified.laz"],
}
CHANGING = ("report.html", "report.json", "run.json", "fan2013.html", "fan2013.json")
"""Files with times and version numbers of libraries in them."""


def run(words: list[str], directory: Path, root: Path) -> None:
    """Run a command of the program below `root`; what it says is shown where it fails."""
    environment = {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, "-m", "fwclass", *words], cwd=directory, env=environment, capture_output=True, text=True
    )
    if done.returncode not in (0, 4):
        sys.exit(f"{' '.join(words)}: exit {done.returncode}\n{done.stderr[-3000:]}")


def digests(directory: Path) -> dict[str, str]:
    """Digest of every delivered file below `directory`, and the key of every receipt."""
    out: dict[str, str] = {}
    walk = os.walk(directory, followlinks=True)  # `laz`, `parquet`, `rasters` and `model` are links
    for path in sorted(Path(below) / name for below, _, names in walk for name in names):
        name = path.relative_to(directory).as_posix()
        if path.name in CHANGING or name.startswith(("current/", "generations/", "survey/", "logs/", "history")):
            continue
        if name.startswith("store/"):
            if path.name == "receipt.json":
                out[f"key {name.removesuffix('/receipt.json')}"] = json.loads(path.read_text())["key"]
            continue
        out[name] = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    return out


def record(directory: Path, to: Path, root: Path, only: list[str]) -> None:
    directory.mkdir(parents=True, exist_ok=True)
    kept: dict[str, dict[str, str]] = {}
    for name, words in RUNS.items():
        if only and name not in only:
            continue
        if name in REAL and not DATA.is_dir():
            print(f"{name:<14} left out: {DATA} is no directory")
            continue
        survey = root / "conf" / "surveys" / f"{words[0]}.yaml"
        real = (
            ["--set", f"survey.directory={DATA / ('waveform' if name == 'riegl-sample' else 'ign_hd')}"]
            if name in REAL
            else []
        )
        run(["run", str(survey), *words[1:], *real, "--out", name], directory, root)
        kept[name] = digests(directory / name)
    if not only or "files" in only:
        files = directory / "files"
        shutil.rmtree(files, ignore_errors=True)
        files.mkdir()
        for words in FILES.values():
            run([w.format(out="files") for w in words], directory, root)
        kept["files"] = digests(files)
    to.write_text(json.dumps(kept, indent=1, sort_keys=True))


def compare(before: Path, after: Path) -> int:
    """Print what differs; the number of deliveries that do (keys are counted, not held)."""
    old, new = json.loads(before.read_text()), json.loads(after.read_text())
    wrong = 0
    for run_name in sorted({*old, *new}):
        a, b = old.get(run_name, {}), new.get(run_name, {})
        differ = sorted(n for n in {*a, *b} if a.get(n) != b.get(n))
        files = [n for n in differ if not n.startswith("key ")]
        keys = len(differ) - len(files)
        print(f"{run_name}: {len(a)} before, {len(b)} after; {len(files)} deliveries and {keys} keys differ")
        for name in files[:20]:
            print(f"  {name}: {a.get(name)} -> {b.get(name)}")
        wrong += len(files)
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    parser.add_argument("--root", type=Path, default=ROOT)
    parser.add_argument("--only", action="append", choices=(*RUNS, "files"), default=[], help="`files` needs `demo`")
    asked = parser.parse_args()
    if asked.what == "compare":
        sys.exit(compare(asked.first, asked.second) > 0)
    record(asked.first.resolve(), asked.second.resolve(), asked.root.resolve(), asked.only)


if __name__ == "__main__":
    main()
