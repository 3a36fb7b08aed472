"""Nothing is imported or read from the current directory, which may be a stranger's.

Python imports modules from there (`python -m`, `python -c`, which starts the workers), numba and matplotlib read their
configuration from there, and numba's names a directory of compiled code, which it unpickles.
"""

from __future__ import annotations

import atexit
import os
import stat
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from fwclass.lazy_module import LazyModule

CONFIGURATIONS = {"numba": ".numba_config.yaml", "matplotlib": "matplotlibrc"}
"""Files that a library reads from the current directory when it is imported."""

CACHE = "NUMBA_CACHE_DIR"
THREADS = "NUMBA_NUM_THREADS"
SUMS = "OPENBLAS_NUM_THREADS"
CHILDREN = {"PYTHONSAFEPATH": "1", "PROJ_NETWORK": "OFF", "PYDANTIC_DISABLE_PLUGINS": "__all__"}
"""For this process's own children: nothing is imported from where they start, no grid of a datum is fetched, and no
package is loaded because it calls itself a plugin of pydantic, which asks all of the environment."""

SETTINGS = (
    "GDAL_",
    "GTIFF_",
    "TIFF_",
    "COG_",
    "BIGTIFF_",
    "CPL_",
    "VSI_",
    "OGR_",
    "OSR_",
    "ESRI_",
    "SHAPE_",
    "GPKG_",
    "SQLITE_",
)
"""How variables begin by which GDAL writes and reads otherwise (the order of bytes, overviews, holes of polygons)."""
OVERVIEWS = frozenset(
    f"{name}_OVERVIEW"
    for name in (
        "ALPHA",
        "COMPRESS",
        "INTERLEAVE",
        "JPEG_QUALITY",
        "JPEG_TABLESMODE",
        "JXL_ALPHA_DISTANCE",
        "JXL_DISTANCE",
        "JXL_EFFORT",
        "JXL_LOSSLESS",
        "MAX_Z_ERROR",
        "PHOTOMETRIC",
        "PREDICTOR",
        "SPARSE_OK",
        "WEBP_LEVEL",
        "WEBP_LOSSLESS",
        "ZLEVEL",
        "ZSTD_LEVEL",
    )
)
"""Those by which it packs the overviews of rasters, as its libraries hold them (3.10.3 and 3.12.4); another program's
may end alike."""
PLACES = ("GDAL_DATA", "CPL_TMPDIR", "GDAL_CONFIG_FILE")
"""Those that say where something lies; of the last one nothing is read."""

UNUSED = {"laspy": "requests", "pyarrow": "cloudpickle"}
"""Libraries, and what they load to read from a network and to pack functions, which no command has them do: that takes
as long to load as much of their own."""

LATER = {"pyogrio": "geopandas pandas", "rasterio": "boto3"}
"""Libraries, and what they load where it is installed to make data frames and to reach buckets: as much once more as
all that a command loads to write rasters and polygons. They find it when they use it."""

PARTS_OF_NUMPY = ("f2py", "testing")
"""What SciPy loads as it takes all names of numpy, and no command uses: a quarter of what `scipy.ndimage` takes."""

_fresh = ExitStack()
"""The directory of compiled code that ends with this process, where there is one."""

faults_of_cache: list[tuple[Path, str]] = []
"""Which directory of compiled code was not taken, and why, where what is compiled ends with this process."""

_before: dict[str, str | None] = {}
"""What the variables that were set here held before."""


