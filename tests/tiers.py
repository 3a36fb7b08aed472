"""The first tier, `make unit`: tests that start no process, no cluster and no server.

Which they are follows from what a test names, so that nobody keeps a list: a test is a unit test unless it is marked
slow, statistics, bench or faults, asks for real data, or the test, one of its fixtures or a helper that they name
reaches a module of `STARTING`, `ABOVE_ROOMS` or `DRAWING`. What that rule cannot see meets `Watch`: under ``--unit`` a
test fails that starts something all the same, also where the code under test swallows the refusal.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import platform
import sys
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import CodeType, FunctionType, MethodType
from typing import Any

import pytest

TESTS = Path(__file__).parent
LATER = ("slow", "statistics", "bench", "faults", "skipif")
"""Marks of what is no unit test in any case; what some machines skip needs more than the package."""

STARTING = (
    *("subprocess", "multiprocessing", "socket", "socketserver", "http", "wsgiref", "werkzeug", "moto", "distributed"),
    *("sklearn", "joblib", "fwclass.train.baselines"),  # scikit-learn runs `lscpu`
)
"""Modules whose use starts a process or a server."""

ABOVE_ROOMS = (
    "click",
    "workflows",
    *(
        f"fwclass.{n}"
        for n in ("cli", "delivery", "operate", "graph", "report", "run", "single_file", "study", "survey", "walk")
    ),
)
"""What runs commands and whole surveys: its tests are another tier, whether or not they start a process."""

DRAWING = tuple(f"fwclass.publish.{n}" for n in ("waveform_pictures", "figures", "papers.plots", "papers.scene"))
"""What draws with matplotlib, at up to a second a picture."""

ELSEWHERE = (
    *("bench", "bounds", "faults", "frozen", "run", "security", "store", "uncompiled", "*fuzz*", "test_cli*"),
    *("test_*_sklearn.py", "test_train_others.py", "test_train_search.py"),  # loading scikit-learn takes two seconds
    "test_view_remote.py",  # and that of a server of objects
    *("test_docs_messages.py", "test_docstrings.py", "test_imports.py"),  # they parse the whole program
)
"""Folders and files of other tiers: with ``--unit`` they are not even read."""

REAL_DATA = "shared_data"
"""The fixture of files that most checkouts lack."""

EVENTS = frozenset(
    (
        "subprocess.Popen",
        "os.fork",
        "os.forkpty",
        "os.posix_spawn",
        "os.exec",
        "os.system",
        "socket.bind",
        "socket.connect",
    )
)
"""Names under which Python tells that a process or a server begins (`sys.addaudithook`)."""


def is_elsewhere(path: Path) -> bool:
    """Whether a folder or file of the suite belongs to another tier as a whole."""
    parts = path.relative_to(TESTS).parts if path.is_relative_to(TESTS) else ()
    return any(fnmatch(part, name) for part in parts for name in ELSEWHERE)


def is_unit(item: pytest.Item) -> bool:
    """Whether a test belongs to the first tier."""
    if any(item.get_closest_marker(mark) for mark in LATER) or not isinstance(item, pytest.Function):
        return False
    if REAL_DATA in item.fixturenames or is_elsewhere(item.path):
        return False
    fixtures = (made.func for all_of in item._fixtureinfo.name2fixturedefs.values() for made in all_of)
    return not any(map(_goes_further, (item.function, *fixtures)))


@functools.cache
def _goes_further(function: Callable[..., Any]) -> bool:
    return any(map(_is_further, _reached(function)))


def _reached(begin: Any) -> Iterator[Any]:
    """What functions of the suite name, and what the functions and classes of the suite among that name in turn.
    Modules that a function imports are told by their names."""
    waiting, seen = [begin], set()
    while waiting:
        one = waiting.pop()
        one = getattr(getattr(one, "hypothesis", None), "inner_test", one)
        one = inspect.unwrap(one) if isinstance(one, FunctionType) else one
        if id(one) in seen:
            continue
        seen.add(id(one))
        yield one
        if isinstance(one, MethodType):
            waiting.append(one.__func__)
        elif isinstance(one, FunctionType) and _is_ours(one.__code__.co_filename):
            for name in _names(one.__code__):
                waiting.append(one.__globals__.get(name, name))
            waiting += [cell.cell_contents for cell in one.__closure__ or () if callable(_held(cell))]
        elif isinstance(one, type) and _is_ours(getattr(sys.modules.get(one.__module__), "__file__", None)):
            waiting += [getattr(part, "func", part) for part in vars(one).values()]
            waiting += one.__bases__


def _held(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # nothing yet
        return None


@functools.cache
def _is_ours(file: str | None) -> bool:
    return file is not None and TESTS in Path(file).parents


@functools.cache
def _names(code: CodeType) -> set[str]:
    inner = (_names(one) for one in code.co_consts if isinstance(one, CodeType))
    return set(code.co_names).union(*inner)


def _is_further(used: Any) -> bool:
    own = "__name__" if inspect.ismodule(used) else "__module__"
    return _is_further_name(str(used if isinstance(used, str) else getattr(used, own, "")))


@functools.cache
def _is_further_name(module: str) -> bool:
    return any(f"{module}.".startswith(f"{one}.") for one in (*STARTING, *ABOVE_ROOMS, *DRAWING))


class Watch:
    """A plugin of pytest: no test starts a process or a server, or calls one."""

    def __init__(self) -> None:
        self.awake, self.met = False, []
        platform.processor()  # asked once by `uname`, and kept: h5py asks as it is loaded
        importlib.import_module("matplotlib.font_manager")  # lists a fresh machine's fonts by `fc-list`, and keeps them
        sys.addaudithook(self._heard)  # it cannot be taken away again: `awake` ends it
        start = BaseProcess.start

        def watched(process: BaseProcess) -> None:
            if self.awake:
                self._refuse(f"multiprocessing.{type(process).__name__}")
            start(process)

        BaseProcess.start = watched  # type: ignore[method-assign] - it tells Python nothing

    def _heard(self, event: str, words: tuple[Any, ...]) -> None:
        if event in EVENTS and self.awake:
            self._refuse(f"{event} {words}")

    def _refuse(self, what: str) -> None:
        self.met.append(what[:300])
        raise RuntimeError(f"a unit test starts nothing and calls no server: {what[:300]}")

    def pytest_collection(self) -> None:
        self.awake = True  # pytest itself has looked at the machine by now

    def pytest_collection_finish(self) -> None:
        self.met = []  # libraries look at the machine when they are imported, and live with the refusal

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self) -> Iterator[None]:
        """A refusal that was caught somewhere fails the test too."""
        yield
        met, self.met = self.met, []
        if met:
            pytest.fail(f"this is no unit test, it starts: {'; '.join(met)}", pytrace=False)

    def pytest_unconfigure(self) -> None:
        self.awake = False
