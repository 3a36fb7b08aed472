"""Each kernel is compiled once on a machine, whoever is killed, and whatever the directory of compiled code is like."""

from __future__ import annotations

import inspect
import os
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from fwclass import compiling
from fwclass.cli import cli
from fwclass.operate import compile_all
from fwclass.operate.compile_all import _text, _type, listed_kernels

LOWER = """
from fwclass.kernel import kernel, vectorised

@kernel
def more(x):
    return x + {more}

@kernel
def apart(x, y):
    return (x + y) - x

@vectorised
def loose(x, y):
    return apart(x, y)

@kernel
def place(values, at):
    return values[at]
"""
UPPER = """
from fwclass.kernel import kernel
from lower import more, place

@kernel
def total(values):
    found = 0.0
    for k in range(len(values)):
        found += more(values[k])
    return found + place(values, 0) + place(values, 1) + place(values, len(values) - 1)
"""
TOTAL = "import numpy as np; from upper import total; from fwclass import compiling; answer = total(np.ones(3))\n"
TELL = "print(answer, compiling.count())"
KERNELS = 3
"""That `total` needs."""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """The kernels above, and a cache for them."""
    return made(tmp_path / "one", 1.0)


def made(directory: Path, more: float) -> Path:
    directory.mkdir()
    (directory / "lower.py").write_text(LOWER.format(more=more))
    (directory / "upper.py").write_text(UPPER)
    return directory


def started(code: str, program: Path, cache: Path, **environment: str) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(program), str(Path(__file__).parents[1])])
    return subprocess.Popen(
        [sys.executable, "-P", "-c", code],
        env=os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(cache)} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(process: subprocess.Popen[str]) -> tuple[float, int, str]:
    """The answer, the kernels that were compiled, and what was told."""
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    answer, count = out.split()[-2:]
    return float(answer), int(count), err


def run(program: Path, cache: Path, before: str = "", **environment: str) -> tuple[float, int, str]:
    return ended(started(before + TOTAL + TELL, program, cache, **environment))


@contextmanager
def holding(program: Path, cache: Path, name: str) -> Iterator[subprocess.Popen[str]]:
    """A process that is at a kernel, and does not end."""
    code = f"""import time; from fwclass import compiling
with compiling._alone({name!r}): print('holds', flush=True); time.sleep(99)"""
    process = started(code, program, cache)
    try:
        assert process.stdout is not None and process.stdout.readline() == "holds\n"
        yield process
    finally:
        process.kill()
        process.communicate()


