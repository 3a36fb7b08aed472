"""The commands as a user gives them, over sound files: what is damaged, what lies beside it, and the words."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import lasmaker
import modelmaker
import numpy as np
import run_cases
import seeds
import street_cases
from cases import SURVEY, Case, Command, both, given, patch
from mutate import Field
from seeds import Seed

RADIANS = np.pi / 180
STEEP = 1
"""A seed whose beams are steep enough to come from right above."""


def _clouds(folder: Path) -> list[Seed]:
    """Points of all formats, and patches."""
    patches = [patch(folder / "p1", point_format=1), patch(folder / "p6"), patch(folder / "pz", "a.laz")]
    return [
        *patches,
        *seeds.las_seeds(folder / "las"),
        *seeds.laz_seeds(folder / "laz"),
        *seeds.copc_seeds(folder / "copc"),
    ]


def _info(folder: Path) -> list[Case]:
    made = [
        *_clouds(folder),
        *seeds.pls_seeds(folder / "pls"),
        *seeds.text_seeds(folder),
        *seeds.polygon_seeds(folder / "polygons"),
        *seeds.geoparquet_seeds(folder / "geoparquet"),
    ]
    made = [replace(s, name=f"{s.name}.{Path(s.main).suffix[1:]}") for s in made]
    return given(made, "info", "{}") + given(made, "info", "{}", "--json", mark="-json")


def _waved(folder: Path) -> list[Seed]:
    wanted = ("f4", "f5", "f9", "f10")
    return [s for s in seeds.las_seeds(folder / "las") if s.name.startswith(wanted)] + [
        *seeds.pls_seeds(folder / "pls"),
        *seeds.raw_seeds(folder / "raw"),
    ]


def _waveforms(folder: Path) -> list[Case]:
    return given(_waved(folder), "info", "--waveforms", "{}", "--out", "p.png")


def _ground(folder: Path) -> list[Case]:
    made, texts = _clouds(folder), seeds.text_seeds(folder)
    cases = []
    for k, seed in enumerate(made):
        method = ("smrf", "csf", "ptd", "slope")[k % 4]
        cases += given([seed], "ground", "{}", "o.laz", "--method", method, "--dtm", "d.tif")
    return cases + given(texts, "ground", "{}", "o.xyz", "--method", "smrf")


def _features(folder: Path) -> list[Case]:
    names = "zc,height_range_c100,planarity_r100,density_c100,echo_ratio_r100,planarity_k20"
    words = ("features", "{}", "o.parquet", "--features", names, "--skip-missing")
    return given(
        [
            *_clouds(folder),
            *seeds.pls_seeds(folder / "pls"),
            *seeds.raw_seeds(folder / "raw"),
            *seeds.text_seeds(folder),
        ],
        *words,
    )


def _model(folder: Path) -> dict[str, Seed]:
    """A model of every kind over two features that any file has."""
    from fwclass.store.models import save_model

    made = {}
    for kind, model in modelmaker.models().items():
        card = {**model.card, "features": ["height_range_c100", "planarity_r100"]}
        save_model(folder / kind / "m", replace(model, card=card))
        found = seeds._taken(folder / kind, kind, "m", (), ("m/card.json",))
        made[kind] = replace(
            found,
            fields=tuple(
                Field(n, at, w)
                for n in found.files
                if n.endswith(".npy")
                for at in (*range(0, 12, 2), *range(128, 152, 4))
                for w in (2, 4)
            ),
        )
    return made


def _classify(folder: Path) -> list[Case]:
    models, clouds = _model(folder / "models"), _clouds(folder)
    words = ("classify", "{}", "o.laz", "--model", "m")
    cases = given(clouds, *words, fixed=models["forest"].files)
    cloud = clouds[1]
    words = ("classify", cloud.main, "o.laz", "--model", "m")
    return cases + given(list(models.values()), *words, fixed=cloud.files)


def _normalize(folder: Path) -> list[Case]:
    heights = ("tin", "nearest", "raster")
    clouds = _clouds(folder)
    return [
        case
        for k, seed in enumerate(clouds)
        for case in given([seed], "normalize", "{}", "o.laz", "--height", heights[k % 3], "--method", "slope")
    ]


def _assess(folder: Path) -> list[Case]:
    clouds = _clouds(folder)
    texts = [s for s in seeds.text_seeds(folder) if s.name != "t3"]
    other = replace(patch(folder / "other", seed=1), name="other")  # no point has its like: the nearest is looked for
    pairs = [both(clouds[1], other), *(both(s, s) for s in (*clouds, *texts))]
    return [
        Case(p, ("assess", p.main, "b" + p.main[1:], *more))
        for p, more in zip(pairs, (("--ground",), ("--map", "a=2;b=5,1", "--json")) * len(pairs), strict=False)
    ]


def trajectories() -> list[Seed]:
    """Flights over the places and times of `lasmaker.survey`, so that nothing is refused before it is read."""
    from pyproj import Transformer

    times = 999.5 + 0.05 * np.arange(20)
    x, y, z = 499990 + times * 0.01, np.full(20, 5400002.0), np.full(20, 1200.0)
    csv = "time,x,y,z\n" + "".join(
        f"{t:.3f},{a:.2f},{b:.2f},{c:.2f}\n" for t, a, b, c in zip(times, x, y, z, strict=True)
    )
    lon, lat = Transformer.from_crs(32633, 4326, always_xy=True).transform(x, y)
    degrees = "# flight\ngps_time;latitude;longitude;height\n" + "".join(
        f"{t:.3f};{b:.9f};{a:.9f};1200\n" for t, a, b in zip(times, lon, lat, strict=True)
    )
    rows = np.zeros((20, 17))
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = times, lat * RADIANS, lon * RADIANS, z
    fields = tuple(Field("t.out", 8 * k, 8) for k in range(5)) + tuple(Field("t.out", 136 * k, 8) for k in range(6))
    texts = [Seed(n, "t.csv", {"t.csv": t.encode()}, (), ("t.csv",)) for n, t in (("csv", csv), ("degrees", degrees))]
    return [*texts, Seed("sbet", "t.out", {"t.out": rows.tobytes()}, fields)]


def _decompose(folder: Path) -> list[Case]:
    waved = _waved(folder)
    plain = given(waved, "decompose", "{}", "o.laz", "--accept-implausible")
    own = folder / "flown"
    own.mkdir(parents=True)
    lasmaker.survey(own / "a.las", pulses=8, n_samples=40, where="internal", seed=STEEP)
    flown = seeds._taken(own, "flown", "a.las", seeds._las_numbers(own / "a.las"))
    return (
        plain
        + given(trajectories(), "decompose", flown.main, "o.laz", "--trajectory", "{}", fixed=flown.files)
        + given([flown], "decompose", "{}", "o.laz", "--trajectory", "t.csv", fixed=trajectories()[0].files)
    )


def _surveys(folder: Path) -> list[Seed]:
    """Sources of the small survey."""
    waved = folder / "w"
    waved.mkdir(parents=True)
    lasmaker.survey(waved / "a.las", pulses=60, n_samples=40, where="internal")
    return [patch(folder / "p6"), seeds._taken(waved, "waved", "a.las", seeds._las_numbers(waved / "a.las"))]


def _on_survey(*words: str, count: int = 2) -> Callable[[Path], list[Case]]:
    """A command on a configuration: its source files are damaged, and it is not."""
    return lambda folder: given(_surveys(folder)[:count], *words, fixed={"c.yaml": SURVEY.encode()})


def _plan(folder: Path) -> list[Case]:
    source = patch(folder / "p")
    words = ("plan", "c.yaml", "--out", "r")
    text = Seed("small", "c.yaml", {"c.yaml": SURVEY.encode()}, (), ("c.yaml",))
    shipped = [
        replace(s, main="c.yaml", files={"c.yaml": s.files["a.yaml"]}, texts=("c.yaml",))
        for s in seeds.conf_seeds(folder)
        if s.name.startswith("surveys/")
    ]
    sources = given([source], *words, fixed={"c.yaml": SURVEY.encode()})
    return given([text, *shipped], *words, fixed=source.files) + sources


def _labelled(folder: Path) -> list[Case]:
    """Polygons of every format, as reference and as what is delivered, and trajectories, in a run by a given model."""
    source, model = patch(folder / "p"), _model(folder / "models")["forest"]
    survey = SURVEY.replace("EPSG:32633", "EPSG:25832").replace("directory: .", "directory: .\n  model: m")
    survey = re.sub(
        "classes: .*",
        "classes: [{name: c0, code: 2, codes: [2]}, {name: c1, code: 3, codes: [6]}, {name: c2, code: 4, codes: [5]}]",
        survey,
    )
    words = ("run", "c.yaml", "--out", "r", "--workers", "0")
    shapes = seeds.polygon_seeds(folder / "polygons") + seeds.geoparquet_seeds(folder / "geoparquet")
    cases = []
    for seed in shapes:
        text = survey.replace("{kind: source}", f"{{kind: polygons, files: [{seed.main}], field: code}}")
        cases += given([seed], *words, fixed={"c.yaml": text.encode(), **source.files, **model.files}, mark="-labels")
        fixed = {"c.yaml": survey.encode(), **source.files, **model.files}
        cases += given([seed], *words, "--aoi", "{}", fixed=fixed, mark="-aoi")
    for seed in trajectories():
        text = survey.replace("  crs:", f"  trajectory: {{files: [{seed.main}]}}\n  crs:").replace("25832", "32633")
        cases += given([seed], *words, fixed={"c.yaml": text.encode(), **source.files, **model.files})
    return cases


def _shapes(folder: Path) -> list[Case]:
    """Water, breaklines and check points of a small survey."""
    source, words = patch(folder / "p"), ("run", "c.yaml", "--out", "r", "--workers", "0", "--workflow")
    survey = SURVEY.replace("EPSG:32633", "EPSG:25832")
    fixed = {"c.yaml": survey.encode(), **source.files}
    text = "x,y,z,class\n" + "".join(f"{500000 + k},{5400000 + k},{200 + 0.1 * k},2\n" for k in range(1, 10))
    points = Seed("points", "c.csv", {"c.csv": text.encode()}, (), ("c.csv",))
    corners = [[500000 + 8 * (k % 2), 5400001 + 2 * k, 200 + k] for k in range(4)]
    ring = [[500002 + 6 * a, 5400002 + 6 * b] for a, b in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))]
    return [
        *given(_drawn("LineString", corners, folder), *words, "ground", "--set", "breaklines.file={}", fixed=fixed),
        *given(_drawn("Polygon", [ring], folder), *words, "ground", "--set", "water.file={}", fixed=fixed),
        *given([points], *words, "quality", "--set", "quality.check_points.file={}", fixed=fixed),
    ]


def _drawn(kind: str, coordinates: list, folder: Path, system: int = 25832) -> list[Seed]:
    """The shape in every format; numbers of a Shapefile are damaged where they stand."""
    import geopandas
    import shapely

    frame = geopandas.GeoDataFrame(geometry=[shapely.geometry.shape({"type": kind, "coordinates": coordinates})])
    made = [_geojson(kind, coordinates, system)]
    for ending in ("shp", "gpkg"):
        own = folder / kind / ending
        own.mkdir(parents=True)
        frame.set_crs(system).to_file(own / f"b.{ending}")
        size = (own / f"b.{ending}").stat().st_size
        places = range(24, size - 4, 4) if ending == "shp" else ()
        made.append(seeds._taken(own, f"{kind}-{ending}", f"b.{ending}", [(f"b.{ending}", at, 8) for at in places]))
    return made


def _geojson(kind: str, coordinates: list, system: int = 25832) -> Seed:
    feature = {"type": "Feature", "properties": {}, "geometry": {"type": kind, "coordinates": coordinates}}
    named = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{system}"}}
    file = json.dumps({"type": "FeatureCollection", "crs": named, "features": [feature]})
    return Seed(kind, "b.geojson", {"b.geojson": file.encode()}, (), ("b.geojson",))


def _backscatter(folder: Path) -> list[Case]:
    some = [s for s in _waved(folder) if s.name not in ("short", "helios")]  # without echoes, without a system
    return given(some, "voxels", "{}", "--out", "r", "--workers", "0") + given(
        some, "profile", "{}", "--out", "r", "--workers", "0", mark="-profile"
    )


PLACES = [[500000 + 4 * a, 5400000 + 4 * b] for a, b in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))]


def _confirm(folder: Path) -> list[Case]:
    """Places in every format, and a sound one in a damaged run."""
    places = _drawn("Polygon", [PLACES], folder, 32633)
    (run,) = run_cases.collected("label", "confirm", "r", "b.geojson")(folder)[:1]
    whole = {n: d for n, d in {**run.fixed, **run.seed.files}.items() if n.startswith("r/")}
    sound = _geojson("Polygon", [PLACES], 32633).files
    return [
        *(replace(c, links=run_cases.LINKS) for c in given(places, "label", "confirm", "r", "{}", fixed=whole)),
        *run_cases.delivery("label", "confirm", "r", "b.geojson", beside=sound)(folder),
    ]


def _export(folder: Path) -> list[Case]:
    return given([_model(folder)["forest"]], "export", "{}", "o.onnx")


COMMANDS = {
    "info": Command(_info, 30),
    "init": Command(lambda folder: given(_clouds(folder), "init", "{}"), 10),
    "shapes": Command(_shapes, 0.5),
    "backscatter": Command(_backscatter, 0.5),
    "info-waveforms": Command(_waveforms, 2),
    "ground": Command(_ground, 12),
    "features": Command(_features, 12),
    "classify": Command(_classify, 10),
    "normalize": Command(_normalize, 8),
    "assess": Command(_assess, 12),
    "decompose": Command(_decompose, 10),
    "plan": Command(_plan, 5),
    "labels": Command(_labelled, 1),
    "export": Command(_export, 3),
    "status": Command(run_cases.documents("status", "r"), 3),
    "verify": Command(run_cases.documents("status", "c.yaml", "--out", "r", "--verify"), 1.5),
    "history": Command(run_cases.documents("history", "r"), 3),
    "seams": Command(run_cases.documents("seams", "r", "--share", "1"), 0.5),
    "rerun": Command(run_cases.documents("run", "c.yaml", "--out", "r", "--workers", "0"), 0.5),
    "stored-run": Command(
        run_cases.parts(
            "run", "c.yaml", "--out", "r", "--workers", "0", "--set", "train.trees=6", kinds=("run", "grouped")
        ),
        0.5,
    ),
    "stored-seams": Command(run_cases.parts("seams", "r", "--share", "1"), 0.5),
    "stored-verify": Command(run_cases.parts("status", "r", "--verify"), 1),
    "forged-run": Command(
        run_cases.forged("run", "c.yaml", "--out", "r", "--workers", "0", "--set", "train.trees=6"), 1
    ),
    "forged-status": Command(run_cases.forged("status", "c.yaml", "--out", "r"), 1),
    "forged-seams": Command(run_cases.forged("seams", "r", "--share", "1"), 0.5),
    "chunk-run": Command(
        run_cases.chunks("run", "c.yaml", "--out", "r", "--workers", "0", "--set", "train.trees=6"), 0.5
    ),
    "chunk-verify": Command(run_cases.chunks("status", "r", "--verify"), 0.5),
    "chunk-look": Command(run_cases.chunks("look", "r"), 0.5),
    "look": Command(run_cases.parts("look", "r", kinds=("waved", "grouped"), also="r/generations/"), 2),
    "view-export": Command(run_cases.delivery("view", "r", "--export", "d"), 1),
    "view-large": Command(run_cases.delivery("view", "r", "--export", "d", "--set", "view.whole=1000"), 1),
    "view-worklist": Command(run_cases.delivery("view", "r", "--worklist", "w.gpkg"), 1),
    "suggest": Command(run_cases.delivery("suggest", "r", "w.gpkg"), 1),
    "checkout": Command(run_cases.delivery("label", "checkout", "r", "d", "--least-sure", "2"), 1),
    "collect": Command(run_cases.collected("label", "collect", "d", "--run", "r", "--who", "me"), 2),
    "confirm": Command(_confirm, 1),
    "diff": Command(run_cases.delivery("diff", "r", "r"), 1),
    "street-stream": Command(street_cases.stream, 2),
    "street": Command(street_cases.recordings, 2),
    "run": Command(_on_survey("run", "c.yaml", "--out", "r", "--workers", "0"), 1),
    "train": Command(_on_survey("train", "c.yaml", "--model", "m", "--out", "r", "--workers", "0"), 1),
    "select": Command(
        _on_survey(
            "select",
            "c.yaml",
            "--method",
            "fscore",
            "--set",
            "select.block=2",
            "--set",
            "select.gap=0.5",
            "--out",
            "r",
            "--workers",
            "0",
            count=1,
        ),
        0.5,
    ),
}
"""By name, as ``--command`` takes it; `look` is what a notebook and the viewer do. `schedule` is left out (it starts
`run`), and `simulate`, `demo`, whose only input is a configuration, which `plan` reads."""


def _harm(folder: Path) -> list[Case]:
    return [Case(Seed("plain", "a.txt", {"a.txt": b"none"}), ("harm", "a.txt"))]


ALL = {**COMMANDS, "harm": Command(_harm)}

HOSTILE = {
    "vrt": b"<OGRVRTDataSource><OGRVRTLayer name='x'><SrcDataSource>/vsicurl/http://127.0.0.1:9/a</SrcDataSource>"
    b"</OGRVRTLayer></OGRVRTDataSource>",
    "wfs": b"<OGRWFSDataSource><URL>http://127.0.0.1:9/wfs</URL></OGRWFSDataSource>",
    "pipeline": b'{"type":"gdal_streamed_alg","command_line":"gdal vector pipeline ! read http://127.0.0.1:9/a"}',
    "empty": b"",
    "zeros": bytes(5000),
    "spaces": b" " * 5000,
    "text": b"lorem ipsum\n" * 50,
    "pickle": b"\x80\x04N.",
    "zip": b"PK\x03\x04" + bytes(100),
    "python": b"import os\n",
}
"""Content that no reader is for."""


@cache
def cases_of(command: str) -> dict[str, Case]:
    """By name."""
    with tempfile.TemporaryDirectory() as folder:
        return {c.seed.name: c for c in ALL[command].cases(Path(folder) / "made")}


@cache
def foreign() -> dict[str, bytes]:
    """A file of every kind, by name."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        some = [
            patch(folder / "las"),
            patch(folder / "laz", "a.laz"),
            *seeds.copc_seeds(folder / "copc"),
            *seeds.pls_seeds(folder / "pls")[:1],
            *seeds.text_seeds(folder)[:1],
            *trajectories()[::2],
            *seeds.polygon_seeds(folder / "polygons"),
            *seeds.geoparquet_seeds(folder / "gp")[:1],
        ]
        made = {Path(s.main).suffix[1:]: s.files[s.main] for s in some}
        model = _model(folder / "models")["forest"]
        return {
            **made,
            **HOSTILE,
            "npy": model.files["m/feature.npy"],
            "card": model.files["m/card.json"],
            "yaml": SURVEY.encode(),
        }


def case_of(command: str, name: str) -> Case:
    """The case NAME, or NAME~KIND: with the content of another kind of file under its main file's name."""
    known, _, kind = name.partition("~")
    case = cases_of(command)[known]
    if not kind:
        return case
    main = case.seed.main if case.seed.main in case.seed.files else sorted(case.seed.files)[0]
    return replace(case, seed=replace(case.seed, files={**case.seed.files, main: foreign()[kind]}, fields=()))
