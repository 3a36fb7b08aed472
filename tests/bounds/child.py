"""Drives kernels with bounds checks in a process of its own: ``python child.py HOW ROOM INPUTS SEED``.

HOW is ``checked``, compiled with numba's bounds checks, or ``python``, not compiled at all: numpy then checks every
place by itself and nothing waits for the compiler, but it takes a negative place to count from the end.
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path


def check_bounds(how: str) -> None:
    """Every kernel that is compiled from now on raises IndexError where it would leave an array."""
    if how == "python":
        os.environ["NUMBA_DISABLE_JIT"] = "1"
        return
    import numba

    compiled = numba.njit
    numba.njit = lambda *words, **options: compiled(*words, **{**options, "cache": False, "boundscheck": True})


def last_of(values, place):  # type: ignore[no-untyped-def]
    return values[place]


def main() -> None:
    how, room, inputs, seed = sys.argv[1:]
    check_bounds(how)
    import numpy as np

    from fwclass.kernel import kernel

    try:
        kernel(last_of)(np.zeros(2), 2)
    except IndexError:
        pass
    else:
        raise SystemExit("bounds are not checked")
    sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
    done = importlib.import_module(f"{room}_inputs").drive(int(inputs), int(seed))
    print(f"{room}: {done} inputs")


if __name__ == "__main__":
    main()
