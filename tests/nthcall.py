"""The operating system's primitives below one directory; the n-th call fails, or is done and said to have failed.

Also what is left on the disk where the power goes before the n-th call: of all that was not flushed, any part.
"""

from __future__ import annotations

import builtins
import contextlib
import errno
import io
import os
import random
import stat
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

NAMES = ("fsync", "rename", "replace", "unlink", "remove", "link", "mkdir", "rmdir", "symlink", "chmod", "write")
"""Of `os`; besides files are opened for writing, and streams written to."""

REAL: dict[str, Callable[..., Any]] = {n: getattr(os, n) for n in (*NAMES, "open")} | {"io": io.open}


class PowerCut(BaseException):
    """Nothing is done any more."""


@dataclass
class Calls:
    """Counts the calls that change something below `root`; at number `at`, from 0, `strike` is asked, and where it
    `stays` at all that follow.

    `strike(name, do)` returns what the call returns.
    """

    root: Path
    at: int | None = None
    strike: Callable[[str, Callable[[], Any]], Any] = lambda name, do: do()
    stays: bool = False
    names: list[str] = field(default_factory=list)
    after: Callable[[str, tuple[Any, ...]], None] = lambda name, words: None
    _guard: Any = field(default_factory=threading.RLock)

    def met(self, name: str, do: Callable[[], Any], *words: Any) -> Any:
        with self._guard:
            self.names.append(name)
            if len(self.names) - 1 == self.at or (self.stays and self.at is not None and len(self.names) > self.at):
                return self.strike(name, do)
            self.after(name, words)
            return do()

    def below(self, path: Any, folder: int | None = None) -> bool:
        return str(_full(path, folder)).startswith(f"{self.root}/") or str(_full(path, folder)) == str(self.root)

    @contextlib.contextmanager
    def counted(self) -> Iterator[Calls]:
        """Within, calls are counted."""

        def wrapped(name: str) -> Callable[..., Any]:
            real = REAL[name]

            def call(*words: Any, **more: Any) -> Any:
                where = words[1] if name == "symlink" else words[0]
                if not self.below(where, more.get("dir_fd")):
                    return real(*words, **more)
                return self.met(name, lambda: real(*words, **more), *words)

            return call

        def opened(path: Any, mode: str = "r", *words: Any, **more: Any) -> Any:
            if isinstance(path, int) or not set(mode) & set("wax+") or not self.below(path):
                return REAL["io"](path, mode, *words, **more)
            return Stream(self.met("open", lambda: REAL["io"](path, mode, *words, **more)), self)

        def opened_plainly(path: Any, flags: int, *words: Any, **more: Any) -> Any:
            if not flags & (os.O_WRONLY | os.O_RDWR) or not self.below(path, more.get("dir_fd")):
                return REAL["open"](path, flags, *words, **more)
            return self.met("open", lambda: REAL["open"](path, flags, *words, **more))

        names = [n for n in NAMES if n != "open"]
        try:
            for name in names:
                setattr(os, name, wrapped(name))
            os.open, io.open, builtins.open = opened_plainly, opened, opened  # type: ignore[assignment]
            yield self
        finally:
            for name in (*names, "open"):
                setattr(os, name, REAL[name])
            io.open = builtins.open = REAL["io"]  # type: ignore[assignment]


REQUESTS = ("get", "put", "list", "delete", "copy")


@contextlib.contextmanager
def counted_requests(calls: Calls) -> Iterator[Calls]:
    """Within, what is asked of object storage is counted."""
    import obstore

    real = {name: getattr(obstore, name) for name in REQUESTS}

    def wrapped(name: str) -> Callable[..., Any]:
        return lambda *words, **more: calls.met(name, lambda: real[name](*words, **more))

    try:
        for name in REQUESTS:
            setattr(obstore, name, wrapped(name))
        yield calls
    finally:
        for name in REQUESTS:
            setattr(obstore, name, real[name])


class Stream:
    """A file opened for writing, whose writes are counted."""

    def __init__(self, inner: Any, calls: Calls) -> None:
        self._inner, self._calls = inner, calls

    def write(self, data: Any) -> Any:
        def do() -> Any:
            count = self._inner.write(data)
            self._inner.flush()
            return count

        return self._calls.met("write", do)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *ended: object) -> None:
        self._inner.close()

    def __iter__(self) -> Iterator[Any]:
        return iter(self._inner)