def test_several_processes_at_once_compile_each_kernel_once(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    found = [ended(p) for p in [started(TOTAL + TELL, program, cache) for _ in range(3)]]
    assert [answer for answer, _, _ in found] == [9.0] * 3 and sum(count for _, count, _ in found) == KERNELS
    assert run(program, cache) == (9.0, 0, "")


@pytest.mark.slow
def test_who_is_killed_while_it_compiles_is_waited_for_no_longer(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    with holding(program, cache, "upper.total") as other:
        (cache / "upper.total-0-0.half").write_bytes(b"half")
        process = started(TOTAL + TELL, program, cache)
        time.sleep(3.0)
        assert process.poll() is None
        other.kill()
        assert ended(process)[:2] == (9.0, KERNELS)
    assert {p.suffix for p in cache.iterdir()} == {"", compiling.SUFFIX}  # the file of locks, and kernels


def test_who_is_stopped_is_not_waited_for_for_ever(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    with holding(program, cache, "upper.total") as other:
        other.send_signal(signal.SIGSTOP)
        assert run(program, cache, "from fwclass import compiling; compiling.PATIENCE = 0.5\n")[:2] == (9.0, KERNELS)


@pytest.mark.slow
def test_a_file_that_is_cut_off_is_made_again(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    run(program, cache)
    for path in cache.glob(f"*{compiling.SUFFIX}"):
        path.write_bytes(path.read_bytes()[:-100] if "more" not in path.name else b"")
    assert run(program, cache) == (9.0, KERNELS, "")
    assert run(program, cache) == (9.0, 0, "")


@pytest.mark.slow
def test_a_file_that_is_another_kernels_is_made_again(program: Path, tmp_path: Path) -> None:
    """Whole, and nothing that can be loaded."""
    cache = tmp_path / "cache"
    run(program, cache)
    for path in cache.glob(f"*{compiling.SUFFIX}"):
        path.write_bytes(compiling._digest(b"no pickle") + b"no pickle")
    assert run(program, cache) == (9.0, KERNELS, "")


def test_a_place_that_cannot_be_written_to_is_told_once(program: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    answer, count, told = run(program, tmp_path / "file" / "cache")
    assert (answer, count) == (9.0, KERNELS)
    assert told.count("compiled code cannot be kept in") == 1 and "Not a directory" in told


def test_a_full_disk_is_told_once_and_nothing_half_written_stays(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    full = """
import pathlib
real = pathlib.Path.write_bytes
def write_bytes(self, data):
    real(self, data[:50])
    raise OSError(28, "No space left on device")
pathlib.Path.write_bytes = write_bytes
"""
    answer, count, told = run(program, cache, full)
    assert (answer, count) == (9.0, KERNELS) and told.count("No space left on device") == 1
    assert [p.name for p in cache.iterdir()] == [compiling.LOCKS]


@pytest.mark.parametrize("private", [True, False])
def test_compiling_ahead_fails_at_once_where_nothing_can_be_kept(tmp_path: Path, private: bool) -> None:
    """A package's or image's build must not pass with an empty directory."""
    cache = tmp_path / "fwclass" / "kernels"
    cache.mkdir(parents=True)
    cache.chmod(0o755 if private else 0o777)
    barred = "import os; os.urandom = lambda n: bytes(200); " if private else ""  # a file's name that is too long
    code = f"{barred}from fwclass.cli import main; main()"
    words = {"NUMBA_CACHE_DIR": str(cache) if private else "", "XDG_CACHE_HOME": str(tmp_path)}
    ended = subprocess.run(
        [sys.executable, "-P", "-c", code, "compile", "--json"],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])} | words,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (ended.returncode, ended.stdout) == (1, ""), ended.stderr
    reason = "File name too long" if private else "other users may write there"
    assert f"where: {cache}\n" in ended.stderr and f"got: {reason}\n" in ended.stderr
    assert [p.name for p in cache.iterdir()] == [compiling.LOCKS] * private


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes with names")
def test_a_pipe_in_the_place_of_a_kernel_is_not_waited_for(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    run(program, cache)
    for path in cache.glob(f"*{compiling.SUFFIX}"):
        path.unlink()
        os.mkfifo(path)
    assert run(program, cache) == (9.0, KERNELS, "")
    assert run(program, cache) == (9.0, 0, "")


def test_what_was_compiled_is_read_where_nothing_can_be_written_or_locked(program: Path, tmp_path: Path) -> None:
    """As in an image: a directory that another user made."""
    cache = tmp_path / "cache"
    run(program, cache, "import os; os.umask(0o022)\n")
    assert all(p.stat().st_mode & 0o044 for p in (cache, *cache.glob(f"*{compiling.SUFFIX}")))
    barred = """
import os, fcntl
def no(*words): raise OSError(30, 'Read-only file system')
fcntl.lockf = no; os.mkdir = no
"""
    assert run(program, cache, barred) == (9.0, 0, "")


WHOLE = """
import numpy as np
from fwclass.kernel import kernel

@kernel
def total(values):
    return np.sum(values) if values.any() else -1.0
"""
"""A kernel with copies of numba's own functions in it, which name the modules that they are written in."""


def test_who_only_reads_what_was_compiled_does_not_load_what_compiles(tmp_path: Path) -> None:
    (tmp_path / "upper.py").write_text(WHOLE)
    heavy = "; import sys; print('scipy.linalg' in sys.modules or 'numba.np.arraymath' in sys.modules);"
    for count, loaded in ((1, "True"), (0, "False")):
        process = started(TOTAL + heavy[2:] + TELL, tmp_path, tmp_path / "cache")
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        assert out.split() == [loaded, "3.0", str(count)]


@pytest.mark.slow
def test_two_versions_and_two_processors_keep_their_own(program: Path, tmp_path: Path) -> None:
    cache, other = tmp_path / "cache", made(tmp_path / "other", 5.0)
    plain = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    asked = [(program, {}), (other, {}), (program, plain)]
    began = [started(TOTAL + TELL, place, cache, **words) for place, words in asked]
    assert [ended(p)[0] for p in began] == [9.0, 21.0, 9.0]
    assert [run(place, cache, **words)[:2] for place, words in asked] == [(9.0, 0), (21.0, 0), (9.0, 0)]


def test_what_was_compiled_for_a_debugger_is_not_taken_later(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(program, cache, NUMBA_BOUNDSCHECK="1")[:2] == (9.0, KERNELS)
    assert run(program, cache)[:2] == (9.0, KERNELS)
    assert run(program, cache, NUMBA_BOUNDSCHECK="1", NUMBA_NUM_THREADS="1")[:2] == (9.0, 0)


def test_versions_long_gone_are_removed(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    cache.mkdir()
    for name, days in (("old", 31), ("young", 29)):
        path = cache / f"upper.total-{name}-0{compiling.SUFFIX}"
        path.write_bytes(b"")
        os.utime(path, (time.time() - 86400 * days,) * 2)
    run(program, cache)
    assert sorted(p.name.split("-")[1] for p in cache.glob("upper.total-*"))[-1] == "young"
    assert len(list(cache.glob("upper.total-*"))) == 2


def test_what_only_kernels_call_has_no_machine_code_until_python_calls_it(program: Path, tmp_path: Path) -> None:
    code = """
import gc
from fwclass import inner
from lower import more
waiting = {library.name for library in inner._waiting} & {"more", "place", "total"}
answer = more(answer) if waiting == {"more", "place"} and gc.isenabled() else waiting
"""
    cache = tmp_path / "cache"
    assert ended(started(TOTAL + code + TELL, program, cache)) == (10.0, KERNELS + 1, "")
    alone = "from fwclass import compiling; from lower import more; answer = more(1.0)\n"
    assert ended(started(alone + TELL, program, cache)) == (2.0, 0, "")


MODULES = """
import hashlib, sys
from fwclass import compiling, frontend
if sys.argv[1] == "long":
    frontend.shorten = lambda: None
from fwclass.operate.compile_all import _type, listed_kernels
wanted = [(kernel, types) for kernel, types in listed_kernels() if kernel.__name__ in ("_relax", "nearest_of_pulse")]
compiled = [kernel.compiled() for kernel, _ in wanted]
from numba.core.codegen import CPUCodeLibrary
optimise = CPUCodeLibrary._optimize_final_module
def tell(library):
    print(library.name, hashlib.blake2b(str(library._final_module).encode()).hexdigest())
    optimise(library)
CPUCodeLibrary._optimize_final_module = tell
for kernel, (_, types) in zip(compiled, wanted):
    kernel.compile(tuple(map(_type, types)))
"""


@pytest.mark.slow
def test_a_shorter_way_through_the_compiler_gives_it_the_same_code(tmp_path: Path) -> None:
    told = []
    for way in ("long", "short"):
        ended = subprocess.run(
            [sys.executable, "-P", "-c", MODULES, way],
            env=os.environ
            | {
                "PYTHONPATH": str(Path(__file__).parents[1]),
                "NUMBA_CACHE_DIR": str(tmp_path / way),
                "PYTHONHASHSEED": "0",
            },
            capture_output=True,
            text=True,
        )
        assert ended.returncode == 0, ended.stderr
        told.append(ended.stdout)
    assert told[0].count("\n") > 5
    assert told[0] == told[1]


FAULT = """
from fwclass.kernel import kernel
class Wrong(ValueError): pass
@kernel
def refuse(x):
    if x > 1.0:
        raise Wrong("too high", 7)
    return x
@kernel
def outer(x):
    return refuse(x) + 1.0
"""


def test_what_a_kernel_inside_another_raises_arrives_compiled_or_loaded(tmp_path: Path) -> None:
    (tmp_path / "upper.py").write_text(FAULT)
    code = """
import gc
from fwclass import compiling
from upper import Wrong, outer
try:
    outer(2.0)
except Wrong as fault:
    answer = fault.args[1] + outer(1.0)
"""
    found = [ended(started(code + TELL, tmp_path, tmp_path / "cache")) for _ in range(2)]
    assert found == [(9.0, 2, ""), (9.0, 0, "")]


def test_a_kernel_does_not_divide_as_its_first_caller_may(program: Path, tmp_path: Path) -> None:
    """numba hands `fastmath` down to whatever says nothing of it, and keeps that for all callers."""
    code = (
        "from lower import apart, loose; loose(1e30, 1.0); answer = apart(1e30, 1.0)\nfrom fwclass import compiling\n"
    )
    assert ended(started(code + TELL, program, tmp_path / "cache"))[0] == 0.0


def test_a_person_is_told_from_a_second_on(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[bool] = []
    monkeypatch.setattr(compiling, "_spent", 0.0)
    with compiling.notify(heard.append):
        with compiling._timed("a"):
            pass
        assert heard == []
        with compiling._timed("a"), compiling._timed("b"):
            time.sleep(compiling.NOTIFY_AFTER + 0.3)
            assert heard == [True]
        assert heard == [True, False] and not compiling.runs() and compiling.compile_seconds() > compiling.NOTIFY_AFTER


def test_the_list_of_kernels_can_be_read_and_is_as_it_is_written() -> None:
    kernels = listed_kernels()
    assert len(kernels) > 80
    for kernel, types in kernels:
        assert [_text(_type(told)) for told in types] == types, kernel
        assert len(types) == len(inspect.signature(kernel).parameters), f"{kernel}: run tests/kernels/record.py"


def test_what_records_the_list_says_how_it_is_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["record.py", "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(Path(__file__).parent / "kernels" / "record.py"), run_name="__main__")
    assert ended.value.code == 0 and "--anew" in capsys.readouterr().out and not list(tmp_path.iterdir())


def test_an_entry_that_does_not_fit_its_kernel_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel, types = next(row for row in listed_kernels() if row[0].__name__ == "levels")
    monkeypatch.setattr(compile_all, "listed_kernels", lambda: [(kernel, types[1:]), (kernel, types)])
    made = compile_all.compile_all()
    assert made["listed"] == 2 and len(made["left_out"]) == 1 and made["left_out"][0].startswith("levels: ")


def test_an_entry_whose_named_tuple_has_other_fields_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = listed_kernels()
    kernel, types = next((kernel, types) for kernel, types in rows if any(type(t) is list and t[0] for t in types))
    short = [t[:-1] if type(t) is list else t for t in types]
    monkeypatch.setattr(compile_all, "listed_kernels", lambda: [(kernel, short)])
    left = compile_all.compile_all()["left_out"]
    assert len(left) == 1 and "fields, the list" in left[0]


@pytest.mark.slow
def test_after_compile_a_run_compiles_nothing(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "fwclass"]
    path = str(Path(__file__).parents[1])
    environment = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def kept() -> set[tuple[str, int]]:
        return {(p.name, p.stat().st_mtime_ns) for p in (tmp_path / "cache").glob(f"*{compiling.SUFFIX}")}

    def done(*more: str) -> str:
        told = subprocess.run(
            [*words, *more], env=environment, cwd=tmp_path, check=True, capture_output=True, text=True
        )
        return told.stderr

    assert "kernels compiled in" in done("compile")
    before = kept()
    assert len(before) > 200
    assert done("compile").startswith("0 kernels compiled")
    assert compiling.ONCE not in done("demo", "--out", "demo", "--workers", "0")
    assert kept() == before
    # what compiled code calls is there without what compiles: the process would end where one is missing
    read = subprocess.run(
        [sys.executable, "-c", READ_ALL], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert (read.returncode, read.stderr) == (0, "")
    assert int(read.stdout) > 100


READ_ALL = """
from fwclass import compiling
from fwclass.operate.compile_all import _type, listed_kernels
from numba.core.runtime import rtsys
from numba.core.registry import cpu_target
for kernel, types in listed_kernels():
    compiled = kernel.compiled()
    assert compiled._cache.load_overload(tuple(map(_type, types)), cpu_target.target_context) is not None, kernel
import sys
assert 'numba.np.arraymath' not in sys.modules
print(len(listed_kernels()))
"""


def test_a_command_without_progress_tells_it_once(tmp_path: Path, program: Path) -> None:
    code = """
import time
from fwclass.cli.base import cli
from fwclass import compiling
@cli.command()
def waits():
    for _ in range(2):
        with compiling._timed("a"):
            time.sleep(1.3)
cli(["waits"], standalone_mode=False)
answer = 0.0
"""
    told = ended(started(code + TELL, program, tmp_path / "cache"))[2]
    assert told == f"{compiling.ONCE}; `fwclass compile` makes all kernels ahead\n"


def test_help_tells_of_compile() -> None:
    assert "Compile all kernels" in CliRunner().invoke(cli, ["--help"]).output
