"""The terrain under the simulator's crowns, and its roofs, before and after echoes of several pulses together.

``python tests/bench/bench_stacking.py DIR [--size 150] [--only NAME]``

Towns are simulated with the receiver's records long enough to hold the ground under a crown, and run twice through the
workflow `ground`: as they are, and with `stack.enabled`. Cells are those whose middle lies under a crown; the truth is
the scene's own terrain. Places of stacked ground echoes are held against it, too, and those of roofs against the
nearest true echo of a building (`reference/`), within 1 m in plan.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import rasterio
from scipy.spatial import cKDTree

from fwclass.conf import load
from fwclass.simulate.city import build_scene
from fwclass.simulate.scene import terrain

KINDS = {
    "as simulated": (),
    "three times the leaves": ("scene.leaf_density=4.2",),
    "a fifth of the light": ("sensor.bright=48",),
    "both": ("scene.leaf_density=4.2", "sensor.bright=48"),
    "both, 0.8 pulses/m2": ("scene.leaf_density=4.2", "sensor.bright=48", "pulse_density=0.8"),
}
GAPS = {"": (), ", gap 0.7 m": ("stack.gap=0.7",)}


def words_of(kind: str, size: float) -> list[str]:
    own = (f"size={size}", "strips=2", "sensor.short_segment=207", *KINDS[kind])
    return [word for value in own for word in ("--set", f"simulate.{value}")]


def run(directory: Path, *words: str) -> None:
    command = [sys.executable, "-m", "fwclass", "run", "demo", "--workflow", "ground", "--workers", "0"]
    done = subprocess.run([*command, "--out", str(directory), *words], capture_output=True, text=True)
    if done.returncode not in (0, 4):
        sys.exit(done.stderr[-2000:])


def raster(directory: Path, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values of a raster, NaN where there is none, and the middles of its cells [m]."""
    with rasterio.open(directory / "current" / "rasters" / name) as file:
        values, place = file.read(1, masked=True).astype(float).filled(np.nan), file.transform
    row, col = np.indices(values.shape)
    return values, place.c + place.a * (col + 0.5), place.f + place.e * (row + 0.5)


class Truth:
    """The scene of a simulated survey."""

    def __init__(self, words: list[str]) -> None:
        self.params = load("demo", tuple(words[1::2])).simulate
        self.scene = build_scene(self.params)

    def terrain(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        s, p = self.scene, self.params
        at = zip((x - p.origin_x).ravel(), (y - p.origin_y).ravel(), strict=True)
        return np.array([terrain(s.height, s.margin, s.step, *v) for v in at]).reshape(x.shape) + p.base_height

    def under_crowns(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        tall = self.scene.crown[self.scene.crown[:, 4] - self.scene.crown[:, 3] > 3.0]
        at = np.stack([x - self.params.origin_x, y - self.params.origin_y], axis=-1)
        inside = np.zeros(x.shape, bool)
        for _, cx, cy, _, _, along, across, cos, sin, _ in tall:
            dx, dy = at[..., 0] - cx, at[..., 1] - cy
            inside |= ((dx * cos + dy * sin) / along) ** 2 + ((dy * cos - dx * sin) / across) ** 2 < 1.0
        return inside


def cells(directory: Path, truth: Truth) -> dict[str, np.ndarray]:
    """Errors of the terrain under crowns [m], and which of those cells have a ground echo of their own."""
    dtm, x, y = raster(directory, "dtm.tif")
    under = truth.under_crowns(x, y)
    mask = raster(directory, "dtm_mask.tif")[0]
    return {"off": (dtm - truth.terrain(x, y))[under], "measured": mask[under] == 1}


def line(name: str, of: dict[str, np.ndarray], which: np.ndarray | slice = slice(None)) -> None:
    off = of["off"][which]
    some = off[np.isfinite(off)]
    rmse, bias = np.sqrt(np.mean(some**2)), np.mean(some)
    print(
        f"  {name:34}{rmse:8.3f} m RMSE{bias:+8.3f} m bias{np.mean(of['measured'][which]):8.3f} measured"
        f"{len(some):8} cells",
        flush=True,
    )


def stacked(directory: Path) -> np.ndarray:
    """x, y, z, class, standard error along the beam of every stacked echo."""
    parts = [laspy.read(p) for p in sorted((directory / "current" / "stacked").glob("*.laz"))]
    rows = [np.stack([p.x, p.y, p.z, p.classification, p["range sigma"]], axis=1) for p in parts]
    return np.concatenate([np.empty((0, 5)), *rows])


def judge(directory: Path, truth: Truth) -> None:
    """Prints how far stacked echoes lie from the truth."""
    echoes = stacked(directory)
    ground, roof = echoes[echoes[:, 3] == 2], echoes[echoes[:, 3] == 6]
    if len(ground):
        off = ground[:, 2] - truth.terrain(ground[:, 0], ground[:, 1])
        near = np.abs(off) < 0.5
        print(f"    {len(ground)} stacked ground echoes, {near.mean():.3f} within 0.5 m, {np.std(off[near]):.3f} m")
    if len(roof):
        files = [laspy.read(p) for p in sorted((directory / "survey" / "reference").glob("*.las"))]
        true = np.concatenate([np.stack([f.x, f.y, f.z], axis=1)[np.asarray(f.classification) == 6] for f in files])
        far, at = cKDTree(true[:, :2]).query(roof[:, :2])
        off = roof[:, 2] - true[at, 2]
        near = (far < 1.0) & (np.abs(off) < 0.5)
        print(f"    {len(roof)} stacked roof echoes, {near.mean():.3f} within 0.5 m of a true one")


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("directory", type=Path)
    asked.add_argument("--size", type=float, default=150.0)
    asked.add_argument("--only", choices=list(KINDS), action="append")
    options = asked.parse_args()
    for kind in options.only or KINDS:
        words, directory = words_of(kind, options.size), options.directory / kind.replace(" ", "_").replace("/", "_")
        run(directory, *words)
        truth = Truth(words)
        before = cells(directory, truth)
        print(kind)
        line("before", before)
        for name, gap in GAPS.items():
            run(
                directory,
                *words,
                "--set",
                "stack.enabled=true",
                "--set",
                "stack.surfaces=[ground,roof]",
                *(word for value in gap for word in ("--set", value)),
            )
            after = cells(directory, truth)
            line(f"after{name}", after)
            moved = np.abs(after["off"] - before["off"]) > 1e-3
            if moved.any():
                line("  cells that changed, before", before, moved)
                line("  the same, after", after, moved)
            judge(directory, truth)
        shutil.rmtree(directory)


if __name__ == "__main__":
    main()
