"""The current directory may be a stranger's: nothing there is imported or read as a library's configuration."""

from __future__ import annotations

import contextlib
import io
import json
import os
import stat
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from runmaker import delivered
from schedulemaker import NOWHERE, strip

from fwclass import isolation
from fwclass.errors import ConfigError
from fwclass.formats.gdal import offline

ROOT = Path(__file__).parents[2]
ENTRY = "from fwclass.cli import main\n\nif __name__ == '__main__':\n    main()\n"
"""As pip writes the command: a script, beside which Python looks for modules, and not in the current directory."""

OTHERS = {
    "PIL",
    "affine",
    "attr",
    "bokeh",
    "boto3",
    "certifi",
    "click",
    "cligj",
    "cloudpickle",
    "conf",
    "contourpy",
    "cronsim",
    "cycler",
    "dask",
    "dateutil",
    "distributed",
    "donfig",
    "evil_backend",
    "fontTools",
    "fsspec",
    "fwclass",
    "google_crc32c",
    "jinja2",
    "kiwisolver",
    "laspy",
    "laszip",
    "lazrs",
    "llvmlite",
    "locket",
    "markdown_it",
    "markupsafe",
    "matplotlib",
    "mdurl",
    "mpl_toolkits",
    "msgpack",
    "numba",
    "numcodecs",
    "numpy",
    "obstore",
    "packaging",
    "pandas",
    "psutil",
    "pyarrow",
    "pydantic",
    "pydantic_core",
    "pygments",
    "pyogrio",
    "pyparsing",
    "pyproj",
    "rasterio",
    "rich",
    "scipy",
    "shapely",
    "sitecustomize",
    "sklearn",
    "sortedcontainers",
    "tblib",
    "threadpoolctl",
    "toolz",
    "tornado",
    "typing_extensions",
    "tzdata",
    "urllib3",
    "usercustomize",
    "workflows",
    "xyzservices",
    "yaml",
    "zarr",
    "zict",
}

FILES = {
    ".numba_config.yaml": "cache_dir: ./kernels\ndisable_jit: 1\n",
    "matplotlibrc": "backend: module://evil_backend\nfont.size: 40\n",
    **dict.fromkeys(("gdalrc", ".gdalrc", "proj.ini"), "[general]\nnetwork = on\n[configoptions]\nCPL_DEBUG=ON\n"),
    **dict.fromkeys(("NZTM2000", "MapML_CBMTILE", "MapML_APSTILE", "LINZAntarticaMapTileGrid"), "{"),
    **dict.fromkeys(("proj.db", "epsg", "gcs.csv", "header.dxf", "gdalvrt.xsd", "gt_datum.csv", "conus"), "no"),
    **dict.fromkeys(("dask.yaml", "distributed.yaml", "zarr.yaml", "bokeh.yaml"), "temporary-directory: ./here\n"),
    **dict.fromkeys((".env", ".netrc", ".pdbrc", "pyvenv.cfg", "setup.cfg", "pip.conf"), "home = ./here\n"),
}

CONFIG = """
survey:
  name: small
  directory: {data}
  sources: ["strips/*.las"]
  reference: {{kind: source}}
  crs: "EPSG:25832"
  features: [zc, height_range_c100]
  classes: [{{name: a, code: 2, codes: [2]}}, {{name: b, code: 6, codes: [6]}}]
areas: {{train: [[0, 0, 5, 10]], gap: 0.5}}
tile: {{size: 5.0}}
train: {{trees: 5}}
schedule: {{look: 0.2}}
plausibility: {{accept: true}}  # made-up places lie nowhere in a UTM zone
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small survey, the command, and a stranger's directory ``x``; who imports from there leaves the file ``ran``."""
    root = tmp_path_factory.mktemp("directory")
    (root / "data" / "strips").mkdir(parents=True)
    strip(root / "data" / "strips" / "a.las")
    (root / "c.yaml").write_text(CONFIG.format(data=root / "data"))
    (root / "bin").mkdir()
    (root / "bin" / "fwclass").write_text(ENTRY)
    (root / "x").mkdir()
    for name in sys.stdlib_module_names | OTHERS:
        (root / "x" / f"{name}.py").write_text(f"open({str(root / 'ran')!r}, 'a').write({name!r} + chr(10))\n")
    for name, text in FILES.items():
        (root / "x" / name).write_text(text)
    return root


def start(place: Path, *words: object, module: bool = False, timeout: float = 300) -> subprocess.CompletedProcess[str]:
    """The command in the stranger's directory, by its script or as a module."""
    how = ["-P", "-m", "fwclass"] if module else [str(place / "bin" / "fwclass")]
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    return subprocess.run(
        [sys.executable, *how, *map(str, words)],
        cwd=place / "x",
        env=env,
        capture_output=True,
        text=True,
        timeout=timeout,
    )


def untouched(place: Path) -> None:
    ran = place / "ran"
    assert not ran.exists(), f"modules of the current directory were imported: {sorted(set(ran.read_text().split()))}"
    there = {p.name for p in (place / "x").iterdir()}
    assert there == {f"{name}.py" for name in sys.stdlib_module_names | OTHERS} | set(FILES)


