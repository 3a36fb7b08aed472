"""The process that tries inputs in the commands themselves: each in a fork of it that gives `fwclass.cli.main` the
words, as a user would. What is loaded and compiled is so once.

Reads lines ``COMMAND CASE RECIPE`` or ``COMMAND * NUMBER`` (a drawn one) and answers with a line of JSON each. An input
may take `CPU_FIXED` s + `CPU_EACH` s a byte of the processor (`CPU_EACH_OF_RUNS` of a run) and grow by the `memory` of
its command + `MEMORY_EACH` bytes a byte beyond what that takes for the sound files, which are tried only where an input
does more than is allowed without them.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
import unicodedata
from collections.abc import Callable, Iterable
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[k]) for k in (0, 1, 2)]

from cases import Case  # noqa: E402 - the path comes first
from child import _status, laid  # noqa: E402
from looks import look  # noqa: E402

CPU_FIXED, CPU_EACH = float(os.environ.get("FUZZ_CPU_SECONDS", "10")), 10e-6
RUNS = {"run", "train", "select"}
CPU_EACH_OF_RUNS = 10e-3
"""A damaged record of 30 bytes may be a point by itself, with a tile and nine blocks of its own: 0.3 s."""

MEMORY_EACH = 200

WALL = 600.0
CODES = {0, 1, 2, 3, 4}
HELD = 8
"""The address space ends at so many times what is allowed, so that most of what is too much can be measured."""

WARNING = re.compile(r"^.*\b(?:\w*Warning: |Warning \d+: |ERROR \d+: ).*$", re.M)
FOREIGN = 0.1
"""Share of drawn inputs with the content of another kind of file."""


def drawn(command: str, number: int, pool: list[tuple[str, str]] | None = None) -> tuple[str, str]:
    """Case and recipe of the input `number`: the same whoever asks, for the same `pool` of recipes to go on from."""
    from commands import case_of, cases_of, foreign
    from mutate import recipe

    rng = random.Random(f"{command} {number}")  # noqa: S311 - must be the same every time
    if pool and rng.random() < 0.5:
        name, before = rng.choice(pool)
    else:
        name, before = rng.choice(sorted(cases_of(command))), ""
        if rng.random() < FOREIGN:
            name += "~" + rng.choice(sorted(foreign()))
            if rng.random() < 0.5:
                return name, ""
    seed = case_of(command, name).seed
    more = recipe(seed.files, seed.fields, seed.texts, rng) if any(seed.files.values()) else ""
    return name, ";".join(filter(None, (before, more)))


class Server:
    """Tries cases in forks; `lines` of the package that were seen tell whether an input is a new one."""

    def __init__(self, folder: Path, covers: bool) -> None:
        self._folder, self._covers = folder, covers
        self._own: dict[tuple[str, str], int] = {}
        self._seen: set[int] = set()

    def warm(self, command: str) -> None:
        """Load and compile in this process what the command takes."""
        from commands import cases_of

        every = list(cases_of(command).values())
        some = (
            (*every[:4], every[-1], *(c for c in every if "compressed" in c.seed.name)) if len(every) > 2 else every[:1]
        )
        for case in {c.seed.name: c for c in some}.values():
            laid(self._folder, {**case.fixed, **case.seed.files}, case.links)
            self._main(case, self._folder.parent)

    def answer(self, command: str, name: str, recipe: str) -> dict[str, object]:
        from commands import case_of, cases_of
        from mutate import applied

        case = case_of(command, name)
        known = name.partition("~")[0]
        files = case.sealed(applied(case.seed.files, recipe))
        sound = cases_of(command) if "~" in name else (known,)  # what lies there may be sound for another case
        own = self._taken(command, sound) if self._covers else 0  # lines that sound files reach are not new
        answer = self._forked(command, known, files, own)
        if answer["told"] and not self._covers and (own := self._taken(command, sound)):
            answer = self._forked(command, known, files, own)
        return {"seed": name, "recipe": recipe, **answer}

    def _taken(self, command: str, names: Iterable[str]) -> int:
        """The most memory [bytes] that the sound files of the named cases take."""
        from commands import case_of

        for name in names:
            if (command, name) not in self._own:
                answer = self._forked(command, name, case_of(command, name).seed.files)
                self._own[command, name] = int(answer["grown"])
        return max(self._own[command, name] for name in names)

    def _forked(self, command: str, name: str, files: dict[str, bytes], own: int = 0) -> dict[str, object]:
        """How the command ended with these files, in a process of its own; `own`: what it takes for sound ones."""
        from commands import ALL, cases_of

        case = cases_of(command)[name]
        laid(self._folder, {**case.fixed, **files}, case.links)
        size = sum(map(len, files.values())) + sum(map(len, case.fixed.values()))
        runs = case.words[0] in RUNS
        allowed = ALL[command].memory + MEMORY_EACH * size + own
        seconds = CPU_FIXED + (CPU_EACH_OF_RUNS if runs else CPU_EACH) * size
        measured = self._folder.parent / "figures"  # a pipe would hold 64 KiB, and the child wait for its reader
        measured.unlink(missing_ok=True)
        pid = os.fork()
        if pid == 0:
            self._child(case, measured, allowed, seconds)
        status, used = _waited(pid)
        figures = json.loads(measured.read_text()) if measured.exists() else {}
        grown = int(figures.get("grown", 0))
        cpu = used.ru_utime + used.ru_stime
        out, err = (_text(self._folder.parent / n) for n in ("out", "err"))
        wrong = _wrong(status, out, err, self._folder)
        if wrong in ("SIGPROF", "SIGKILL"):
            wrong = f"more than {seconds:.0f} s of the processor" if wrong == "SIGPROF" else f"not done in {WALL:.0f} s"
        elif not wrong and grown > allowed and _loaded(figures["modules"]):
            return self._forked(command, name, files, own)  # what is loaded once costs no input anything
        elif not wrong and grown > allowed:
            wrong = f"{grown >> 20} MiB, where {allowed >> 20} are allowed for {size} bytes"
        new = set(figures.get("lines", ())) - self._seen
        self._seen |= new
        code = os.waitstatus_to_exitcode(status)
        return {
            "ended": "wrong" if wrong else "done" if code in (0, 4) else "refused",
            "told": wrong,
            "code": code,
            "seconds": cpu,
            "size": size,
            "grown": grown,
            "allowed": allowed,
            "new": len(new),
            "err": err[-400:],
        }

    def _child(self, case: Case, measured: Path, allowed: int, seconds: float) -> None:
        before, modules = _status("VmSize"), set(sys.modules)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_STACK, (1 << 20, resource.RLIM_INFINITY))  # of threads: they count
        resource.setrlimit(resource.RLIMIT_AS, (before + HELD * allowed, resource.RLIM_INFINITY))
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_PROF, seconds)
        lines: set[int] = set()
        if self._covers:
            sys.settrace(_tracer(lines))
        code = self._main(case, self._folder.parent)
        sys.settrace(None)
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        figures = {
            "grown": _status("VmPeak") - before,
            "lines": list(lines),
            "modules": [*sys.modules.keys() - modules],
        }
        written = json.dumps(figures)
        beside = measured.with_suffix(".part")
        beside.write_text(written)
        beside.rename(measured)
        os._exit(code)

    def _main(self, case: Case, beside: Path) -> int:
        """The command in this process, its outputs in files `beside`; its exit code."""
        main = {"harm": _harm, "look": look}.get(case.words[0]) or _command()
        kept = os.dup(0), os.dup(1), os.dup(2)
        handle = os.open(self._folder / case.stdin if case.stdin else os.devnull, os.O_RDONLY)
        os.dup2(handle, 0)
        os.close(handle)
        for number, name in ((1, "out"), (2, "err")):
            handle = os.open(beside / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(handle, number)
            os.close(handle)
        os.chdir(self._folder)
        sys.argv, code = ["fwclass", *case.words], 0
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except BaseException:
            import traceback

            traceback.print_exc()
            code = 1
        finally:
            os.chdir(self._folder.parent)
            sys.stdout.flush()
            sys.stderr.flush()
            for number, handle in enumerate(kept):
                os.dup2(handle, number)
                os.close(handle)
        return code


def _command() -> Callable[[], None]:
    from fwclass.cli import main

    return main


def _harm() -> None:
    """No command: does what its file says, so that the watch over commands can be tested."""
    does = Path(sys.argv[2]).read_bytes().decode()
    if does == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    while does == "hang":
        pass
    if does == "hoard":
        bytearray(1 << 28)
    if does == "raise":
        1 / 0  # noqa: B018
    if does in ("warn", "colour"):
        print("a.py:1: UserWarning: no" if does == "warn" else "\x1b[31m", file=sys.stderr)
    if does in ("mute", "odd"):
        sys.exit(1 if does == "mute" else 7)


def _tracer(lines: set[int]):
    """Notes lines of the package's readers, formats and doors."""
    root = str(Path(__file__).parents[2] / "fwclass") + os.sep

    def local(frame, event, _):
        if event == "line":
            lines.add(hash((frame.f_code.co_filename, frame.f_lineno)) & 0xFFFFFFFF)
        return local

    def outer(frame, event, _):
        return local if frame.f_code.co_filename.startswith(root) else None

    return outer


