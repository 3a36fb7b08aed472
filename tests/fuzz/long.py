"""Many damaged files through every reader of foreign bytes.

    python tests/fuzz/long.py --inputs 100000 [--seed N] [--reader NAME] [--found FILE]

The inputs are shared out among the readers; the same seed draws the same ones. Ends with code 1 if one of them did
what none may: end in anything but a result or an `FwclassError`, end the process, take more than 5 s of the processor,
or allocate more than its reader's `Target` allows. Each of these is told as a line for `corpus.txt`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[k]) for k in (0, 1, 2)]

from targets import TARGETS  # noqa: E402 - the path comes first
from watch import answers  # noqa: E402


def tried(reader: str, first: int, count: int, found: Path | None) -> tuple[Counter[str], dict[str, float]]:
    """Counts of ends, and the worst figures, of the inputs [first, first + count)."""
    counts: Counter[str] = Counter()
    worst = {"seconds": 0.0, "mib": 0.0, "share": 0.0}
    told: Counter[str] = Counter()
    for a in answers((f"{reader} * {n}" for n in range(first, first + count)), reader):
        counts[a["ended"]] += 1
        worst["seconds"] = max(worst["seconds"], a["seconds"])
        worst["mib"] = max(worst["mib"], a["grown"] / 2**20)
        worst["share"] = max(worst["share"], a["grown"] / a["allowed"])
        if a["ended"] == "wrong":
            told[a["told"]] += 1
            if told[a["told"]] <= 3:
                why = " ".join(a["told"].split())
                print(f"{reader}: {why}", flush=True)
                line = f"{reader} {a['seed']} {a['recipe']}  # {why}"
                if found is not None:
                    with found.open("a") as out:
                        out.write(line + "\n")
    return counts, worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--reader", choices=sorted(TARGETS), action="append")
    parser.add_argument("--found", type=Path, help="file that lines for corpus.txt are appended to")
    asked = parser.parse_args()
    readers = asked.reader or list(TARGETS)
    shares = sum(TARGETS[r].share for r in readers)
    total: Counter[str] = Counter()
    for reader in readers:
        began = time.perf_counter()
        counts, worst = tried(
            reader, asked.seed * 10_000_000, round(asked.inputs * TARGETS[reader].share / shares), asked.found
        )
        total += counts
        ends = ", ".join(f"{n} {end}" for end, n in sorted(counts.items()))
        print(
            f"{reader:<11} {ends}; slowest {worst['seconds']:.2f} s, most {worst['mib']:.1f} MiB, "
            f"{100 * worst['share']:.0f} % of what is allowed; {time.perf_counter() - began:.0f} s",
            flush=True,
        )
    print(f"all         {sum(total.values())} inputs: {', '.join(f'{n} {e}' for e, n in sorted(total.items()))}")
    sys.exit(1 if total["wrong"] else 0)


if __name__ == "__main__":
    main()