def isolate() -> None:
    """Import nothing from the current directory any more, and print no warnings of libraries: here and in the processes
    that this one starts.

    Called first by every entry of the command. A program that imports fwclass keeps its own import path.
    """
    for name, value in CHILDREN.items():
        _set(name, value)
    ignore_settings()
    if not os.environ.get(THREADS, "1").isdecimal() or int(os.environ.get(THREADS, "1")) == 0:
        _set(THREADS, "1")  # what numba ends with a traceback for; no kernel has threads of its own
    _set(SUMS, "1")  # as dask starts workers: last digits of long sums of numpy's depend on it
    if not sys.warnoptions:  # of libraries, with paths of the installation; what is wrong is told in words
        warnings.simplefilter("ignore")
        _set("PYTHONWARNINGS", "ignore")
    path = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if not all(map(os.path.isabs, path)) and path != [""]:
        _set("PYTHONPATH", os.pathsep.join(filter(os.path.isabs, path)))
    own = str(Path(__file__).parents[1])
    first = sys.path[0] if sys.path else ""
    put_there = not sys.flags.safe_path and first != own and first == _here()  # `python -m`
    sys.path[:] = filter(os.path.isabs, sys.path[put_there:])
    if own not in sys.path:  # it was found in what was taken away
        sys.path.append(own)


def ignore_settings() -> None:
    """No variable of the environment and no file of its own decides what GDAL reads and writes: the same survey gives
    the same bytes, whoever asks for it. Also where a worker was started by hand."""
    for name in [name for name in os.environ if name.startswith(SETTINGS) or name in OVERVIEWS]:
        if name not in PLACES:
            _before.setdefault(name, os.environ.pop(name))
    _set("GDAL_CONFIG_FILE", os.devnull)


def _set(name: str, value: str) -> None:
    _before.setdefault(name, os.environ.get(name))
    os.environ[name] = value


def outer_environment() -> dict[str, str]:
    """The environment as it was before `isolate`, for commands of the user's own."""
    added = {name: value for name, value in os.environ.items() if name not in _before}
    return added | {name: value for name, value in _before.items() if value is not None}


def _here() -> str:
    try:
        return os.getcwd()  # noqa: PTH109 - compared with a text
    except OSError:  # it was removed
        return ""


