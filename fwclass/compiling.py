"""Compiled kernels on disk: each is compiled once on a machine, by whoever asks for it first; others wait for it.

One file a kernel, version of its source, signature, processor and compiler, so that two programs at once never read
each other's. A file that is cut off is none; a directory that cannot be written to or locked costs time, never a run.
"""

from __future__ import annotations

import errno
import gc
import hashlib
import io
import os
import pickle
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from fwclass import inner
from fwclass.isolation import kernel_cache

try:
    import fcntl
except ImportError:  # Windows: nobody waits
    fcntl = None  # type: ignore[assignment]

LOCKS = "locks"
"""File of the cache whose bytes are locked, one for each kernel. The system frees them when a process ends."""

LOOK = 0.05
"""Seconds between two looks at a kernel that another process compiles."""

PATIENCE = 300.0
"""Seconds to wait for it: one that was stopped keeps its lock, and two that call each other wait for each other."""

KEPT = 30 * 86400.0
"""Seconds that kernels of another version of the program are kept after they were written."""

SUFFIX = ".kernel"

LINKING = 2
"""Goes into the names of the files; it changes with what is done to kernels while they are compiled."""

SAME_CODE = {"NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"}
"""Settings of numba in the environment with which it compiles the same, or that `codegen` tells; others go into the
names of the files: what was compiled for a debugger, or without optimising, is not taken later."""

NOTIFY_AFTER = 1.0
"""Seconds that a process compiles before a person is told."""

ONCE = "compiling for this machine, once"

listeners: list[Callable[[bool], None]] = []
"""The last is told when this process begins to compile, or to wait for a kernel, and when that is over."""

asked: list[tuple[str, Any]] = []
"""Kernels that this process called, each with the types of its arguments; what they call themselves goes with them."""

not_kept: list[str] = []
"""Why this process could not keep what it compiled, once for each kernel."""

_under_way = Counter[str]()
_stacks: list[ExitStack] = []
"""What is held for the kernels that are asked for, one on behalf of another; numba lets in one thread at a time."""
_names: list[str] = []
"""Their names."""
_since, _spent = 0.0, 0.0
_count = 0


def compile_seconds() -> float:
    """Seconds that this process has compiled, or waited for others that did."""
    return _spent + (time.perf_counter() - _since if runs() else 0.0)


def count() -> int:
    """Kernels that this process has compiled, each with those in it that have no file of their own."""
    return _count


def runs() -> bool:
    """Whether this process compiles a kernel, or waits for one."""
    return _under_way.total() > 0


@contextmanager
def _timed(name: str) -> Iterator[None]:
    """Count the time, and tell `listeners`, once for all kernels that are compiled on behalf of one."""
    global _since, _spent
    if runs():
        _under_way[name] += 1
        try:
            yield
        finally:
            _under_way[name] -= 1
        return
    _since = time.perf_counter()
    _under_way[name] += 1
    try:
        with _notify_late():
            yield
    finally:
        _spent += time.perf_counter() - _since
        _under_way[name] -= 1


@contextmanager
def _notify_late() -> Iterator[None]:
    """The last of `listeners` hears of it where it takes longer than `NOTIFY_AFTER`."""
    last = listeners[-1:]
    begun = threading.Event()

    def tell() -> None:
        begun.set()
        for listener in last:
            listener(True)

    timer = threading.Timer(max(NOTIFY_AFTER - _spent, 0.0), tell)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if begun.is_set():
            for listener in last:
                listener(False)


@contextmanager
def notify(listener: Callable[[bool], None]) -> Iterator[None]:
    """Inside, `listener` is the one of `listeners` that hears of compiling."""
    listeners.append(listener)
    try:
        yield
    finally:
        listeners.remove(listener)


