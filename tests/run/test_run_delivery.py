"""What a run delivers is joined, opened and queried as docs/delivery.md says."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import duckdb
import laspy
import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
from pystac.validation.local_validator import LocalValidator

import fwclass
from fwclass.errors import InputError
from fwclass.store.url import Url

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def root(finished: tuple[Path, dict[str, Any]]) -> Path:
    return finished[0]


def echoes_of(root: Path) -> dict[tuple[int, int, int], int]:
    """Class by strip, pulse and echo, of the Parquet tiles."""
    out = {}
    for path in sorted((root / "parquet").glob("*.parquet")):
        table = pq.read_table(path, columns=["strip", "pulse", "echo_number", "classification"])
        rows = (table[n].to_pylist() for n in table.column_names)
        out |= {(s, p, e): c for s, p, e, c in zip(*rows, strict=True)}
    return out


def identities(las: laspy.LasData) -> list[tuple[int, int, int]]:
    """Strip, pulse and echo number of every point."""
    columns = (np.asarray(las[name]).tolist() for name in ("point_source_id", "pulse", "return_number"))
    return list(zip(*columns, strict=True))


def test_tiles_join_parquet_and_strips_by_the_point_source(root: Path) -> None:
    wanted, seen = echoes_of(root), {}
    for path in sorted((root / "laz" / "tiles").glob("*.copc.laz")):
        las = laspy.read(path)
        who = identities(las)
        seen |= dict(zip(who, np.asarray(las.classification).tolist(), strict=True))
    assert seen == wanted
    report = json.loads((root / "report.json").read_text())
    assert {f["strip"] for f in report["input"]["files"]} == {s for s, _, _ in wanted}
    for file in report["input"]["files"]:
        assert (root / "laz" / "strips" / file["path"].replace(".las", ".laz")).is_file()


def test_the_overview_is_a_fair_sample_of_the_tiles(root: Path) -> None:
    wanted = echoes_of(root)
    las = laspy.read(root / "laz" / "overview.copc.laz")
    assert 0 < len(las.points) <= len(wanted)
    who = identities(las)
    assert all(wanted[k] == c for k, c in zip(who, np.asarray(las.classification).tolist(), strict=True))


def test_the_list_of_tiles_is_stac(root: Path) -> None:
    made = json.loads((root / "laz" / "survey.vpc").read_text())
    assert made["type"] == "FeatureCollection" and made["features"]
    stac, total = LocalValidator().item_validator("1.1.0"), 0
    for k, item in enumerate(made["features"]):
        assert item["stac_version"] == "1.0.0" and item["links"] == []
        assert not list(stac.iter_errors(item | {"stac_version": "1.1.0"})), "all that 1.0 asks, and more"
        assert len(item["bbox"]) == 4 and item["geometry"]["type"] == "Polygon"
        assert item["properties"]["proj:code"] == "EPSG:25832" and ("proj:wkt2" in item["properties"]) == (k == 0)
        path = root / "laz" / item["assets"]["data"]["href"]
        head = laspy.open(path).header
        assert head.point_count == item["properties"]["pc:count"]
        assert item["properties"]["proj:bbox"] == pytest.approx([*head.mins, *head.maxs], abs=1e-9)
        names = {d["name"] for d in item["properties"]["pc:schemas"]}
        assert set(head.point_format.extra_dimension_names) <= names
        assert (root / "laz" / item["assets"]["overview"]["href"]).is_file()
        total += head.point_count
    assert total == len(echoes_of(root))


def test_the_project_names_files_that_are_there(root: Path) -> None:
    with zipfile.ZipFile(root / "survey.qgz") as archive:
        project = Xml.fromstring(archive.read("survey.qgs"))  # noqa: S314 - our own
    sources = [e.text or "" for e in project.iter("datasource")]
    assert len(sources) >= 12 and all(s.startswith("./") for s in sources)
    for source in sources:
        assert (root / source.split("|")[0]).exists(), source
    ids = {e.text for e in project.iter("id")}
    assert all(len(i or "") > 10 for i in ids), "QGIS replaces shorter ones"
    assert {e.get("id") for e in project.iter("layer-tree-layer")} == ids
    for path in (root / "rasters").glob("*.tif"):
        assert f"./rasters/{path.name}" in sources, "the quality's were in no layer"
        assert Xml.parse(path.with_suffix(".qml")).getroot().tag == "qgis"  # noqa: S314


def test_tiles_as_polygons_tell_counts_and_accuracy(root: Path) -> None:
    meta, _, _, fields = pyogrio.raw.read(root / "tiles.gpkg", layer="tiles")
    table = dict(zip(meta["fields"], fields, strict=True))
    classes = list(echoes_of(root).values())
    for name in meta["fields"]:
        if name.startswith("class_"):
            assert table[name].sum() == classes.count(int(name.removeprefix("class_")))
    assert sorted(table["rank"]) == list(range(1, len(table["rank"]) + 1))
    assert table["echoes"].sum() == len(classes)
    known = table["accuracy"][np.isfinite(table["accuracy"])]
    assert ((known >= 0) & (known <= 1)).all()


def test_the_report_fits_its_schema(root: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((ROOT / "docs" / "report.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    report = json.loads((root / "report.json").read_text())
    jsonschema.validate(report, schema)
    assert set(report) == set(schema["required"]), "every part of the report is described"


def blocks(kind: str, page: str = "docs/delivery.md") -> list[str]:
    return re.findall(rf"```{kind}\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("query", [*blocks("sql"), *blocks("sql", "README.md")])
def test_documented_queries_run_in_duckdb(query: str, root: Path) -> None:
    assert query_of(root, query) is not None


def query_of(root: Path, query: str) -> list[tuple]:
    """Rows of a query of the docs; the extension that it loads lies in a package, so that nothing is fetched."""
    found = importlib.util.find_spec("duckdb_extension_spatial")
    extension = next(Path(found.submodule_search_locations[0]).rglob("*.duckdb_extension"))
    query = re.sub("demo-run|RUN", str(root), query).replace("LOAD spatial", f"LOAD '{extension}'")
    return duckdb.connect(config={"autoinstall_known_extensions": False}).execute(query).fetchall()


def test_duckdb_finds_the_same_echoes_by_geometry_and_by_coordinates(root: Path) -> None:
    told = "SELECT count(*) FROM 'RUN/parquet/*.parquet' WHERE "
    by_geometry = query_of(root, f"LOAD spatial; {told} ST_DWithin(geometry, ST_Point(512050, 5403050), 20)")
    by_numbers = query_of(root, f"{told} (x - 512050) ** 2 + (y - 5403050) ** 2 <= 400")
    assert by_geometry == by_numbers and by_numbers[0][0] > 100


def notebook() -> str:
    cells = json.loads((ROOT / "docs" / "delivery.ipynb").read_text(encoding="utf-8"))["cells"]
    return "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")


@pytest.mark.slow
@pytest.mark.parametrize("which", ["page", "notebook"])
def test_documented_python_runs(which: str, root: Path, tmp_path: Path) -> None:
    pytest.importorskip("geopandas")
    (tmp_path / "demo-run").symlink_to(root)
    code = "\n".join(blocks("python")) if which == "page" else notebook()
    code = code.replace('("confidence", "<", 0.7)', '("confidence", "<", 1.1)')
    made = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert made.returncode == 0, made.stderr[-2000:]
    assert which == "page" or (tmp_path / "delivery.png").stat().st_size > 1000


def test_a_box_and_a_condition_choose_echoes(root: Path) -> None:
    run = fwclass.open(root)
    everything = run.echoes(columns=["x", "y", "classification"]).to_arrow()
    x, y = (everything[n].to_numpy() for n in ("x", "y"))
    box = (
        float(np.quantile(x, 0.3)),
        float(np.quantile(y, 0.2)),
        float(np.quantile(x, 0.6)),
        float(np.quantile(y, 0.9)),
    )
    inside = (x >= box[0]) & (x < box[2]) & (y >= box[1]) & (y < box[3])
    assert len(run.echoes(box=box)) == inside.sum() > 0
    code = int(everything["classification"][0].as_py())
    some = run.echoes(box=box, columns=["x"], where=[("classification", "==", code)])
    assert len(some) == (inside & (everything["classification"].to_numpy() == code)).sum()
    assert some.to_arrow().column_names == ["x"]


def test_an_explanation_gives_the_delivered_class(root: Path) -> None:
    run = fwclass.open(root)
    rows = run.echoes(columns=["strip", "pulse", "echo_number", "classification", "confidence"]).to_arrow().to_pylist()
    codes = {c["name"]: c["code"] for c in run.report["classes"]}
    for row in rows[:: max(1, len(rows) // 4)]:
        told = run.explain(row)
        name, share = next(iter(told.shares.items()))
        assert share == pytest.approx(row["confidence"], abs=1e-6)
        assert codes[name] == row["classification"] or list(told.shares.values()).count(share) > 1
        assert str(told).startswith(name)


def test_a_waveform_is_found_by_strip_and_pulse(root: Path) -> None:
    run = fwclass.open(root)
    row = run.echoes(columns=["strip", "pulse"]).to_arrow().to_pylist()[5]
    wave = run.waveform(row["strip"], row["pulse"])
    assert len(wave.time) == len(wave.samples) > 10 and (np.diff(wave.time) > 0).all()
    assert wave.echoes.num_rows >= 1
    with pytest.raises(InputError, match="no such waveform"):
        run.waveform(row["strip"], 2**31)


def test_what_cannot_be_opened_is_said(root: Path, tmp_path: Path) -> None:
    for place, words in (
        (tmp_path, "not a run directory"),
        (tmp_path / "none", "no such run"),
        (Url("s3://b/r"), "object"),
    ):
        with pytest.raises(InputError, match=words):
            fwclass.open(place)
    (tmp_path / "store").mkdir()
    with pytest.raises(InputError, match="delivered nothing yet"):
        fwclass.open(tmp_path)
    copy = tmp_path / "copy"
    shutil.copytree(root, copy, symlinks=True)
    victim = next((copy / "current" / "parquet").iterdir()).resolve()
    victim.chmod(0o644)
    victim.write_bytes(victim.read_bytes()[:-8])
    with pytest.raises(InputError, match="damaged"):
        fwclass.open(copy)
    with pytest.raises(InputError, match="no such raster"):
        fwclass.open(root).raster("dtn")
    with pytest.raises(InputError, match="no such column"):
        fwclass.open(root).echoes(columns=["clasification"])
    for where in ([("clasification", "==", 2)], [[("confidence", "<", 1)], [("nope", "<", 1)]]):
        with pytest.raises(InputError, match="no such column"):
            fwclass.open(root).echoes(where=where)
    with pytest.raises(InputError, match="this is no condition"):
        fwclass.open(root).echoes(where=[("confidence", "~", 1)])
    with pytest.raises(InputError, match="cannot be compared"):
        fwclass.open(root).echoes(where=[("confidence", "<", "high")]).to_pandas()
    for box in ((0, 0, 1), "abcd", 5, (0, 0, None, 1)):
        with pytest.raises(InputError, match="this is no box"):
            fwclass.open(root).echoes(box=box)  # type: ignore[arg-type]
    for name in (5, b"run", "a\0b"):
        with pytest.raises(InputError, match="this is no path"):
            fwclass.open(name)  # type: ignore[arg-type]
    for echo in ({"strip": 1, "pulse": 2}, (1, 2), (1, 193.5, 1), (1, "a", 1)):
        with pytest.raises(InputError, match="this names no echo"):
            fwclass.open(root).explain(echo)  # type: ignore[arg-type]


def test_a_copy_of_the_delivery_opens_without_its_run(root: Path, tmp_path: Path) -> None:
    shutil.copytree(root / "current", tmp_path / "copy")
    run, copy = fwclass.open(root), fwclass.open(tmp_path / "copy")
    assert copy.echoes().to_pandas().equals(run.echoes().to_pandas())
    assert copy.report == run.report and [t["tile"] for t in copy.tiles] == [t["tile"] for t in run.tiles]
    assert (copy.raster("dtm").values == run.raster("dtm").values).sum() > 0
    with pytest.raises(InputError):
        copy.waveform(1, 1)
    tile = next((tmp_path / "copy" / "laz" / "tiles").iterdir())
    tile.chmod(0o644)
    tile.write_bytes(tile.read_bytes()[:-1])
    with pytest.raises(InputError, match="damaged") as fault:
        fwclass.open(tmp_path / "copy")
    assert tile.name in str(fault.value) and "copy it again" in str(fault.value)
    for text in ("{", "[]", '{"files": {"a": 1}}'):
        manifest = tmp_path / "copy" / "manifest.json"
        manifest.chmod(0o644)
        manifest.write_text(text)
        with pytest.raises(InputError, match="copied delivery cannot be read"):
            fwclass.open(tmp_path / "copy")


def test_a_tile_with_other_bytes_is_said_and_not_read(root: Path, tmp_path: Path) -> None:
    """Its size is as before, and Parquet reads it. A box that does not touch the tile does without it."""
    shutil.copytree(root, tmp_path / "run", symlinks=True)
    run = fwclass.open(tmp_path / "run")
    tile, *_, last = run.tiles
    box = lambda t: (*(b + 2 for b in t["bounds"][:2]), *(b - 2 for b in t["bounds"][3:5]))  # noqa: E731
    before = run.echoes(box(last)).to_pandas()
    table = run.path / "parquet" / f"{tile['tile']}.parquet"
    table.chmod(0o644)
    data = bytearray(table.read_bytes())
    data[len(data) // 3] ^= 1
    table.write_bytes(data)
    for asked in (run.echoes, lambda: run.echoes(box(tile)), lambda: run.waveform(1, 1)):
        with pytest.raises(InputError, match="is damaged") as fault:
            asked()
        assert table.name in str(fault.value) and "--verify" in str(fault.value)
    assert len(before) and run.echoes(box(last)).to_pandas().equals(before)


def test_what_is_removed_after_it_was_opened_is_said(root: Path, tmp_path: Path) -> None:
    """Fewer echoes than there are would be wrong in silence."""
    shutil.copytree(root, tmp_path / "run", symlinks=True)
    run = fwclass.open(tmp_path / "run")
    whole = len(run.echoes(columns=["x"]))
    table = next((run.path / "parquet").iterdir())
    table.rename(tmp_path / table.name)
    with pytest.raises(InputError, match="is gone") as fault:
        run.echoes(columns=["x"])
    assert table.name in str(fault.value)
    (tmp_path / table.name).rename(table)
    assert len(run.echoes(columns=["x"])) == whole
    raster = run.path / "rasters" / "dtm.tif"
    data = raster.read_bytes()
    raster.unlink()
    with pytest.raises(InputError, match="is gone"):
        run.raster("dtm")
    raster.write_bytes(data[: len(data) // 3])
    with pytest.raises(InputError, match="is damaged"):
        run.raster("dtm")
    shutil.rmtree(run.path)
    for asked in (lambda: run.report, lambda: run.tiles, run.echoes, lambda: run.raster("dsm")):
        with pytest.raises(InputError, match="there no more") as fault:
            asked()
        assert "open the run again" in str(fault.value)


def test_a_link_that_leads_nowhere_is_a_damaged_delivery(root: Path, tmp_path: Path) -> None:
    shutil.copytree(root, tmp_path / "run", symlinks=True)
    shutil.rmtree(tmp_path / "run" / "generations")
    with pytest.raises(InputError, match="damaged") as fault:
        fwclass.open(tmp_path / "run")
    assert "--verify" in str(fault.value)
    with pytest.raises(InputError, match="no such run") as fault:
        fwclass.open(Path(__file__))
    assert "a file" in str(fault.value)


def test_coordinates_in_parquet_are_the_numbers_next_to_millimetres(root: Path) -> None:
    echoes = fwclass.open(root).echoes(columns=["x", "y", "z"])
    assert repr(echoes).startswith(f"Echoes({len(echoes):,} echoes of ")
    for values in echoes.to_pandas().to_numpy().T:
        assert (values == np.round(values, 3)).all()


def test_a_tile_whose_bytes_were_overwritten_is_named(root: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(root, copy, symlinks=True)
    victim = max((copy / "current" / "parquet").iterdir(), key=lambda path: path.stat().st_size).resolve()
    echoes = fwclass.open(copy).echoes()
    victim.chmod(0o644)
    data = bytearray(victim.read_bytes())
    data[200 : len(data) // 2] = bytes(len(data) // 2 - 200)
    victim.write_bytes(data)
    for read in (echoes.to_pandas, lambda: echoes.dask().compute()):
        with pytest.raises(InputError, match="cannot be read any more") as fault:
            read()
        assert victim.name in str(fault.value) and "--verify" in str(fault.value)


def test_importing_takes_no_time() -> None:
    code = "import time; t = time.process_time(); import fwclass; print(time.process_time() - t)"
    took = min(float(subprocess.check_output([sys.executable, "-c", code])) for _ in range(3))
    loaded = subprocess.check_output(
        [sys.executable, "-c", "import sys, fwclass; print('numpy' in sys.modules)"], text=True
    )
    assert loaded.strip() == "False" and took < 0.1