def cache_home() -> Path:
    """The user's directory for what can be made again; `RuntimeError` for a user without a home."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    return Path(named) if Path(named).is_absolute() else Path.home() / ".cache"


def kernel_cache() -> Path:
    """Where compiled kernels are kept, for this process and its children: below the user's cache directory.

    What lies there is run. So it must belong to this user, and nobody else may write there; otherwise a fresh
    directory is taken, which ends with this process, and standard error tells why.

    `ConfigError`: the user's own ``NUMBA_CACHE_DIR`` depends on the current directory.
    """
    message = os.environ.get(CACHE)
    if message and not Path(message).is_absolute():
        from fwclass.errors import ConfigError

        raise ConfigError(
            "the directory of compiled code depends on the current directory",
            where=f"environment variable {CACHE}",
            expected="an absolute path",
            got=message,
            do=f"unset {CACHE}, or name a directory that is yours alone",
        )
    if message:
        return Path(message)
    try:
        place = cache_home() / "fwclass" / "kernels"
        fault = _not_private(place)
    except RuntimeError as error:
        place, fault = Path("~/.cache"), str(error)
    if fault:
        faults_of_cache.append((place, fault))
        message = f"compiled code cannot be kept in {place}: {fault}; it is compiled anew for this command"
        from fwclass.temporary import temporary_directory  # loads much that most commands do not need

        place = _fresh.enter_context(temporary_directory("kernels"))
        atexit.register(_remove, os.getpid())
        sys.stderr.write(f"fwclass: {message}\n")
    _set(CACHE, str(place))
    return place


def _not_private(place: Path) -> str:
    """Make `place`, for this user alone; why what is there cannot be trusted, "" if it can."""
    try:
        for directory in (place.parent, place):
            directory.mkdir(mode=0o700, parents=directory == place.parent, exist_ok=True)
        link, above, facts = place.parent.lstat(), place.parent.stat(), place.lstat()
    except OSError as fault:
        return fault.strerror or type(fault).__name__
    if not stat.S_ISDIR(facts.st_mode):
        return "it is a link"
    if facts.st_uid != os.geteuid():
        return "it belongs to another user"
    if not {link.st_uid, above.st_uid} <= {os.geteuid(), 0}:
        return "the directory above it belongs to another user"
    if facts.st_mode & 0o022 or (above.st_mode & 0o022 and not above.st_mode & stat.S_ISVTX):
        return "other users may write there"
    return "" if os.access(place, os.W_OK | os.X_OK) else "it cannot be written to"


def _remove(maker: int) -> None:
    if os.getpid() == maker:
        _fresh.close()
        faults_of_cache.clear()


@contextmanager
def away_from(*names: str) -> Iterator[None]:
    """Elsewhere than in the current directory, where that holds one of the files `names`, which a library would read
    there and nowhere else."""
    if not any(map(os.path.lexists, names)):
        yield
        return
    back = os.open(".", os.O_RDONLY)
    os.chdir("/")
    try:
        yield
    finally:
        os.fchdir(back)
        os.close(back)


def _isolated() -> bool:
    return os.environ.items() >= CHILDREN.items()


@contextmanager
def without(*names: str) -> Iterator[None]:
    """Modules `names` that are not loaded cannot be, as if they were not installed; only where `isolate` was called,
    here or by the process that started this one: a program that imports fwclass keeps all that its libraries can do."""
    hidden = [n for n in names if n not in sys.modules] if _isolated() else []
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]  # None: Python's word for it
    try:
        yield
    finally:
        for name in hidden:
            sys.modules.pop(name, None)


@contextmanager
def later(*names: str) -> Iterator[None]:
    """Within the block, stand-ins for modules `names` that are installed and not loaded yet; where `isolate` was
    called, as `without`."""
    absent = [n for n in names if n not in sys.modules] if _isolated() else []
    standing = {name: module for name in absent if (module := _stand_in(name)) is not None}
    sys.modules.update(standing)
    try:
        yield
    finally:
        for name, module in standing.items():
            if sys.modules.get(name) is module:
                del sys.modules[name]


def _stand_in(name: str) -> Any:
    """A module that is loaded when something of it is used, and tells its version without; None where `name` is not
    installed."""
    from importlib import metadata

    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
    module: Any = LazyModule(name)
    module.__version__ = version
    return module


class _Guard:
    """Finder of `sys.meta_path` that imports the libraries of `CONFIGURATIONS` so that they do not see those files,
    those of `UNUSED` without what that names, those of `LATER` before it; SciPy without `PARTS_OF_NUMPY`."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if not any(name in table for table in (CONFIGURATIONS, UNUSED, LATER, {"scipy"})):
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            setattr(spec.loader, "exec_module", _guard(name, spec.loader.exec_module))  # noqa: B010 - for this one
        return spec


def _guard(name: str, execute: Callable[[ModuleType], None]) -> Callable[[ModuleType], None]:
    def exec_module(module: ModuleType) -> None:
        if name == "numba":
            kernel_cache()
        files, unused, after = (table.get(name, "").split() for table in (CONFIGURATIONS, UNUSED, LATER))
        with away_from(*files), without(*unused), later(*after):
            execute(module)
        if name == "numba":
            _settle_numba()
        if name == "scipy" and _isolated():
            _settle_numpy()

    return exec_module


def _settle_numpy() -> None:
    """The parts `PARTS_OF_NUMPY` are loaded when something of them is used."""
    for part in PARTS_OF_NUMPY:
        vars(sys.modules["numpy"]).setdefault(part, LazyModule(f"numpy.{part}"))


def _settle_numba() -> None:
    """Compiled code goes to `kernel_cache`, also where numba was there first; its file is not looked for again."""
    config: Any = sys.modules["numba.core.config"]
    config.CACHE_DIR, config._config_fname = str(kernel_cache()), os.devnull


def guard() -> None:
    """Watch over imports of the libraries that read files of the current directory; called by ``import fwclass``."""
    if not any(isinstance(finder, _Guard) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Guard())
    if "numba.core.config" in sys.modules:
        _settle_numba()