@contextmanager
def _without_collection() -> Iterator[None]:
    """Python looks for no cycles in what numba makes, millions of objects that live until a kernel is compiled."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def _asked_by_kernel(name: str) -> bool:
    """Whether the function `name` is compiled, or loaded, for a kernel that calls it and not for Python."""
    return bool(_names) and (len(_names) > 1 or _names[0] != name)


class KernelFiles:
    """What numba asks for compiled code of one kernel. `stamp`: digest of what the kernel does."""

    def __init__(self, name: str, stamp: str) -> None:
        self._name, self._stamp = name, stamp

    @property
    def cache_path(self) -> str:
        """The directory of the compiled kernels."""
        return str(kernel_cache())

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The kernel from its file; else None, and it is this process that compiles it (`compile_with`)."""
        from numba.core.runtime import rtsys

        rtsys.initialize(context)  # all that compiled code calls; what compiling needs takes 0.4 s to load
        kernel_there = self._load(signature, context)
        if kernel_there is None:
            context.refresh()
            _stacks[-1].enter_context(_timed(self._name))
            _stacks[-1].enter_context(_alone(self._name))
            kernel_there = self._load(signature, context)  # it may have been made meanwhile
        return kernel_there

    def compile_with(self, dispatcher: Any) -> Callable[[Any], Any]:
        """The `compile` of `dispatcher`, that compiles only what nobody else does."""
        from numba.core.compiler_lock import global_compiler_lock

        compiled = dispatcher.compile

        def alone(signature: Any) -> Any:
            with global_compiler_lock, ExitStack() as held:
                if not _stacks:
                    asked.append((self._name, signature))
                    inner.forget(dispatcher, signature)
                    held.enter_context(_without_collection())
                _stacks.append(held)
                _names.append(self._name)
                try:
                    return compiled(signature)
                finally:
                    _stacks.pop()
                    _names.pop()

        return alone

    def _path(self, signature: Any, codegen: Any) -> Path:
        import numba

        # What only kernels call has no machine code, so that it has a file of its own.
        compiler = (codegen.magic_tuple(), numba.__version__, sys.version_info[:2])
        settings = sorted(f"{n}={v}" for n, v in os.environ.items() if n.startswith("NUMBA_") and n not in SAME_CODE)
        parts = (LINKING, len(_stacks) > 1, _type_key(signature), *compiler, *settings)
        key = hashlib.blake2b(repr(parts).encode(), digest_size=8).hexdigest()
        return kernel_cache() / f"{self._name}-{self._stamp[:16]}-{key}{SUFFIX}"

    def _load(self, signature: Any, context: Any) -> Any:
        from numba.core.compiler import CompileResult

        try:
            path = self._path(signature, context.codegen())
            data = path.read_bytes() if path.is_file() else b""  # a pipe would be waited for, for ever
            if _digest(data[32:]) == data[:32]:
                return CompileResult._rebuild(context, *_Reader(io.BytesIO(data[32:])).load())  # see `kernel_cache`
        except Exception:  # noqa: S110 - of whatever kind: it is compiled anew, and written over
            pass
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Write a compiled kernel to its file, and remove those that it replaces; a fault of the disk is said once."""
        global _count
        from numba.core.serialize import dumps

        _count += 1
        if result.library.has_dynamic_globals:
            return
        path, data = self._path(signature, result.codegen), dumps(result._reduce())
        beside = path.with_suffix(f".{os.urandom(8).hex()}")
        try:
            for other in path.parent.glob(f"{self._name}-*"):
                _tidy(other, self._stamp[:16])
            try:
                beside.write_bytes(_digest(data) + data)
                beside.replace(path)
            finally:
                beside.unlink(missing_ok=True)
        except OSError as fault:
            not_kept.append(fault.strerror or type(fault).__name__)
            _tell_not_kept(str(path.parent), not_kept[-1])

    def enable(self) -> None:
        """Numba asks for it; the files are always used."""

    def disable(self) -> None:
        """Numba asks for it; the files are always used."""

    def flush(self) -> None:
        """Numba asks for it; nothing waits to be written."""


class _Reader(pickle.Unpickler):
    """Reads compiled code without the parts of numba that only compiling needs: they take 0.4 s to load."""

    def find_class(self, module: str, name: str) -> Any:
        ours = (module, name) == ("numba.core.environment", "_rebuild_env")
        return _environment if ours else super().find_class(module, name)


def _environment(module: str, constants: list[Any], name: str) -> Any:
    """What compiled code keeps beside it: numba's `_rebuild_env`, without the module whose names nothing looks up."""
    from numba.core.environment import Environment, lookup_environment

    there = lookup_environment(name)
    if there is None:
        there = Environment._memo[name] = Environment({"__name__": module})
        there.consts[:], there.env_name = constants, name
    return there


def attach(dispatcher: Any, name: str, stamp: str) -> None:
    """Keep what `dispatcher`, numba's of the kernel `name`, compiles, and compile nothing that others compile now."""
    inner.change_numba(_asked_by_kernel)
    files = KernelFiles(name, stamp)
    dispatcher._cache = files
    dispatcher.compile = files.compile_with(dispatcher)
    dispatcher.add_overload = inner.kept_from_python(dispatcher)
    dispatcher.get_call_template = _for_all_numbers(dispatcher.get_call_template)


def _for_all_numbers(template: Callable[..., Any]) -> Callable[..., Any]:
    """Other kernels call one instance, whatever whole number they name; else each number is a kernel of its own."""
    from numba import types

    def get_call_template(words: Any, named: Any) -> Any:
        return template(
            tuple(map(types.unliteral, words)), {name: types.unliteral(kind) for name, kind in named.items()}
        )

    return get_call_template


def _type_key(kind: Any) -> Any:
    """A type of numba in words that differ for all that is compiled differently; its own leave out fields' names."""
    if isinstance(kind, tuple):
        return tuple(map(_type_key, kind))
    return repr(kind), getattr(kind, "fields", None), _type_key(tuple(getattr(kind, "types", ())))


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=32).digest()


def _tidy(other: Path, stamp: str) -> None:
    """Remove what a process that was killed left half-written, and kernels of a version long gone."""
    old = time.time() - KEPT
    with suppress(OSError):
        if other.suffix != SUFFIX or (f"-{stamp}-" not in other.name and other.stat().st_mtime < old):
            other.unlink()


@cache
def _tell_not_kept(place: str, why: str) -> None:
    sys.stderr.write(f"fwclass: compiled code cannot be kept in {place}: {why}; it is compiled anew for this command\n")


@contextmanager
def _alone(name: str) -> Iterator[None]:
    """No other process of this machine compiles the kernel; after `PATIENCE`, or without locks, one may."""
    file = _locks(str(kernel_cache()))
    place = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=7).digest())
    if file is None or not _locked(file, place):
        yield
        return
    _holds[place] += 1
    try:
        yield
    finally:
        _holds[place] -= 1
        if not _holds[place]:  # one that calls itself holds it twice
            with suppress(OSError):
                fcntl.lockf(file, fcntl.LOCK_UN, 1, place)


_holds = Counter[int]()


def _locked(file: int, place: int) -> bool:
    until = time.monotonic() + PATIENCE
    while True:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
            return True
        except OSError as fault:  # another has it; anything else: a file system without locks
            if fault.errno not in (errno.EACCES, errno.EAGAIN) or time.monotonic() > until:
                return False
        time.sleep(LOOK)


@cache
def _locks(directory: str) -> int | None:
    """The file of locks, open for good: whoever closes it loses all locks of the process."""
    if fcntl is None:
        return None
    try:
        Path(directory).mkdir(
            parents=True, exist_ok=True
        )  # an image's is for all its users; `kernel_cache` makes its own
        return os.open(Path(directory) / LOCKS, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError:
        return None