def clean(place: Path) -> dict[str, str]:
    """What the run delivers from a directory of its own, without workers."""
    from commandline import fwclass

    home = place / "clean"
    if not home.exists():
        ended = fwclass("run", place / "c.yaml", "--out", home, "--workers", 0, cwd=place / "data")
        assert ended.returncode == 0, ended.stderr
    return delivered(home)


@pytest.mark.slow
def test_commands_in_a_strangers_directory_run_nothing_of_it(place: Path) -> None:
    source = place / "data" / "strips" / "a.las"
    for words in (("info", source), ("run", place / "c.yaml", "--out", place / "r1", "--workers", 1)):
        ended = start(place, *words)
        assert ended.returncode == 0, ended.stderr
        untouched(place)
    assert delivered(place / "r1") == clean(place)


def test_a_scheduled_run_in_a_strangers_directory_runs_nothing_of_it(place: Path) -> None:
    words = ("schedule", place / "c.yaml", "--every", "1h", "--once", "--workers", 0, "--out", place / "none")
    ended = start(place, *words, "--set", NOWHERE)
    assert ended.returncode == 2 and "no training area" in ended.stderr, ended.stderr
    untouched(place)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("module", [False, True])
def test_a_run_is_the_same_in_a_strangers_directory(place: Path, workers: int, module: bool) -> None:
    for command in (("run",), ("schedule", "--every", "1h", "--once")):
        home = place / f"{command[0]}-{workers}-{module}"
        ended = start(place, *command, place / "c.yaml", "--out", home, "--workers", workers, module=module)
        assert ended.returncode == 0, ended.stderr
        untouched(place)
        assert delivered(home) == clean(place)


