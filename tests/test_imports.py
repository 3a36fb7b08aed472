"""The import contracts of pyproject.toml, attacked: each breach below is planted on a copy, and each must be named."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

from fwclass.isolation import CHILDREN

ROOT = Path(__file__).parents[1]
KERNELS = ("fwclass/features/sums.py", "fwclass/ground/methods/undercut.py", "fwclass/train/bag.py")
"""Files with compiled functions that the parameters of their room are planted in, one way and another."""
PARAMETERS = ("from fwclass.features.params import NORMAL", "import fwclass.params", "import fwclass.train.params")
FORBIDDEN = [  # file, what it shall not import
    ("fwclass/survey/files.py", "dask"),
    ("fwclass/report/write.py", "distributed"),
    ("fwclass/operate/history.py", "dask"),
    ("fwclass/features/sums.py", "pydantic"),
    ("fwclass/features/sums.py", "yaml"),
    ("fwclass/features/sums.py", "click"),
    ("fwclass/run/progress.py", "zarr"),
    ("fwclass/read/las.py", "obstore"),
    ("fwclass/assess/confusion.py", "subprocess"),
    ("fwclass/run/part.py", "fwclass.operate.schedule.loop"),
    ("fwclass/read/las.py", "fwclass.decompose.stage"),
    ("fwclass/run/tasks.py", "fwclass.run.runner"),
    ("fwclass/store/atomic.py", "fwclass.store.run_store"),
    ("fwclass/survey/files.py", "fwclass.graph.stage"),
    ("fwclass/graph/ground.py", "fwclass.report.ground"),
    ("fwclass/report/drift.py", "fwclass.report.write"),
    ("fwclass/walk/steps.py", "fwclass.walk.own_workflow"),
    ("fwclass/novelty/__init__.py", "dask"),
]
CIRCLES = [  # package, a module of it, what of it shall not be imported there
    ("publish", "palette", "report"),
    ("decompose", "params", "fitting"),
    ("ground.methods", "seeds", "ptd"),
    ("features", "params", "stage"),
    ("street", "frames", "prescription"),
    ("delivery", "opened", "viewed"),
    ("formats", "las_header", "copc"),
]


def test_every_planted_breach_is_caught(tmp_path: Path) -> None:
    for package in ("fwclass", "workflows"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    circles = [(f"fwclass/{p.replace('.', '/')}/{one}.py", f"fwclass.{p}.{other}") for p, one, other in CIRCLES]
    for name, imported in FORBIDDEN + circles:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"{path.read_text() if path.exists() else ''}\nimport {imported}\n")
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "COLUMNS": "400"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    said = re.sub(r"\s+", " ", done.stdout)
    assert done.returncode == 1, done.stdout + done.stderr
    for name, imported in FORBIDDEN:
        module = name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        assert f"{module} -> {imported} " in said, f"{module} -> {imported} passes\n{done.stdout}"
    for package, *_ in CIRCLES:
        assert f"No cycles are allowed in fwclass.{package}." in said, f"a circle in {package} passes\n{done.stdout}"
    assert re.search(r"not listed as layers:.{0,80}fwclass[.]novelty", said), "a room that no contract lists passes"


def test_no_room_is_above_a_tenth_of_the_program() -> None:
    lines: dict[str, int] = {}
    for path in (ROOT / "fwclass").rglob("*.py"):
        room = path.relative_to(ROOT / "fwclass").parts[0]
        lines[room] = lines.get(room, 0) + len(path.read_text().splitlines())
    large = {room: count for room, count in lines.items() if count > sum(lines.values()) / 10}
    assert not large, f"split them by subject: {large} of {sum(lines.values())} lines"


BROUGHT = {
    "laszip": "laspy",
    "lazrs": "laspy",
    "llvmlite": "numba",
    "lz4": "rosbags",
    "numcodecs": "zarr",
    "sklearn": "scikit-learn",
    "threadpoolctl": "scikit-learn",
    "tornado": "distributed",
    "yaml": "pyyaml",
}
"""Modules that have another name than the library that brings them."""


def test_every_library_that_the_program_imports_is_one_that_it_asks_for() -> None:
    """What the developers' environment has besides, as pandas, a user's has not."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = [words for extra, words in project["optional-dependencies"].items() if extra != "dev"]
    asked = {re.split(r"[^\w-]", words)[0] for some in (project["dependencies"], *optional) for words in some}
    paths = [path for package in ("fwclass", "workflows") for path in (ROOT / package).rglob("*.py")]
    known = {*sys.stdlib_module_names, "fwclass", "classification"}  # a workflow, by its neighbours
    foreign = {name.split(".")[0] for path in paths for name in imports(ast.parse(path.read_text()))} - known
    assert {"numpy", "lz4"} <= foreign
    assert not {name for name in foreign if BROUGHT.get(name, name) not in asked}