def _loaded(modules: list[str]) -> bool:
    """Load modules into this process too; whether there was a new one."""
    before = len(sys.modules)
    for name in modules:
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    return len(sys.modules) > before


def _waited(pid: int) -> tuple[int, resource.struct_rusage]:
    """Until the process has ended, or `WALL` is over."""
    end, pause = time.monotonic() + WALL, 0.001
    while time.monotonic() < end:
        done, status, used = os.wait4(pid, os.WNOHANG)
        if done:
            return status, used
        time.sleep(pause)
        pause = min(0.01, pause * 1.5)
    os.kill(pid, signal.SIGKILL)
    _, status, used = os.wait4(pid, 0)
    return status, used


def _text(path: Path) -> str:
    with path.open("rb") as stream:
        return stream.read(1 << 20).decode("utf-8", "backslashreplace")


def _wrong(status: int, out: str, err: str, folder: Path) -> str:
    """What the command did that none may do, empty if nothing."""
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        return signal.Signals(-code).name
    if "Traceback (most recent call last)" in err + out:
        return "traceback: " + err.strip().splitlines()[-1]
    if any(m in err for m in ("\n  traceback: ", "Fatal Python error")):
        logs = [p.read_text() for p in (folder / "r" / "logs").rglob("*.log")]
        last = [re.sub(r".*\\n(?=\S)", "", w) for log in logs for w in re.findall(r'traceback="(.*?)\\n"', log)]
        return "a part's traceback: " + "; ".join(last[:2])
    if code not in CODES:
        return f"exit code {code}"
    if code and not (err + out).strip():
        return f"exit code {code} without a word"
    control = {c for c in err + out if c not in "\n\t" and unicodedata.category(c) == "Cc"}
    if control:
        return f"control characters: {sorted(map(ord, control))}"
    warned = WARNING.search(err + out)
    return f"a library's warning: {warned[0].strip()[:300]}" if warned else ""


def main(commands: list[str]) -> None:
    import numba  # noqa: F401 - the program's own, whatever the sound files need

    covers = "--cover" in commands
    commands = [c for c in commands if c != "--cover"]
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "input"
        folder.mkdir()
        server = Server(folder, covers)
        for command in commands:
            server.warm(command)
        gc.collect()
        gc.freeze()
        print(json.dumps({"ready": commands}), file=answers)
        pools: dict[str, list[tuple[str, str]]] = {}
        for line in sys.stdin:
            command, case, recipe = line.rstrip("\n").split(" ", 2)
            pool = pools.setdefault(command, [])
            if case == "*":
                case, recipe = drawn(command, int(recipe), pool if covers else None)
            answer = server.answer(command, case, recipe)
            if answer["new"] and covers:
                pool.append((case, recipe))
            print(json.dumps(answer), file=answers)
        os.chdir("/")  # the directory goes


if __name__ == "__main__":
    main(sys.argv[1:])
