"""Whether memory follows a survey's size: copies of a file of 1 km² side by side, by one command.

    python tests/bench/bench_many.py --data ../shared/data/ign_hd [--files 8,32] [--workflow ground] [--set …]

The copies of ``km_0299_6802.laz`` (IGN LiDAR HD, 278 810 points) are moved by whole kilometres: the header's offsets
and bounds are, the points' bytes stay. Printed are processor time, wall time, and the most memory that
the command's own process, which holds the plan and the scheduler, and any of its workers took.
"""

from __future__ import annotations

import argparse
import io
import math
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import laspy
import psutil

ROOT = Path(__file__).resolve().parents[2]
OFFSETS, BOUNDS = 155, 179
"""Where the header of a LAS file has x and y offset, and max x, min x, max y, min y."""


def moved(source: bytes, dx: float, dy: float) -> bytes:
    """A LAS or LAZ file whose points lie elsewhere [m]."""
    out = bytearray(source)
    x, y = struct.unpack_from("<2d", out, OFFSETS)
    struct.pack_into("<2d", out, OFFSETS, x + dx, y + dy)
    a, b, c, d = struct.unpack_from("<4d", out, BOUNDS)
    struct.pack_into("<4d", out, BOUNDS, a + dx, b + dx, c + dy, d + dy)
    return bytes(out)


class Memory(threading.Thread):
    """Watches a process and its children: the most resident memory of it and of any of them [MiB]."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        super().__init__(daemon=True)
        self.watched, self.own, self.workers, self.together = psutil.Process(process.pid), 0.0, 0.0, 0.0

    def run(self) -> None:
        while self.watched.is_running():
            try:
                own = self.watched.memory_info().rss / 2**20
                others = [p.memory_info().rss / 2**20 for p in self.watched.children(recursive=True)]
            except psutil.Error:
                continue
            self.own, self.workers = max(self.own, own), max([self.workers, *others])
            self.together = max(self.together, own + sum(others))
            time.sleep(0.25)


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--data", type=Path, required=True)
    asked.add_argument("--files", default="8,32")
    asked.add_argument("--workflow", default="ground")
    asked.add_argument("--out", type=Path)
    asked.add_argument("--set", dest="settings", action="append", default=["tile.size=500", "run.seam_check_echoes=0"])
    asked.add_argument("--every", type=int, default=1, help="take every n-th point alone: as many parts, less work")
    words = asked.parse_args()
    if words.out:
        words.out.mkdir(parents=True, exist_ok=True)
    source = (words.data / "km_0299_6802.laz").read_bytes()
    if words.every > 1:
        cloud, out = laspy.read(words.data / "km_0299_6802.laz"), io.BytesIO()
        cloud.points = cloud.points[:: words.every].copy()
        cloud.write(out, do_compress=True)
        source = out.getvalue()
    print(
        f"{'files':>6}{'points':>13}{'CPU s':>8}{'wall s':>8}{'CPU s/file':>12}"
        f"{'own MiB':>9}{'worker MiB':>12}{'all MiB':>9}"
    )
    for number in map(int, words.files.split(",")):
        with tempfile.TemporaryDirectory(dir=words.out) as scratch:
            place, across = Path(scratch), math.ceil(math.sqrt(number))
            for k in range(number):
                file = place / "las" / f"km_{k:03d}.laz"
                file.parent.mkdir(exist_ok=True)
                file.write_bytes(moved(source, 1000.0 * (k % across), 1000.0 * (k // across)))
            (place / "many.yaml").write_text("survey: {name: many, directory: las, sources: ['*.laz']}\n")
            line = [sys.executable, "-m", "fwclass", "run", place / "many.yaml", "--workflow", words.workflow]
            line += ["--out", place / "run", *(w for one in words.settings for w in ("--set", one))]
            began, before = time.perf_counter(), psutil.Process().cpu_times()
            process = subprocess.Popen(list(map(str, line)), stderr=subprocess.DEVNULL)
            memory = Memory(process)
            memory.start()
            if process.wait():
                raise SystemExit(f"the run of {number} files ended with {process.returncode}")
            after, wall = psutil.Process().cpu_times(), time.perf_counter() - began
            cpu = sum(getattr(after, n) - getattr(before, n) for n in ("children_user", "children_system"))
            points = number * (struct.unpack_from("<I", source, 107)[0] or struct.unpack_from("<Q", source, 247)[0])
            print(
                f"{number:>6}{points:>13,}{cpu:>8.0f}{wall:>8.0f}{cpu / number:>12.1f}"
                f"{memory.own:>9.0f}{memory.workers:>12.0f}{memory.together:>9.0f}",
                flush=True,
            )
            shutil.rmtree(place / "run")


if __name__ == "__main__":
    main()
