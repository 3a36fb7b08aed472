"""The n-th call of the operating system fails, for every n; and the power goes before it."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from nthcall import Calls, Disk, Left, PowerCut, fails, loses_its_answer
from smallgraph import delivered, made, run, untorn

from fwclass.errors import FwclassError
from fwclass.operate.history import past_runs
from fwclass.operate.status.verify import verify
from fwclass.store.lock import holder
from fwclass.store.run_store import Store

pytestmark = pytest.mark.faults

STRIKES = {"eio": fails(errno.EIO), "full": fails(errno.ENOSPC), "lost": loses_its_answer}

SAMPLE = 8
"""Calls of each kind that the default suite takes, spread over all."""


@dataclass(frozen=True)
class Case:
    """A run over `parts` with `text`, begun with what lies in `before`; `clean`: what it delivers, and its parts."""

    source: Path
    before: Path
    parts: str
    text: str
    clean: tuple[dict, dict]
    calls: tuple[str, ...]

    def run(self, root: Path) -> list[str]:
        return run(root, self.source, self.parts, self.text)

    def begun(self, root: Path) -> Path:
        shutil.rmtree(root, ignore_errors=True)
        shutil.copytree(self.before, root, symlinks=True)
        return root

    def check(self, root: Path) -> None:
        """The same again, undisturbed: all is there, and nothing else."""
        assert self.run(root) == []
        assert (delivered(root), made(Store(root))) == self.clean
        untorn(root)
        assert verify(Store(root)).sound
        left = [p for p in root.rglob(".*") if p.parent != root / "logs"]
        assert not left and not list((root / "store").glob("staging/*")) and holder(root) is None
        assert not list((root / "store" / "failures").rglob("*.json"))
        assert len(list((root / "generations").iterdir())) == 1
        for path in (root / "current").iterdir():
            assert path.name in ("generation.json", "manifest.json") or (root / path.name).samefile(path)
        assert past_runs(root)[-1]["word"] == "done"


@pytest.fixture(scope="module", params=["first", "second"])
def case(request, tmp_path_factory) -> Case:
    """A first run into nothing; a second one that makes parts anew, has one more and one less, and collects."""
    base = tmp_path_factory.mktemp("nth")
    source, before, clean = base / "a.las", base / "before", base / "clean"
    source.write_bytes(b"x" * 100)
    before.mkdir()
    wanted = ("ab", "one") if request.param == "first" else ("ac", "two")
    if request.param == "second":
        assert run(before, source, "ab", "one") == []
    assert run(clean, source, *wanted) == []
    counted = base / "counted"
    shutil.copytree(before, counted, symlinks=True)
    with Calls(counted).counted() as calls:
        assert run(counted, source, *wanted) == []
    assert (delivered(counted), made(Store(counted))) == (delivered(clean), made(Store(clean)))
    return Case(source, before, *wanted, (delivered(clean), made(Store(clean))), tuple(calls.names))


@pytest.fixture
def quick_path(tmp_path) -> Iterator[Path]:
    """A directory in memory, where flushing costs nothing."""
    memory = Path("/dev/shm")  # noqa: S108
    if not memory.is_dir():
        yield tmp_path
        return
    with TemporaryDirectory(dir=memory) as path:
        yield Path(path)


def spread(calls: int, how: str) -> list[int]:
    """Numbers of calls to strike: all, or some."""
    return list(range(calls)) if how == "all" else sorted({k * calls // SAMPLE for k in range(SAMPLE)})


HOW_MANY = pytest.mark.parametrize("how", ["some", pytest.param("all", marks=pytest.mark.slow)])


@HOW_MANY
@pytest.mark.parametrize("kind", STRIKES)
def test_a_call_that_fails_harms_nothing(case, quick_path, kind, how):
    root, struck = quick_path / "run", 0
    for n in spread(len(case.calls), how):
        case.begun(root)
        with Calls(root, n, STRIKES[kind]).counted() as calls:
            try:
                struck += bool(case.run(root))  # parts that failed
            except (OSError, FwclassError):
                struck += 1
        assert len(calls.names) > n, "the call was not met"
        try:
            untorn(root)
            case.check(root)
        except BaseException as fault:
            fault.add_note(f"{kind} at call {n} of {len(case.calls)}: {calls.names[max(0, n - 3) : n + 2]}")
            raise
    assert struck, "no call mattered"


def cut(case: Case, root: Path, n: int, flushing: bool = True) -> Left:
    """What is on the disk where the power goes before the n-th call; not `flushing`, the disk does not do it."""
    case.begun(root)
    disk, left = Disk(root), []

    def strike(name: str, do: Callable[[], None]) -> None:
        left.append(disk.left())
        raise PowerCut

    def after(name: str, words: tuple) -> None:
        if name == "fsync" and flushing:
            disk.flushed(words[0])

    with Calls(root, n, strike, after=after).counted(), contextlib.suppress(PowerCut):
        case.run(root)
    disk.close()
    assert left, "the call was not met"
    return left[0]


@HOW_MANY
def test_the_power_goes_before_a_call(case, quick_path, how):
    root, found = quick_path / "run", quick_path / "found"
    rng = random.Random(17)  # noqa: S311
    for n in spread(len(case.calls), how):
        left = cut(case, root, n)
        for kept in (0.0, 1.0, rng.random(), rng.random()):
            shutil.rmtree(found, ignore_errors=True)
            left.build(found, rng, kept)
            try:
                untorn(found)
                case.check(found)
            except BaseException as fault:
                fault.add_note(f"{kept:.2f} kept at call {n} of {len(case.calls)}: {case.calls[max(0, n - 3) : n + 2]}")
                raise


def test_a_disk_that_does_not_flush_tears_what_readers_see(case, quick_path):
    """That what is lost here would be noticed."""
    left = cut(case, quick_path / "run", len(case.calls) - 1, flushing=False)
    rng, torn = random.Random(3), 0  # noqa: S311
    for k in range(20):
        left.build(quick_path / str(k), rng, 0.7)
        try:
            untorn(quick_path / str(k))
        except (AssertionError, OSError, ValueError):
            torn += 1
    assert torn > 5


def test_calls_are_enough(case):
    assert len(case.calls) > 100 and len(set(case.calls)) > 8, (len(case.calls), sorted(set(case.calls)))
    assert os.fsync.__module__ == "posix"