def test_parts_of_scipy_are_loaded_when_they_are_used() -> None:
    """A quarter of a second of every command, where one module of the graph loads them for all."""
    line = (
        "import sys, fwclass.survey.gather, fwclass.graph.stages; print(*[n for n in sys.modules if n[:6] == 'scipy.'])"
    )
    ended = subprocess.run([sys.executable, "-c", line], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[1] for name in ended.stdout.split()}
    assert not loaded & {"ndimage", "sparse", "spatial", "special", "linalg", "optimize", "interpolate"}, loaded


def test_voids_are_found_without_what_scipy_has_for_graphs() -> None:
    """A fifth of a CPU-second of every run, and of each of its workers, that looked for them."""
    child = """
import numpy, sys
from fwclass.grid import Window
from fwclass.quality.voids import CellGroups
window = Window(1.0, 0, 0, 5, 5)
groups = CellGroups(window)
groups.add(window, numpy.eye(5, dtype=bool))
assert len(groups.pieces()) == 5
sys.exit("scipy.sparse" in sys.modules)
"""
    subprocess.run([sys.executable, "-c", child], check=True)


def test_looking_at_a_file_does_not_load_what_reckons_with_arrow() -> None:
    child = "import fwclass.read.info, sys; sys.exit('pyarrow.compute' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", child], check=False).returncode == 0


def test_a_command_reads_points_without_a_way_to_the_network_and_a_program_keeps_it() -> None:
    """`requests` takes as long to load as all else of laspy; what another stage or program imports, it gets."""
    own = "import fwclass, laspy.copc, requests, sys; sys.exit(laspy.copc.requests is not requests)"
    command = (
        "from fwclass.isolation import isolate; isolate(); import laspy.copc, sys; "
        "assert 'requests' not in sys.modules and laspy.copc.requests is None; import requests; requests.get"
    )
    child = "import fwclass, laspy.copc, sys; sys.exit('requests' in sys.modules)"
    environment = {n: v for n, v in os.environ.items() if n not in CHILDREN}
    subprocess.run([sys.executable, "-c", own], env=environment, check=True)
    subprocess.run([sys.executable, "-c", command], env=environment, check=True)
    subprocess.run([sys.executable, "-c", child], env=environment | CHILDREN, check=True)


def test_rasters_and_polygons_are_written_without_data_frames_and_buckets_which_who_asks_for_them_finds() -> None:
    child = """
import fwclass, io, pyogrio, rasterio.session, sys
late = {"geopandas", "pandas", "boto3"}
assert not late & {*sys.modules}
assert rasterio.session.boto3.Session and late & {*sys.modules} == {"boto3"}
import geopandas, pandas
frame = geopandas.GeoDataFrame({"a": [1]}, geometry=geopandas.points_from_xy([1], [2]))
frame.to_file(file := io.BytesIO(), driver="GeoJSON")
file.seek(0)
assert geopandas.read_file(file).geometry[0].y == 2 and pandas.DataFrame is not None
"""
    subprocess.run([sys.executable, "-c", child], env=os.environ | CHILDREN, check=True)
    own = "import fwclass, pyogrio, sys; sys.exit('geopandas' not in sys.modules)"
    environment = {n: v for n, v in os.environ.items() if n not in CHILDREN}
    subprocess.run([sys.executable, "-c", own], env=environment, check=True)