@pytest.mark.slow
def test_every_command_in_a_strangers_directory(place: Path) -> None:
    clean(place)
    source, home = place / "data" / "strips" / "a.las", place / "clean"
    polygons = place / "p.geojson"
    polygons.write_text(
        json.dumps({"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [0, 0]}})
    )
    for words in (
        ("info", source, polygons),
        ("ground", source, place / "g.laz", "--dtm", place / "dtm.tif"),
        ("normalize", source, place / "n.laz", "--accept-implausible"),
        ("features", source, place / "f.parquet"),
        ("classify", source, place / "k.laz", "--model", home / "model"),
        ("assess", source, place / "g.laz", "--ground"),
        ("plan", place / "c.yaml", "--out", place / "p"),
        ("status", home),
        ("status", home, "--verify"),
        ("history", home),
        ("seams", home),
        ("demo", "--help"),
    ):
        ended = start(place, *words)
        assert ended.returncode == 0, (words, ended.stderr)
        untouched(place)


def test_pipes_named_as_what_libraries_look_for_keep_nobody_waiting(tmp_path: Path) -> None:
    """GDAL looks for its grids of tiles before the first cloud-optimised file, PROJ for its own at a GeoPackage."""
    (tmp_path / "x").mkdir()
    for name in FILES:
        os.mkfifo(tmp_path / "x" / name)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "fwclass").write_text(ENTRY)
    source = strip(tmp_path / "a.las")
    with offline() as gdal:
        shape, name = np.array([struct.pack("<BIdd", 1, 1, 0, 0)], object), str(tmp_path / "p.gpkg")
        gdal.raw.write(name, shape, [], [], driver="GPKG", geometry_type="Point", crs="EPSG:25832")
    ended = start(tmp_path, "info", "../p.gpkg", timeout=60)
    assert ended.returncode == 0, ended.stderr
    ended = start(tmp_path, "ground", source, tmp_path / "g.laz", "--dtm", tmp_path / "d.tif", timeout=60)
    assert ended.returncode == 0 and (tmp_path / "d.tif").exists(), ended.stderr


SEES = """
import json, os, sys
sys.path[:] = [p for p in sys.path if os.path.isabs(p)]
from fwclass.publish import figures
import fwclass.single_file.ground.steps
import matplotlib, numba
numba.core.config.reload_config()
found = numba.core.config
print(json.dumps([matplotlib.rcParams["font.size"], found.CACHE_DIR, found.DISABLE_JIT, os.getcwd()]))
"""


def seen(place: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    script = place / "bin" / "sees.py"
    script.write_text(SEES)
    env = {k: v for k, v in os.environ.items() if k != isolation.CACHE} | environment
    return subprocess.run(
        [sys.executable, script], cwd=place / "x", env=env, capture_output=True, text=True, timeout=60
    )


def test_libraries_read_no_configuration_from_the_current_directory(place: Path) -> None:
    """And compiled code is kept where nobody else may write."""
    home = place / "cache"
    size, cache, disabled, directory = json.loads(seen(place, XDG_CACHE_HOME=str(home)).stdout)
    assert (size, disabled, directory) == (10.0, 0, str(place / "x"))
    assert Path(cache) == home / "fwclass" / "kernels" and stat.S_IMODE(Path(cache).stat().st_mode) == 0o700
    told = json.loads(seen(place, NUMBA_CACHE_DIR=str(place / "own")).stdout)
    assert told[1] == str(place / "own")


def test_whatever_starts_workers_or_runs_for_us_keeps_the_directory_off_the_import_path() -> None:
    """`deploy/` and `conf/site/`."""
    starts = ("dask, worker", "job-script-prologue", "ExecStart", "0 3 * * *  fwclass", "run {CONF}")
    texts = {p.name: p.read_text() for d in ("deploy", "conf/site") for p in (ROOT / d).rglob("*.*") if p.is_file()}
    texts["cron"] = (ROOT / "deploy" / "cron" / "fwclass").read_text()
    starting = {name for name, text in texts.items() if any(word in text for word in starts)}
    assert len(starting) == 7 and all("PYTHONSAFEPATH" in texts[name] for name in starting), starting


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(isolation.CACHE, "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "fwclass" / "kernels"


def refused(home: Path) -> str:
    """What is told where `home` is not taken for compiled code."""
    with contextlib.redirect_stderr(io.StringIO()) as told:
        place = isolation.kernel_cache()
    try:
        assert place != home and stat.S_IMODE(place.stat().st_mode) == 0o700 and place.stat().st_uid == os.geteuid()
        assert os.environ[isolation.CACHE] == str(place)
    finally:
        isolation._remove(os.getpid())
    return told.getvalue()


def test_compiled_code_is_not_taken_from_where_others_may_write(home: Path) -> None:
    home.mkdir(parents=True)
    home.chmod(0o770)
    assert "other users may write there" in refused(home)


def test_compiled_code_is_not_taken_through_a_link(home: Path, tmp_path: Path) -> None:
    (tmp_path / "theirs").mkdir()
    home.parent.mkdir(parents=True)
    home.symlink_to(tmp_path / "theirs")
    assert "it is a link" in refused(home)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a directory away")
def test_compiled_code_is_not_taken_from_another_user(home: Path) -> None:
    home.mkdir(parents=True, mode=0o700)
    os.chown(home, 65534, 65534)
    assert "it belongs to another user" in refused(home)


def test_nor_from_below_a_directory_that_others_may_change(home: Path) -> None:
    """Who may write above it can put another directory in its place, after it was looked at."""
    home.mkdir(parents=True, mode=0o700)
    home.parent.chmod(0o770)
    assert "other users may write there" in refused(home)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a directory away")
def test_nor_from_below_a_directory_of_another_user(home: Path) -> None:
    home.mkdir(parents=True, mode=0o700)
    os.chown(home.parent, 65534, 65534)
    assert "the directory above it belongs to another user" in refused(home)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a link away")
def test_nor_through_a_link_above_it_that_another_user_made(home: Path, tmp_path: Path) -> None:
    """In a directory that several may write to it leads to what this user has unpacked, say."""
    (tmp_path / "unpacked" / home.name).mkdir(parents=True, mode=0o700)
    home.parent.parent.mkdir(parents=True, exist_ok=True)
    home.parent.symlink_to(tmp_path / "unpacked")
    assert isolation._not_private(home) == ""
    os.lchown(home.parent, 65534, 65534)
    assert "the directory above it belongs to another user" in refused(home)


def test_a_file_where_the_cache_should_be_is_told(home: Path, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("")
    assert "compiled code cannot be kept in" in refused(home)


def test_a_cache_that_depends_on_the_current_directory_is_refused(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(isolation.CACHE, "./kernels")
    with pytest.raises(ConfigError, match="depends on the current directory"):
        isolation.kernel_cache()


def test_a_users_own_command_gets_the_users_own_environment(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(isolation, "_before", {})
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    monkeypatch.setenv("PROJ_NETWORK", "ON")
    monkeypatch.setenv("PYTHONPATH", f":{home}:./lib")
    monkeypatch.setattr(sys, "path", ["", "relative", *sys.path])
    before = dict(os.environ)
    isolation.isolate()
    isolation.isolate()
    assert os.environ["PYTHONSAFEPATH"] == "1" and os.environ["PROJ_NETWORK"] == "OFF"
    assert os.environ["PYTHONPATH"] == str(home) and all(map(os.path.isabs, sys.path))
    assert isolation.outer_environment() == before


def test_numba_is_imported_where_its_cache_is_fixed() -> None:
    """Whoever imports it first, the import hook of the package is there already."""
    assert any(isinstance(finder, isolation._Guard) for finder in sys.meta_path)
    import numba

    assert numba.core.config._config_fname == os.devnull
    assert Path(numba.core.config.CACHE_DIR).is_absolute()


def test_relative_paths_mean_the_strangers_directory(place: Path) -> None:
    """GDAL is called from elsewhere there, with paths that still lead here."""
    ended = start(place, "plan", place / "c.yaml", "--out", "../planned")
    assert ended.returncode == 0, ended.stderr
    assert (place / "planned" / "plan" / "tiles.gpkg").is_file()
    untouched(place)
