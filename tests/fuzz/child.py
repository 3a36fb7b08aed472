"""The process in which inputs are tried: a crash, a hang or a big allocation ends it and nothing else.

Reads lines ``READER SEED RECIPE`` or ``READER * NUMBER`` (a drawn one) and answers with one line of JSON each. An input
may take `CPU_SECONDS` of the processor; the address space may grow by what its reader's `Target` allows.
"""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

sys.path[:0] = [str(Path(__file__).parents[k]) for k in (0, 1, 2)]

CPU_SECONDS = float(os.environ.get("FUZZ_CPU_SECONDS", "5"))
MIB = 1 << 20


def _status(name: str) -> int:
    """A line of this process's status [bytes]."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1]) * 1024
    raise KeyError(name)


def drawn(reader: str, number: int) -> tuple[str, str]:
    """Seed and recipe of the input `number`: the same whoever asks."""
    from mutate import recipe
    from targets import seeds_of

    rng = random.Random(f"{reader} {number}")  # noqa: S311 - must be the same every time
    known = seeds_of(reader)
    seed = known[rng.choice(sorted(known))]
    return seed.name, recipe(seed.files, seed.fields, seed.texts, rng)


def laid(folder: Path, files: dict[str, bytes], links: Mapping[str, str] = MappingProxyType({})) -> None:
    """Write `files` below the emptied `folder`, and `links` to what each names."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    for name, target in links.items():
        (folder / name).symlink_to(target)


def tried(reader: str, seed: str, recipe: str, folder: Path) -> dict[str, object]:
    """Use the damaged file under its limits; how it ended, its seconds, and what it allocated."""
    from mutate import applied
    from targets import ALL, Wrong, seeds_of, used

    whole = seeds_of(reader)[seed]
    files = applied(whole.files, recipe)
    laid(folder, files)
    size = sum(map(len, files.values()))
    target = ALL[reader]
    allowed = target.fixed * MIB + target.times * size
    told = ""
    Path("/proc/self/clear_refs").write_text("5")
    before = _status("VmRSS")
    resource.setrlimit(resource.RLIMIT_AS, (_status("VmSize") + allowed, resource.RLIM_INFINITY))
    signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)
    began = time.process_time()
    try:
        ended = used(reader, folder / whole.main)
    except Wrong as fault:
        ended, told = "wrong", str(fault)
        told += " @ " + " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in _frames(fault)[-4:])
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    return {
        "ended": ended,
        "told": told,
        "seconds": time.process_time() - began,
        "size": size,
        "grown": max(0, _status("VmHWM") - before),
        "allowed": allowed,
    }


def _frames(fault: BaseException) -> list[traceback.FrameSummary]:
    return list(traceback.extract_tb((fault.__cause__ or fault).__traceback__))


def main(readers: list[str]) -> None:
    from targets import seeds_of, used

    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what libraries print goes elsewhere
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "input"
        for reader in readers:  # compiled code and libraries are loaded before anything is counted
            for seed in seeds_of(reader).values():
                laid(folder, seed.files)
                used(reader, folder / seed.main)
        print(json.dumps({"ready": readers}), file=answers)
        for line in sys.stdin:
            reader, seed_name, recipe = line.rstrip("\n").split(" ", 2)
            if seed_name == "*":
                seed_name, recipe = drawn(reader, int(recipe))
            ended = tried(reader, seed_name, recipe, folder)
            print(json.dumps({"seed": seed_name, "recipe": recipe, **ended}), file=answers)


if __name__ == "__main__":
    main(sys.argv[1:])
