"""What labels at a few suggested places are worth beside a base model's rows, by one layer and in context.

    python tests/bench/bench_base_model.py [--data DIR] [--surveys town,delft] [--places 5,20]

A run by a model of other surveys is corrected by the file's own classes at the places that `fwclass suggest` names, the
rest of them is confirmed, and a run with `survey.base_model` learns from them: all by the command line, as
docs/labels.md has it. The town is judged on its eastern third, where no place lies; Delft on all that lies 5 m from the
places. Data are not part of this repository; without them it says so.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import geopandas
import laspy
import numpy as np
import yaml
from bench_abroad import DATA
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import fwclass as package
from fwclass.assess.confusion import figures
from fwclass.formats.echo_labels import EchoLabels
from fwclass.store.corrections import add_corrections

NAMES = ("ground", "vegetation", "building")
CODES = (2, 5, 6)
CELLS = "classify.context.cells=[0.5,1,2.5,5]"
GAP = 5.0
TOWN_TEST = [770600.0, 6277500.0, 770650.01, 6277600.01]
SURVEYS: dict[str, dict[str, Any]] = {
    "town": {
        "survey": {"directory": "ign_hd", "sources": ["urban_*.laz"], "crs": "EPSG:2154"},
        "vegetation": (3, 4, 5),
        "base": ["bat.laz", "crop_1.laz"],
        "areas": {"test": [TOWN_TEST]},
    },
    "delft": {
        "survey": {"directory": "other", "sources": ["delft_ahn3_1.laz"], "crs": "EPSG:28992"},
        "vegetation": (1,),
        "base": ["urban_*.laz", "km_*.laz", "bat.laz", "crop_1.laz"],
        "areas": {},
    },
}


def command(*words: object) -> str:
    line = [sys.executable, "-c", "from fwclass.cli import main; main()", *map(str, words)]
    ended = subprocess.run(line, capture_output=True, text=True)
    if ended.returncode not in (0, 4):
        sys.exit(ended.stderr)
    return ended.stderr


class Truth:
    """The classes that a survey's files give, by place."""

    def __init__(self, files: list[Path], vegetation: tuple[int, ...]) -> None:
        clouds = [laspy.read(path) for path in files]
        self._tree = cKDTree(np.concatenate([np.c_[c.x, c.y, c.z] for c in clouds]))
        code = np.zeros(256, np.uint8)
        code[list(vegetation)], code[2], code[6] = 5, 2, 6
        self._code = code[np.concatenate([np.asarray(c.classification) for c in clouds])]

    def of(self, places: NDArray[np.float64]) -> NDArray[np.uint8]:
        return self._code[self._tree.query(places)[1]]


def correct(root: Path, boxes: list[tuple[float, ...]], truth: Truth) -> None:
    """Give the true class to every echo in the boxes that has another one."""
    delivery = package.open(root)
    for box in boxes:
        echoes = delivery.echoes(box=box).to_pandas()
        code = truth.of(echoes[["x", "y", "z"]].to_numpy())
        wrong = (code != echoes["classification"].to_numpy()) & (code > 0)
        columns = {n: echoes[n].to_numpy()[wrong] for n in ("strip", "pulse", "echo_number", "x", "y", "z")}
        rows = EchoLabels.of(columns, code[wrong], time.time_ns() // 1000, "truth")
        add_corrections(root, lambda earlier, rows=rows: rows)


def judged(root: Path, truth: Truth, test: list[float] | None, boxes: list[tuple[float, ...]]) -> str:
    """Overall accuracy / kappa / mean IoU [%]."""
    echoes = package.open(root).echoes(**({"box": tuple(test)} if test else {})).to_pandas()
    code, keep = truth.of(echoes[["x", "y", "z"]].to_numpy()), np.ones(len(echoes), bool)
    for low_x, low_y, high_x, high_y in boxes if test is None else ():
        inside = echoes.x.between(low_x - GAP, high_x + GAP) & echoes.y.between(low_y - GAP, high_y + GAP)
        keep &= ~inside.to_numpy()
    keep &= code > 0
    matrix = np.zeros((3, 3), np.int64)
    given = np.searchsorted(CODES, echoes["classification"].to_numpy()[keep])
    np.add.at(matrix, (np.searchsorted(CODES, code[keep]), given), 1)
    told = figures(matrix, NAMES)
    return " / ".join(f"{100 * told[n]:.1f}" for n in ("overall_accuracy", "kappa", "mean_iou"))


def bench(name: str, data: Path, counts: list[int], place: Path) -> None:
    about = SURVEYS[name]

    def classes(vegetation: tuple[int, ...]) -> list[dict[str, Any]]:
        codes = ((2,), vegetation, (6,))
        return [{"name": n, "code": c, "codes": list(k)} for n, c, k in zip(NAMES, CODES, codes, strict=True)]

    def survey(file: str, areas: dict[str, Any], **changes: Any) -> Path:
        own = {"name": file, "classes": classes(about["vegetation"]), **about["survey"], **changes}
        own["directory"] = str(data / own["directory"])
        written = {"survey": own, "areas": areas, "tile": {"size": 100 if name == "delft" else 50}}
        (place / f"{file}.yaml").write_text(yaml.safe_dump(written))
        return place / f"{file}.yaml"

    source = {"features": "portable", "reference": {"kind": "source"}, "classes": classes((3, 4, 5))}
    base = survey("base", {"train": "all"}, **source, directory="ign_hd", sources=about["base"], crs="EPSG:2154")
    words = ("train", base, "--model", place / "model", "--keep-rows", 6000, "--no-assess", "--set", CELLS)
    command(*words, "--out", place / "training")
    truth = Truth(
        [f for s in about["survey"]["sources"] for f in sorted((data / about["survey"]["directory"]).glob(s))],
        about["vegetation"],
    )
    first = place / "first"
    command("run", survey("given", about["areas"], model=str(place / "model")), "--out", first)
    test = about["areas"].get("test", [None])[0]
    print(f"{name}: by a model of other surveys {judged(first, truth, test, [])}", flush=True)
    for count in counts:
        root, file = place / f"run-{count}", place / f"{count}.gpkg"
        shutil.copytree(first, root, symlinks=True)
        command("suggest", root, file, "--places", count)
        boxes = [tuple(place.bounds) for place in geopandas.read_file(file).geometry]
        correct(root, boxes, truth)
        command("label", "confirm", root, file)
        told = []
        for way, cells in (("one layer", "[]"), ("in context", "[0.5,1,2.5,5]")):
            further = survey(
                f"further-{count}", about["areas"], base_model=str(place / "model"), reference={"kind": "corrections"}
            )
            command("run", further, "--out", root, "--set", f"classify.context.cells={cells}")
            told.append(f"{way} {judged(root, truth, test, boxes)}")
        print(f"  {len(boxes)} places: {', '.join(told)}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--surveys", default="town,delft")
    parser.add_argument("--places", default="5,20")
    asked = parser.parse_args()
    if not asked.data.is_dir():
        sys.exit(f"no data in {asked.data}")
    for name in asked.surveys.split(","):
        with tempfile.TemporaryDirectory() as place:
            bench(name, asked.data, [int(n) for n in asked.places.split(",")], Path(place))


if __name__ == "__main__":
    main()