def _full(path: Any, folder: int | None) -> str:
    if isinstance(path, int):
        return _of(path)
    text = os.fspath(path)
    return os.path.join(_of(folder), text) if folder is not None else os.path.abspath(text)  # noqa: PTH100, PTH118


def _of(handle: int) -> str:
    try:
        return os.readlink(f"/proc/self/fd/{handle}")  # noqa: PTH115
    except OSError:
        return ""


def fails(code: int) -> Callable[[str, Callable[[], Any]], Any]:
    """A strike: the call does nothing but fail."""

    def strike(name: str, do: Callable[[], Any]) -> Any:
        raise OSError(code, os.strerror(code))

    return strike


def loses_its_answer(name: str, do: Callable[[], Any]) -> Any:
    """A strike: the call is done, and says that it failed."""
    do()
    raise OSError(errno.EIO, os.strerror(errno.EIO))


@dataclass
class Disk:
    """What of a directory has reached the disk: contents of files and entries of directories that were flushed.

    Nothing else is promised (POSIX): a file that was not flushed may have its earlier bytes, its new ones, or a part;
    an entry that was made, moved or removed in a directory that was not flushed may be as it was or as it is.
    """

    root: Path
    files: dict[int, bytes] = field(default_factory=dict)
    entries: dict[int, dict[str, int | str]] = field(default_factory=dict)
    kinds: dict[int, bool] = field(default_factory=dict)
    _held: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        for path, _, names in os.walk(self.root):
            self._list(Path(path))
            for name in names:
                one = Path(path, name)
                if not one.is_symlink():
                    self.files[one.lstat().st_ino] = one.read_bytes()

    def flushed(self, handle: int) -> None:
        facts, path = os.fstat(handle), Path(_of(handle))
        if stat.S_ISDIR(facts.st_mode):
            self._list(path)
        elif path.exists():
            self.files[facts.st_ino] = path.read_bytes()

    def _list(self, path: Path) -> None:
        self.entries[self._keep(path)] = self._now(path)

    def _now(self, path: Path) -> dict[str, int | str]:
        return {p.name: str(p.readlink()) if p.is_symlink() else self._keep(p) for p in path.iterdir()}

    def _keep(self, path: Path) -> int:
        """Hold a file or directory, so that its number is not given to another one."""
        number = path.lstat().st_ino
        if number not in self.kinds:
            self._held.append(REAL["open"](path, os.O_PATH | os.O_NOFOLLOW))
            self.kinds[number] = path.is_dir()
        return number

    def left(self) -> Left:
        """What is known at this moment."""
        now, there = {}, {}
        for path, _, names in os.walk(self.root):
            now[self._keep(Path(path))] = self._now(Path(path))
            for name in names:
                one = Path(path, name)
                if not one.is_symlink():
                    there[one.lstat().st_ino] = one.read_bytes()
        return Left(self.root.lstat().st_ino, dict(self.kinds), dict(self.files), dict(self.entries), there, now)

    def close(self) -> None:
        for handle in self._held:
            os.close(handle)
        self._held.clear()


@dataclass(frozen=True)
class Left:
    """What was on the disk, and what programs saw, when the power went."""

    root: int
    kinds: dict[int, bool]
    files: dict[int, bytes]
    entries: dict[int, dict[str, int | str]]
    files_now: dict[int, bytes]
    entries_now: dict[int, dict[str, int | str]]

    def build(self, target: Path, rng: random.Random, kept: float) -> None:
        """One of the directories that may be found afterwards; of what was not flushed the share `kept` is there."""
        self._directory(self.root, target, rng, kept, {})

    def _directory(self, number: int, target: Path, rng: random.Random, kept: float, placed: dict[int, Path]) -> None:
        REAL["mkdir"](target)
        old, new = self.entries.get(number, {}), self.entries_now.get(number, {})
        for name in sorted({*old, *new}):
            one = (new if rng.random() < kept else old).get(name)
            if isinstance(one, str):
                REAL["symlink"](one, target / name)
            elif one is not None and self.kinds[one]:
                self._directory(one, target / name, rng, kept, placed)
            elif one is not None and one in placed:
                REAL["link"](placed[one], target / name)
            elif one is not None:
                (target / name).write_bytes(self._bytes(one, rng, kept))
                placed[one] = target / name

    def _bytes(self, number: int, rng: random.Random, kept: float) -> bytes:
        old, new = self.files.get(number, b""), self.files_now.get(number, b"")
        if number in self.files and (old == new or number not in self.files_now):
            return old
        if rng.random() < kept:
            return new
        return rng.choice([old, new[: len(new) // 2], bytes(len(new))])
