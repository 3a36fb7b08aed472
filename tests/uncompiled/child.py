"""Does all work of `workloads` without compilation: ``NUMBA_DISABLE_JIT=1 python child.py OUT``.

OUT gets, for every piece of work, its answers (`NAME.npz`) and in `told.json` the kernels it called, its seconds and
what it raised.
"""

from __future__ import annotations

import functools
import importlib
import json
import math
import pkgutil
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numba
import numpy as np

TESTS = Path(__file__).parents[1]
called: set[str] = set()


def name_of(function: Any) -> str:
    return f"{function.__module__}.{function.__qualname__}"


class Ieee:
    """`math` as compiled code has it: no number raises, and floor and ceil are int64."""

    def __getattr__(self, name: str) -> Any:
        found = getattr(math, name)
        return functools.partial(self._called, name, found) if callable(found) else np.float64(found)

    @staticmethod
    def _called(name: str, function: Callable[..., float], *words: float) -> Any:
        if name in ("floor", "ceil"):
            return np.int64(getattr(np, name)(*words))
        try:
            return np.float64(function(*words))
        except (ValueError, OverflowError, ZeroDivisionError):
            return getattr(np, {"pow": "power"}.get(name, name))(*words)


def as_numbers_are(code: CodeType) -> CodeType:
    """`code` whose numbers behave as in compiled code: decimals are float64, which divide by 0 without complaint and
    make float64 of float32, and what `int` and `math` give is of numpy too."""
    constants = (
        as_numbers_are(c) if isinstance(c, CodeType) else np.float64(c) if isinstance(c, float) else c
        for c in code.co_consts
    )
    names = (MEANT.get(name, (name,))[0] for name in code.co_names)
    return code.replace(co_consts=tuple(constants), co_names=tuple(names))


MEANT = {"int": ("_int64", np.int64), "float": ("_float64", np.float64), "math": ("_ieee", Ieee())}
"""What a kernel's names mean when it is compiled, and under which name that stands in its module."""


def uncompiled(function: FunctionType) -> Callable[..., Any]:
    """`function`, not compiled, that says when it is called."""
    function.__globals__.update(MEANT.values())
    function.__code__ = as_numbers_are(function.__code__)

    @functools.wraps(function)
    def calling(*words: Any) -> Any:
        called.add(name_of(function))
        return function(*(w.view(np.recarray) if isinstance(w, np.ndarray) and w.dtype.names else w for w in words))

    return calling


def kernels() -> set[str]:
    """All kernels of the package."""
    import fwclass
    from fwclass.kernel import Kernel

    found = set()
    for module in pkgutil.walk_packages(fwclass.__path__, "fwclass."):
        names = vars(importlib.import_module(module.name)) if module.name != "fwclass.__main__" else {}
        found |= {name_of(value._function) for value in names.values() if isinstance(value, Kernel)}
    return found


def main() -> None:
    out = Path(sys.argv[1])
    if not numba.config.DISABLE_JIT:
        raise SystemExit("NUMBA_DISABLE_JIT is not set")
    numba.njit = lambda **options: uncompiled
    np.seterr(all="ignore")
    sys.path[:0] = [str(TESTS), str(Path(__file__).parent)]
    told: dict[str, Any] = {"kernels": sorted(kernels()), "work": {}}
    import workloads

    for name in sys.argv[2:] or workloads.WORK:
        called.clear()
        begin, fault = time.perf_counter(), ""
        try:
            with tempfile.TemporaryDirectory() as directory:
                answers = workloads.flat(workloads.WORK[name](Path(directory)))
            np.savez(out / f"{name}.npz", **{f"a{k}": v for k, v in enumerate(answers.values())})
            paths = list(answers)
        except Exception:
            fault, paths = traceback.format_exc(), []
        told["work"][name] = {
            "kernels": sorted(called),
            "answers": paths,
            "seconds": round(time.perf_counter() - begin, 2),
            "fault": fault,
        }
    (out / "told.json").write_text(json.dumps(told))


if __name__ == "__main__":
    main()
