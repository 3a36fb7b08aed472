"""Write `conf/kernels.json`: the kernels that the program calls, and the types of their arguments.

`python tests/kernels/record.py DIRECTORY` runs the commands below in DIRECTORY, some minutes, and adds what they call
to the list. Real data is taken from `../shared/data` where there is any.
"""

from __future__ import annotations

import _thread
import argparse
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
LIST = ROOT / "conf" / "kernels.json"
STRIP = "demo/survey/strips/strip_01.las"
FILTERS = ("slope", "pmf", "smrf", "moving-surface", "ptd", "iptd", "csf", "csf+smrf", "consensus")
SETS = ("default", "default-waveform", "fan2013", "xiong2018", "shi2019")
COMMANDS = [
    "demo --out demo --workers 0",
    *(f"ground {STRIP} ground-{name}.laz --method {name}" for name in FILTERS),
    f"ground {STRIP} auto.laz --auto",
    f"ground {STRIP} low.laz --set ground.noise.surface=true",
    *(f"normalize ground-smrf.laz by-{name}.laz --height {name}" for name in ("tin", "nearest", "raster")),
    f"decompose {STRIP} decomposed.laz",
    f"info --waveforms {STRIP}",
    *(f"features ground-smrf.laz {name}.parquet --set {name} --skip-missing" for name in SETS),
    "features ground-smrf.laz own.parquet --features density_g100,zc,oriented_inclination_r100,planarity_opt",
    f"classify {STRIP} classified.laz --model demo/model",
    "seams demo",
    "train demo --compare all --out demo --workers 0",
    "select demo --method rffs --to set.yaml --out demo --workers 0",
    "run demo --out thinned --workers 0 --set thin.rate=0.5 --set train.split=histogram",
    "run demo --out weighed --workers 0 --set train.importance_repeats=2 --set train.bagging=0.9",
    "run demo --out stacked --workers 0 --set stack.enabled=true",
    "run demo --out water --workers 0 --set bathymetry.enabled=true",
    f"voxels {STRIP} --out voxels --workers 0 --samples",
    f"profile {STRIP} --out profile --workers 0",
    "run demo --out refined --workers 0 --set classify.refine.between=[building,vegetation]",
    "run demo --out context --workers 0 --set classify.context.cells=[1,2.5]",
    "run demo --out regularized --workers 0 --set classify.regularize.strength=0.1",
    "run demo --out lines --workers 0 --set classify.lines.codes=[64]",
    "run street-sim --workflow li2018 --out street --workers 0 --set street_scene.length=20",
    f"run riegl-sample --out riegl --workers 0 --set survey.directory={DATA / 'waveform'}",
    f"decompose {DATA / 'waveform' / 'geolas_example2.pls'} pulses.laz",
    f"ground {DATA / 'isprs' / 'samp21.txt'} text.txt",
    f"features {DATA / 'ign_hd' / 'urban_77050_627755.laz'} town.parquet --set xiong2018",
    "view demo --no-browser",
]
"""What is run, in this order."""
LONG_ENOUGH = 30.0
"""s, after which the viewer, which does not end by itself, has made its first blocks and answers."""


def child(to: Path, words: list[str]) -> None:
    """Run one command in this process; what it called goes to the file `to`."""
    from fwclass import compiling
    from fwclass.cli import cli
    from fwclass.operate.compile_all import lines

    if words[0] == "view":
        threading.Timer(LONG_ENOUGH, _thread.interrupt_main).start()
    try:
        cli(words, standalone_mode=False)
    finally:
        to.write_text("\n".join(lines(compiling.asked)))


def arguments() -> argparse.Namespace:
    """What the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("directory", type=Path, help="where the commands run; it is made if it is not there")
    parser.add_argument("--anew", action="store_true", help="keep nothing of the list that there is")
    parser.add_argument(
        "--from", dest="first", choices=COMMANDS, default=COMMANDS[0], metavar="COMMAND", help="begin at this command"
    )
    return parser.parse_args()


def main() -> None:
    if sys.argv[1:2] == ["child"]:
        child(Path(sys.argv[2]), sys.argv[3:])
        return
    asked = arguments()
    directory = asked.directory.resolve()
    directory.mkdir(parents=True, exist_ok=True)
    listed = set() if asked.anew else {json.dumps(row) for row in json.loads(LIST.read_text())}
    for command in COMMANDS[COMMANDS.index(asked.first) :]:
        to = directory / "called.txt"
        to.unlink(missing_ok=True)
        ended = subprocess.run(
            [sys.executable, __file__, "child", str(to), *command.split()],
            cwd=directory,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
        )
        called = set(to.read_text().splitlines()) if to.exists() else set()
        print(f"{command}: exit {ended.returncode}, {len(called)} called, {len(called - listed)} new", flush=True)
        if ended.returncode:
            print(ended.stderr[-600:])
        listed |= called
    LIST.write_text("[\n" + ",\n".join(sorted(listed)) + "\n]\n")


if __name__ == "__main__":
    main()