def test_a_command_does_not_load_what_packs_functions_to_read_parquet() -> None:
    child = "import fwclass, pyarrow, sys; sys.exit('cloudpickle' in sys.modules)"
    subprocess.run([sys.executable, "-c", child], env=os.environ | CHILDREN, check=True)


def test_scipy_does_not_load_parts_of_numpy_that_nothing_uses_and_they_are_there_for_who_does() -> None:
    child = (
        "import fwclass, numpy, scipy.ndimage, sys; assert not {'numpy.f2py', 'numpy.testing'} & set(sys.modules); "
        "numpy.testing.assert_equal(1, 1); import numpy.f2py, types; assert isinstance(numpy.f2py, types.ModuleType); "
        "from numpy.testing import assert_allclose; from numpy import testing; testing.assert_array_equal([1], [1])"
    )
    subprocess.run([sys.executable, "-c", child], env=os.environ | CHILDREN, check=True)


def test_a_package_that_calls_itself_a_plugin_of_pydantic_is_not_loaded(tmp_path: Path) -> None:
    """To ask every package of the environment takes as long as to build the parameters."""
    (tmp_path / "plugged.py").write_text("import sys; sys.exit('loaded')")
    about = tmp_path / "plugged-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: plugged\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[pydantic]\nplugged = plugged:plugin\n")
    environment = {n: v for n, v in os.environ.items() if n not in CHILDREN}
    environment["PYTHONPATH"] = os.pathsep.join((str(tmp_path), str(ROOT)))
    line = [sys.executable, "-P", "-m", "fwclass", "features", "--list"]
    ended = subprocess.run(line, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


FLOOR = (
    "classes",
    "columns",
    "errors",
    "grid",
    "hashing",
    "kernel",
    "model",
    "neighbours",
    "schema",
    "sorting",
    "stage",
    "units",
)
"""Modules of the ground floor, below `fwclass`."""


def imports(tree: ast.Module) -> set[str]:
    """Everything that a file imports, wherever in it, but for types alone."""
    found = set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def kernel_breaches(root: Path) -> tuple[int, list[str]]:
    """How many files below `root` have compiled functions, and what these import beyond numpy, scipy, the ground floor
    and their own room: a format, a file, a store, another room, or parameters, which a kernel gets as numbers."""
    checked, wrong = 0, []
    standard = {
        "__future__",
        "collections",
        "dataclasses",
        "functools",
        "itertools",
        "math",
        "numpy",
        "scipy",
        "typing",
        "weakref",
    }
    for path in sorted((root / "fwclass").rglob("*.py")):
        tree = ast.parse(path.read_text())
        decorators = [ast.unparse(d) for f in tree.body if isinstance(f, ast.FunctionDef) for d in f.decorator_list]
        if not any("kernel" in d for d in decorators):
            continue
        checked += 1
        room = path.relative_to(root / "fwclass").parts[0]
        for name in imports(tree):
            top, *rest = name.split(".")
            allowed = rest and rest[0] in (*FLOOR, room) if top == "fwclass" else top in standard
            if not allowed or name.endswith("params"):
                wrong.append(f"{path.relative_to(root)} imports {name}")
    return checked, wrong


def test_files_with_kernels_import_arithmetic_alone(tmp_path: Path) -> None:
    checked, wrong = kernel_breaches(ROOT)
    assert checked > 60
    assert not wrong, "\n".join(wrong)
    for name, line in zip(KERNELS, PARAMETERS, strict=True):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text(f"{(ROOT / name).read_text()}\n{line}\n")
    assert [text.split()[0] for text in kernel_breaches(tmp_path)[1]] == sorted(KERNELS)
