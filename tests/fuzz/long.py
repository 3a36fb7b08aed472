"""Many damaged files through every reader of foreign bytes, or with ``--commands`` through the commands themselves.

    python tests/fuzz/long.py --inputs 100000 [--commands] [--cover] [--seed N] [--only NAME] [--found FILE]

The inputs are shared out among readers or commands; the same seed draws the same ones. Ends with code 1 if one of them
did what none may: of a reader, end in anything but a result or an `FwclassError`, end the process, take more than 5 s
of the processor, or allocate more than its `Target` allows; of a command, see `server.py`. Each of these is told as a
line for `corpus.txt` or `commands.txt`. With ``--cover`` a command's inputs that reach lines of the program which none
before them did are gone on from in half of the inputs.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[k]) for k in (0, 1, 2)]

from commands import COMMANDS  # noqa: E402 - the path comes first
from targets import TARGETS  # noqa: E402
from watch import answers  # noqa: E402


def tried(
    name: str, first: int, count: int, found: Path | None, words: tuple[str, ...], script: str
) -> tuple[Counter[str], dict[str, float]]:
    """Counts of ends, and the worst figures, of the inputs [first, first + count)."""
    counts: Counter[str] = Counter()
    worst = {"seconds": 0.0, "mib": 0.0, "share": 0.0, "all": 0.0, "new": 0.0}
    told: Counter[str] = Counter()
    for a in answers((f"{name} * {n}" for n in range(first, first + count)), *words, script=script):
        counts[a["ended"]] += 1
        worst["seconds"] = max(worst["seconds"], a["seconds"])
        worst["mib"] = max(worst["mib"], a["grown"] / 2**20)
        worst["share"] = max(worst["share"], a["grown"] / a["allowed"])
        worst["all"] += a["seconds"]
        worst["new"] += bool(a.get("new"))
        if a["ended"] == "wrong":
            why = " ".join(a["told"].split())
            told[why[:60]] += 1
            if told[why[:60]] <= 3:
                print(f"{name}: {why}", flush=True)
                line = f"{name} {a['seed']} {a['recipe']}  # {why}"
                if found is not None:
                    with found.open("a") as out:
                        out.write(line + "\n")
    return counts, worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--commands", action="store_true", help="through the commands")
    parser.add_argument("--cover", action="store_true", help="with --commands: go on from what reaches new lines")
    parser.add_argument("--only", choices=sorted({*TARGETS, *COMMANDS}), action="append")
    parser.add_argument("--found", type=Path, help="file that lines for the corpus are appended to")
    asked = parser.parse_args()
    kinds = {n: k.share for n, k in (COMMANDS if asked.commands else TARGETS).items()}
    names = [n for n in kinds if not asked.only or n in asked.only]
    shares = sum(kinds[n] for n in names)
    script = "server.py" if asked.commands else "child.py"
    total: Counter[str] = Counter()
    for name in names:
        began = time.perf_counter()
        words = (name, *(["--cover"] if asked.commands and asked.cover else []))
        count = round(asked.inputs * kinds[name] / shares)
        counts, worst = tried(name, asked.seed * 10_000_000, count, asked.found, words, script)
        total += counts
        ends = ", ".join(f"{n} {end}" for end, n in sorted(counts.items()))
        new = f", {worst['new']:.0f} reached new lines" if asked.cover else ""
        print(
            f"{name:<14} {ends}; slowest {worst['seconds']:.2f} s, most {worst['mib']:.1f} MiB, "
            f"{100 * worst['share']:.0f} % of what is allowed{new}; {worst['all']:.0f} s of the processor, "
            f"{time.perf_counter() - began:.0f} s",
            flush=True,
        )
    print(f"all            {sum(total.values())} inputs: {', '.join(f'{n} {e}' for e, n in sorted(total.items()))}")
    sys.exit(1 if total["wrong"] else 0)


if __name__ == "__main__":
    main()
