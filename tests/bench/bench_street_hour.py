"""An hour of frames, on-line and in batch: memory over time, processor seconds, and whether both give the same bytes.

`python tests/bench/bench_street_hour.py FOLDER [--frames N] [--workers N] [--vectors N] [--only WHICH] [--plot PNG]`

FOLDER takes some 6 GB. A simulated street, driven again and again at 1 m/s, 1 081 beams at 40 Hz, spheres of 0.3 m, an
RBF SVM. `fwclass street run` and `fwclass street classify` are processes of their own, looked at every second. Seconds
are the processor's, of all processes of a command, as the machine may be busy; the wall clock is told beside them.
"""

from __future__ import annotations

import argparse
import filecmp
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

from bench_street import drive, trained

from fwclass.store.models import save_model
from fwclass.street.answers import ANSWERS
from fwclass.street.recording_parquet import write_recording

STREET = 3600
"""Frames of the street that is driven again and again: 90 m."""

MINUTE = 2400
"""Frames of a minute."""

MIB = 1 << 20


@dataclass
class Watched:
    """A command that ran: `memory` of its largest process at times, beside the bytes of answers that were there."""

    cpu: float = 0.0
    wall: float = 0.0
    memory: list[tuple[int, float]] = field(default_factory=list)


def descendants(pid: int) -> list[int]:
    found = [pid]
    for one in found:
        for task in Path(f"/proc/{one}/task").glob("*/children"):
            found += [int(v) for v in task.read_text().split()]
    return found


def resident(pid: int) -> float:
    """MiB of memory that no file backs."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) / 1024
    return 0.0


def watched(words: list[str], answers: Path, log: Path) -> Watched:
    """Run ``fwclass street WORDS`` to its end."""
    import resource

    made, began = Watched(), time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with log.open("w") as said:
        child = subprocess.Popen([sys.executable, "-m", "fwclass", "street", *words], stderr=said, stdout=said)
        while child.poll() is None:
            time.sleep(1.0)
            try:
                most = max(resident(p) for p in descendants(child.pid))
            except OSError:  # one ended meanwhile
                continue
            made.memory.append((answers.stat().st_size if answers.exists() else 0, most))
    if child.returncode:
        raise SystemExit(log.read_text())
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    made.cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    made.wall = time.perf_counter() - began
    return made


def prepared(folder: Path, frames: int, vectors: int) -> None:
    """hour.parquet and model/ in `folder`, unless they are there."""
    if (folder / "hour.parquet").exists():
        return
    config, street = drive("utm-30lx", min(STREET, frames))
    model, _ = trained(street[:300], config, vectors)
    save_model(folder / "model", model)

    def all_frames():
        for k in range(frames):
            one = street[k % len(street)]
            yield replace(one, number=k, time=k * 0.025, labels=None)

    write_recording(folder / "hour.parquet", all_frames())


def words(folder: Path) -> list[str]:
    return [str(folder / "hour.parquet"), "--model", str(folder / "model"), "--set", "street.radii=[0.3]"]


def online(folder: Path, frames: int) -> list[tuple[float, float]]:
    """`street run`; thousands of frames answered, and MiB."""
    answers, log = folder / "on" / ANSWERS, folder / "on.log"
    one = watched(["run", *words(folder), "--out", str(folder / "on")], answers, log)
    size = answers.stat().st_size
    course = [(frames * at / size, most) for at, most in one.memory]
    later = [most for at, most in course if MINUTE <= at < frames - 100] or [float("nan")]
    grown = max(later) / later[0] - 1.0
    print(f"on-line      {one.cpu:7.0f} s of the processor, {one.wall:.0f} s; {1e3 * one.cpu / frames:.2f} ms a frame")
    print(f"             {later[0]:.0f} MiB after a minute, {max(later):.0f} at most after it: {100 * grown:+.1f} %")
    print(f"             {max(most for _, most in course):.0f} MiB with map and picture, which are made at the end")
    print("             " + log.read_text().strip().replace("\n", "\n             "), flush=True)
    return [(at / 1000, most) for at, most in course]


def batch(folder: Path, frames: int, workers: int) -> list[tuple[float, float]]:
    """`street classify`; seconds, and MiB."""
    first, *more = words(folder)
    asked = ["classify", first, str(folder / "off"), *more, "--workers", str(workers)]
    two = watched(asked, folder / "off" / ANSWERS, folder / "off.log")
    print(f"batch        {two.cpu:7.0f} s of the processor, {two.wall:.0f} s; {workers} workers, {frames} frames")
    print(f"             at most {max(m for _, m in two.memory):.0f} MiB in a process", flush=True)
    return [(float(k), most) for k, (_, most) in enumerate(two.memory)]


def plotted(path: Path, curves: dict[str, list[tuple[float, float]]]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.6 * len(curves), 3.2), layout="constrained")
    axes = figure.subplots(1, len(curves), sharey=True, squeeze=False)[0]
    for ax, (name, rows) in zip(axes, curves.items(), strict=True):
        ax.plot(*zip(*rows, strict=True), lw=1)
        label = "frames answered, thousands" if name == "street run" else "seconds"
        ax.set(title=name, xlabel=label, ylim=(0, None))
    axes[0].set_ylabel("memory, MiB")
    figure.savefig(path, dpi=120)


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("folder", type=Path)
    ask.add_argument("--frames", type=int, default=144_000)
    ask.add_argument("--workers", type=int, default=2)
    ask.add_argument("--vectors", type=int, default=900)
    ask.add_argument("--only", choices=("online", "batch"))
    ask.add_argument("--plot", type=Path)
    asked = ask.parse_args()
    folder, frames = asked.folder.resolve(), asked.frames
    folder.mkdir(parents=True, exist_ok=True)
    prepared(folder, frames, asked.vectors)
    print(f"{frames} frames: {(folder / 'hour.parquet').stat().st_size / MIB:.0f} MiB of Parquet", flush=True)
    for name in ("on", "off"):
        shutil.rmtree(folder / name, ignore_errors=True)
    curves = {}
    if asked.only != "batch":
        curves["street run"] = online(folder, frames)
    if asked.only != "online":
        curves["street classify, largest process"] = batch(folder, frames, asked.workers)
    if asked.only is None:
        same = filecmp.cmp(folder / "on" / ANSWERS, folder / "off" / ANSWERS, shallow=False)
        print("             the bytes of both are " + ("the same" if same else "NOT THE SAME"))
    if asked.plot:
        plotted(asked.plot, curves)


if __name__ == "__main__":
    main()
