"""Sound files of every kind that is read, and where their counts, lengths and offsets stand."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path

import heliosmaker
import lasmaker
import numpy as np
import plsmaker
import plzmaker
import rawmaker
from mutate import Field, Files


@dataclass(frozen=True)
class Seed:
    """A sound file (`main`) with what lies beside it; `texts`: which of them are text."""

    name: str
    main: str
    files: Files
    fields: tuple[Field, ...] = ()
    texts: tuple[str, ...] = ()


LAS_FIELDS = (
    (4, 2),
    (6, 2),
    (24, 1),
    (25, 1),
    (94, 2),
    (96, 4),
    (100, 4),
    (104, 1),
    (105, 2),
    (107, 4),
    *((111 + 4 * k, 4) for k in range(5)),
    *((131 + 8 * k, 8) for k in range(12)),
)
LAS14_FIELDS = ((227, 8), (235, 8), (243, 4), (247, 8), (255, 8), (263, 8))
PLS_FIELDS = (
    (172, 1),
    (173, 1),
    (174, 2),
    (176, 8),
    (184, 8),
    (192, 4),
    (200, 4),
    (204, 4),
    (216, 4),
    (220, 4),
    *((224 + 8 * k, 8) for k in range(16)),
)


def _taken(folder: Path, name: str, main: str, fields=(), texts=()) -> Seed:
    files = {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
    found = tuple(Field(f, at, size) for f, at, size in fields if at + size <= len(files[f]))
    return Seed(name, main, files, found, tuple(texts))


def las_fields(data: bytes, name: str) -> list[tuple[str, int, int]]:
    """The header's numbers, those of its records, and of the first and last points."""
    header, start, records = struct.unpack_from("<HII", data, 94)
    length = struct.unpack_from("<H", data, 105)[0]
    found = [*LAS_FIELDS, *(LAS14_FIELDS if header >= 375 else LAS14_FIELDS[:1] if header >= 235 else ())]
    at = header
    for _ in range(records):
        body = struct.unpack_from("<H", data, at + 20)[0]
        found += [(at + 18, 2), (at + 20, 2), *((at + 54 + k, 2) for k in range(0, min(body, 40), 2))]
        found += [(at + 54 + k, w) for k, w in ((0, 1), (1, 1), (2, 4), (6, 4), (10, 8), (18, 8), (12, 4), (16, 8))]
        at += 54 + body
    found += [(start, 8)] * 3 + [
        (start + length * k + j, w) for k in range(3) for j in range(0, length, 4) for w in (1, 4)
    ]
    found += [(len(data) - k, w) for k in (8, 16, 60, 100) for w in (4, 8)]
    return [(name, at, size) for at, size in found if 0 <= at <= len(data) - size]


def wave_fields(data: bytes, name: str, start: int, length: int, block: int, points: int) -> list[tuple[str, int, int]]:
    """The numbers of the wave packet blocks of the first points."""
    inside = ((0, 1), (1, 8), (9, 4), (13, 4), (17, 4), (21, 4), (25, 4))
    found = [(name, start + length * k + block + at, w) for k in range(points) for at, w in inside]
    return [f for f in found if f[1] + f[2] <= len(data)]


def las_seeds(folder: Path) -> list[Seed]:
    """All point formats; those with waveforms with them inside and outside."""
    made = []
    for number in range(11):
        for where in ("external", "internal") if number in (4, 5, 9, 10) else ("none",):
            own = folder / f"f{number}{where}"
            own.mkdir(parents=True)
            path = own / "a.las"
            if where == "none":
                xyz = np.random.default_rng(number).uniform(0, 50, (12, 3))
                more = {"Amplitude": ("u2", 0.01, np.arange(12)), "Pulse width": ("f4", 1.0, np.ones(12))}
                lasmaker.write_las(path, xyz, point_format=number, extra=more if number in (1, 6) else None)
            else:
                lasmaker.survey(
                    path, pulses=8, point_format=number, where=where, bits=16 if number == 5 else 8, n_samples=40
                )
            made.append(_taken(own, own.name, "a.las", _las_numbers(path)))
    for number, where, bits in ((4, "external", 8), (5, "internal", 16), (9, "external", 16), (10, "external", 8)):
        own = folder / f"f{number}compressed"
        own.mkdir()
        told = {1: lasmaker.Descriptor(bits, 40, 1000, compression=1)}
        lasmaker.survey(
            own / "a.las", pulses=8, point_format=number, where=where, bits=bits, n_samples=40, descriptors=told
        )
        made.append(_taken(own, own.name, "a.las", _las_numbers(own / "a.las")))
    return made


def _las_numbers(path: Path) -> list[tuple[str, int, int]]:
    from fwclass.formats.las_header import WAVE_OFFSET, read_header

    data, head = path.read_bytes(), read_header(path)
    found = las_fields(data, path.name)
    if head.point_format in WAVE_OFFSET:
        block = WAVE_OFFSET[head.point_format]
        found += 3 * wave_fields(data, path.name, head.points_start, head.record_length, block, 4)
    for beside in filter(Path.exists, map(path.with_suffix, (".wdp", ".wdz"))):
        found += [(beside.name, at, w) for at, w in ((2, 8), (18, 2), (20, 8), (60, 4))]
    if head.wave_start:
        found += [(path.name, head.wave_start + at, w) for at, w in ((2, 8), (18, 2), (20, 8))]
    return found


def laz_seeds(folder: Path) -> list[Seed]:
    made = []
    for number in (1, 3, 4, 6, 7, 9):
        own = folder / f"z{number}"
        own.mkdir(parents=True)
        if number in (4, 9):
            lasmaker.survey(own / "b.las", pulses=30, point_format=number, where="external")
            (own / "b.wdp").rename(own / "a.wdp")
        else:
            xyz = np.random.default_rng(number).uniform(0, 50, (60, 3))
            lasmaker.write_las(own / "b.las", xyz, point_format=number)
        lasmaker.to_laz(own / "b.las", own / "a.laz")
        (own / "b.las").unlink()
        made.append(_taken(own, own.name, "a.laz", _laz_numbers(own / "a.laz")))
    return made


def _laz_numbers(path: Path) -> list[tuple[str, int, int]]:
    """Of the header, the LASzip record and the chunk table."""
    data = path.read_bytes()
    found = las_fields(data, path.name)
    start = struct.unpack_from("<I", data, 96)[0]
    table = struct.unpack_from("<q", data, start)[0]
    found += 3 * [(path.name, start, 8), (path.name, table, 4), (path.name, table + 4, 4)]
    found += [(path.name, table + k, 2) for k in range(8, 24, 2)]
    at = data.find(b"laszip encoded") + 52
    found += 2 * [(path.name, at + k, w) for k, w in ((0, 2), (2, 2), (8, 4), (12, 4), (16, 8), (24, 8), (32, 2))]
    found += [(path.name, at + 34 + k, 2) for k in range(0, 24, 2)]
    return [f for f in found if f[1] + f[2] <= len(data)]


def copc_seeds(folder: Path) -> list[Seed]:
    """A LAZ file with chunks of 40, 5 and 15 points, and the records that make it a COPC."""
    import lazrs

    folder.mkdir(parents=True)
    n, ends = 60, (40, 45, 60)
    xyz = np.random.default_rng(0).uniform(0, 100, (n, 3))
    raw = lasmaker.write_las(folder / "b.las", xyz, point_format=6).read_bytes()
    (folder / "b.las").unlink()
    start = int.from_bytes(raw[96:100], "little")
    record = lazrs.LazVlr.new_for_compression(6, 0, True)
    more = lasmaker.vlr("copc", 1, bytes(160)) + lasmaker.vlr("laszip encoded", 22204, bytes(record.record_data()))
    path = folder / "a.copc.laz"
    with path.open("wb") as out:
        head = bytearray(raw[:start] + more)
        head[96:100] = len(head).to_bytes(4, "little")
        head[100:104] = (int.from_bytes(raw[100:104], "little") + 2).to_bytes(4, "little")
        head[104] |= 0x80
        out.write(head)
        packer = lazrs.LasZipCompressor(out, record)
        for first, last in zip((0, *ends), ends, strict=False):
            packer.compress_many(raw[start + 30 * first : start + 30 * last])
            if last < n:
                packer.finish_current_chunk()
        packer.done()
    data = bytearray(path.read_bytes())
    data[235:247] = struct.pack("<QI", len(data), 1)
    path.write_bytes(bytes(data) + lasmaker.evlr_head("copc", 1000, 32) + struct.pack("<4iQii", 0, 0, 0, 0, 500, 9, 60))
    return [_taken(folder, "copc", path.name, _laz_numbers(path))]


def pls_seeds(folder: Path) -> list[Seed]:
    short = [plsmaker.Pulse((0, 0, 500), (0, 0, -1), [[(9.0 + 3 * k, [7]) for k in range(5)]]) for _ in range(9)]
    made = []
    for name in ("plain", "appended", "short"):
        own = folder / name
        own.mkdir(parents=True)
        path = own / "a.pls"
        if name == "short":
            kind = plsmaker.Sampling(duration_bits=16)
            plsmaker.write_pls(path, short, {1: plsmaker.Descriptor([kind])})
        else:
            more = {"bits": 16, "appended": -1, "extra_bytes": 3} if name == "appended" else {}
            plsmaker.survey(path, pulses=8, **more)
        data = path.read_bytes()
        start = struct.unpack_from("<q", data, 176)[0]
        found = [*PLS_FIELDS, *((at, w) for at in range(352, start - 8, 4) for w in (2, 4))]
        found += [(start + at, w) for at in range(0, 3 * 48, 4) for w in (4, 8)]
        found += [(len(data) - k, w) for k in range(8, 100, 4) for w in (4, 8)]
        fields = [("a.pls", at, w) for at, w in found] + [("a.wvs", at, w) for at in range(0, 160, 2) for w in (1, 2)]
        made.append(_taken(own, name, "a.pls", fields))
    own = folder / "compressed"
    own.mkdir(parents=True)
    kinds = {1: plsmaker.Descriptor([plsmaker.Sampling(plsmaker.OUTGOING), plsmaker.Sampling()])}
    path = plzmaker.compress(
        plsmaker.survey(own / "a.pls", pulses=8, descriptors=kinds, extra_bytes=3).path, kinds, chunk=3, source=16
    )
    start = struct.unpack_from("<q", path.read_bytes(), 176)[0]
    found = [*PLS_FIELDS, *((at, w) for at in range(352, start + 120, 4) for w in (2, 4))]
    fields = [("a.plz", at, w) for at, w in found] + [("a.wvz", at, w) for at in range(0, 160, 2) for w in (1, 2)]
    made.append(_taken(own, "compressed", "a.plz", fields))
    return made


def raw_seeds(folder: Path) -> list[Seed]:
    """Raw waveforms as text and as Parquet."""
    folder.mkdir(parents=True, exist_ok=True)
    table = rawmaker.scene(pulses=12, n=40).columns()
    told = {"crs": "EPSG:32632", "spacing_ns": "1.0"}
    text = rawmaker.write_csv(folder / "a.csv", table | {"channel": np.zeros(12)}, told).read_bytes()
    made = [Seed("csv", "a.csv", {"a.csv": text}, (), ("a.csv",))]
    heliosmaker.survey(folder / "a_fullwave.txt", pulses=9)
    name = "a_fullwave.txt"
    made.append(Seed("helios", name, {name: (folder / name).read_bytes()}, (), (name,)))
    for name, more in (("parquet", {}), ("plain", {"compression": "none", "use_dictionary": False})):
        data = rawmaker.write_parquet(folder / "a.parquet", table, told, **more).read_bytes()
        fields = tuple(Field("a.parquet", len(data) - k, w) for k in range(8, 900, 3) for w in (1, 4))
        made.append(Seed(name, "a.parquet", {"a.parquet": data}, fields))
    return made


def model_seeds(folder: Path) -> list[Seed]:
    """A model of every kind that keeps rows, without its digest: a stranger can make one that fits."""
    from modelmaker import models

    from fwclass.store.model_rows import ROWS, ModelRows, rows_facts, save_rows
    from fwclass.store.models import save_model

    made = []
    for kind, model in models().items():
        own = folder / kind
        codes = np.repeat(model.codes, 3).astype(np.uint8)
        values, none = np.ones((len(codes), len(model.features)), np.float32), np.empty((len(codes), 0), np.uint8)
        kept = ModelRows(values, codes, none)
        counts = rows_facts(kept)[ROWS]
        save_model(
            own / "m", type(model)(**{n: getattr(model, n) for n in model.layout}, card={**model.card, ROWS: counts})
        )
        save_rows(own / "m", kept)
        fields = [(f"m/{n}.npy", at, w) for n in model.layout for at in range(0, 12, 2) for w in (1, 2)]
        fields += [(f"m/{n}.npy", 128 + at, 4) for n in model.layout for at in range(0, 24, 4)]
        rows = [f"m/{ROWS}/{n}.npy" for n in ("X", "codes")]
        fields += [(path, at, w) for path in rows for at in (*range(0, 12, 2), *range(128, 140, 4)) for w in (1, 4)]
        arrays = [*(f"m/{n}.npy" for n in model.layout), *rows]
        made.append(_taken(own, kind, "m", fields, ["m/card.json", *arrays]))
    return made


TEXT = (
    "0.5 1.25 3 2\n1 2 3 1\n-4.5e2 7 1e3 2\n",
    "x,y,z,classification\n1.0,2.0,3.0,2\n4.0,5.0,6.0,5\n# a comment\n7,8,9,6\n",
    "X;Y;Z;label\r\n1,5;2,5;3,5;0\r\n4,0;5,0;6,0;1\r\n",
    "// X Y Z intensity code\n1 2 3 99 2\n4 5 6 98 5\n",
)
TRAJECTORY = (
    "time,x,y,z\n1,500000,5400000,900\n2,500001,5400001,901\n3,500002,5400002,902\n",
    "# a heading\ngps_time;latitude;longitude;height\n100;48.5;9.1;900\n101;48.6;9.2;901\n",
    "1 2 3 4\n2 3 4 5\n3 4 5 6\n",
)


def text_seeds(folder: Path) -> list[Seed]:
    return [Seed(f"t{k}", "a.xyz", {"a.xyz": text.encode()}, (), ("a.xyz",)) for k, text in enumerate(TEXT)]


def trajectory_seeds(folder: Path) -> list[Seed]:
    made = [Seed(f"t{k}", "a.txt", {"a.txt": text.encode()}, (), ("a.txt",)) for k, text in enumerate(TRAJECTORY)]
    rows = np.zeros((6, 17))
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = 1000 + np.arange(6), 0.84, 0.16, 900
    fields = tuple(Field("a.out", 8 * k, 8) for k in range(5)) + tuple(Field("a.out", 136 * k, 8) for k in range(6))
    return [*made, Seed("sbet", "a.out", {"a.out": rows.tobytes()}, fields)]


def polygon_seeds(folder: Path) -> list[Seed]:
    """GeoPackage, GeoJSON and Shapefile, through GDAL."""
    made = []
    for ending in ("gpkg", "geojson", "shp"):
        own = folder / ending
        own.mkdir(parents=True)
        _frame().to_file(own / f"a.{ending}")
        fields: list[tuple[str, int, int]] = []
        if ending == "shp":
            fields = [("a.shp", at, 4) for at in range(24, 180, 4)] + [("a.shx", at, 4) for at in range(24, 120, 4)]
            fields += [("a.dbf", at, w) for at in (*range(0, 12, 2), *range(32, 130)) for w in (1, 2)]
        if ending == "gpkg":
            fields = [("a.gpkg", at, 2) for at in range(16, 100, 2)]
        made.append(_taken(own, ending, f"a.{ending}", fields, ["a.geojson"] if ending == "geojson" else ["a.prj"]))
    return made


def geoparquet_seeds(folder: Path) -> list[Seed]:
    made = []
    for name, more in (("snappy", {}), ("plain", {"compression": None}), ("zstd", {"compression": "zstd"})):
        own = folder / name
        own.mkdir(parents=True)
        _frame().to_parquet(own / "a.parquet", write_covering_bbox=True, **more)
        made.append(_taken(own, name, "a.parquet", (), ["a.parquet"] if name == "plain" else []))
    return made


def wkb_seeds(folder: Path) -> list[Seed]:
    import shapely

    made = []
    for k, shape in enumerate(_frame().geometry):
        data = shapely.to_wkb(shape)
        fields = tuple(Field("a.wkb", at, 4) for at in range(1, min(len(data), 40)))
        made.append(Seed(f"w{k}", "a.wkb", {"a.wkb": data}, fields))
    return made


def _frame():
    import geopandas
    import shapely

    square = shapely.box(500000, 5400000, 500010, 5400010)
    hole = [(500022, 5400002), (500022, 5400004), (500024, 5400004), (500024, 5400002)]
    holed = shapely.Polygon(shapely.box(500020, 5400000, 500030, 5400010).exterior, [hole])
    two = shapely.MultiPolygon([square, shapely.box(500060, 5400000, 500070, 5400010)])
    columns = {"klass": ["roof", "tree", None], "code": [6, 5, 2], "share": [0.5, 1.0, 2.0]}
    return geopandas.GeoDataFrame(columns, geometry=[square, holed, two], crs=25832)


def conf_seeds(folder: Path) -> list[Seed]:
    """The configurations, feature sets and presets that come with the program, the shorter ones."""
    from fwclass.conf.files import conf_directory

    made = []
    for path in sorted(conf_directory().rglob("*.yaml")):
        if path.parent.name in ("surveys", "features", "presets"):
            made.append(
                Seed(f"{path.parent.name}/{path.stem}", "a.yaml", {"a.yaml": path.read_bytes()}, (), ("a.yaml",))
            )
    return made


def store_seeds(folder: Path) -> list[Seed]:
    """The JSON files of a run directory."""
    from fwclass.store.run_store import Store

    def work(directory: Path) -> dict[str, int]:
        (directory / "laz").mkdir()
        (directory / "laz" / "a.laz").write_bytes(b"abc")
        return {"rows": 3}

    folder.mkdir(parents=True)
    store = Store(folder)
    for place in ("run", "store"):
        store.commit("publish", f"1_{place}", "0" * 24, {"a": "b"}, place, work, 1, {"size": 5.0})
    failure = {"stage": "tile", "part": "1_1", "key": "k", "message": "no"}
    request = {"conf": "demo", "settings": ["tile.size=50"], "workflow": "classification", "tiles": None}
    for name, value in (("failures/tile/1_1.json", failure), ("run.json", request), ("lock", {"host": "h", "pid": 1})):
        path = folder / "store" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(value))
    seed = _taken(folder, "store", "store", (), ())
    return [Seed("store", "store", seed.files, (), tuple(n for n in seed.files if n.startswith("store/")))]


def kept_seeds(folder: Path) -> list[Seed]:
    """A table and arrays as stages leave them: few ones in Parquet, many in Zarr, of which the documents alone are
    here: Blosc reads where a damaged chunk tells it to, and the digests of chunks are all that keeps one from it."""
    from fwclass.schema import Table
    from fwclass.store import arrays, tables

    rng, made = np.random.default_rng(2), []
    columns = {n: rng.uniform(0, 50, 400) for n in "xyz"} | {"classification": np.arange(400, dtype=np.uint8) % 7}
    height = {"height": rng.normal(size=(30, 40)).astype(np.float32), "count": np.arange(9)}
    for name, file, write in (
        ("table", "table.parquet", lambda path: tables.write_groups(path, Table(columns), (0, 150, 400))),
        ("small", "a.parquet", lambda path: arrays.write_one_file(path, height, {"edge": 1.0})),
        ("group", "a.zarr", lambda path: arrays._write_group(path, height, {"edge": 1.0})),
    ):
        own = folder / name
        own.mkdir(parents=True)
        write(own / file)
        files = _taken(own, name, file).files
        seed = Seed(name, file, {n: d for n, d in files.items() if n.endswith((".json", ".parquet"))})
        fields = tuple(
            Field(n, len(data) - k, w)
            for n, data in seed.files.items()
            if n.endswith(".parquet")
            for k in (8, *range(12, min(len(data), 900), 5))
            for w in (1, 4)
        )
        made.append(Seed(name, file, seed.files, fields, tuple(n for n in seed.files if n.endswith(".json"))))
    return made


def _frames(count: int = 6, lit: bool = False) -> list:
    from fwclass.street.frames import Frame, Scan

    scan, rng = Scan(19, -0.9, 0.1, 0.1, 30.0), np.random.default_rng(5)
    ranges = [rng.uniform(0.05, 31, 19).astype(np.float32) for _ in range(count)]
    labels = np.arange(19, dtype=np.uint8) % 3
    return [
        Frame(k, 0.025 * k, scan, r, 1.0, labels=labels, intensities=r if lit else None) for k, r in enumerate(ranges)
    ]


FRAMES_CSV = (
    "frame,time,speed,angle_min,angle_increment,ranges\n0,0,1.5,-0.1,0.1,1,nan,2\n1,0.025,,-0.1,0.1,1,,inf\n",
    "time;place;range_max;ranges\r\n0;1;30;1;2;3\r\n0.02;1.1;30;4;5;6\r\n",
    "time\tranges\n" + "".join(f"{0.02 * k}\t{k}\t{k + 1}\n" for k in range(9)),
)


def frame_seeds(folder: Path) -> list[Seed]:
    """Recordings of frames as CSV, Parquet, and the bytes of a stream."""
    from fwclass.street.recording_parquet import write_recording
    from fwclass.street.stream import HEAD, encode_frame

    folder.mkdir(parents=True, exist_ok=True)
    made = [Seed(f"csv{k}", "a.csv", {"a.csv": text.encode()}, (), ("a.csv",)) for k, text in enumerate(FRAMES_CSV)]
    places = [(at, w) for at, w in ((0, 4), (4, 4), *((k, 8) for k in range(8, 56, 8)), (56, 4), (60, 4), (64, 4))]
    for lit in (False, True):
        name = "-lit" if lit else ""
        write_recording(folder / "a.parquet", _frames(lit=lit))
        data = (folder / "a.parquet").read_bytes()
        fields = tuple(Field("a.parquet", len(data) - k, w) for k in range(8, 900, 3) for w in (1, 4))
        made.append(Seed(f"parquet{name}", "a.parquet", {"a.parquet": data}, fields))
        stream = b"".join(map(encode_frame, _frames(lit=lit)))
        length = HEAD.size + 4 * 19 * (1 + lit)
        fields = tuple(Field("a.stream", k * length + at, w) for k in range(6) for at, w in places)
        made.append(Seed(f"stream{name}", "a.stream", {"a.stream": stream}, fields))
    return made


def bag_seeds(folder: Path) -> list[Seed]:
    """ROS 1 bags, plain and compressed; ROS 2 bags as SQLite and MCAP."""
    import bagmaker

    made = []
    for name in ("one", "bz2", "lz4"):
        own = folder / name
        own.mkdir(parents=True)
        bagmaker.write_bag(own / "a.bag", _frames(), compression=None if name == "one" else name)
        data = (own / "a.bag").read_bytes()
        ends = [at for at in range(len(data) - 4) if data[at : at + 4] in (b"size", b"coun", b"inde", b"chun", b"conn")]
        fields = [("a.bag", at + k, 4) for at in ends for k in (5, 6, 8, 10)]
        fields += [("a.bag", at, 4) for at in range(0, len(data) - 4, 31)]
        made.append(_taken(own, name, "a.bag", fields))
    for name, storage, compression in (
        ("sqlite", "sqlite3", None),
        ("sqlitez", "sqlite3", "message"),
        ("sqlitef", "sqlite3", "file"),
        ("mcap", "mcap", None),
        ("mcapz", "mcap", "storage"),
    ):
        own = folder / name
        own.mkdir(parents=True)
        bagmaker.write_bag2(own / "bag", _frames(), storage=storage, compression=compression)
        seed = _taken(own, name, "bag", (), ["bag/metadata.yaml"])
        fields = tuple(
            Field(n, at, w)
            for n, data in seed.files.items()
            if not n.endswith("yaml")
            for at in (*range(0, min(len(data), 200), 4), *range(max(0, len(data) - 900), len(data) - 8, 5))
            for w in (4, 8)
        )
        made.append(Seed(name, "bag", seed.files, fields, seed.texts))
    return made


def street_las_seeds(folder: Path) -> list[Seed]:
    """A mobile LAS of a 2-D scanner with its trajectory."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(3)
    angle = np.tile(np.radians(np.arange(-90, 90, 6.0)), 14)
    time = np.repeat(0.025 * np.arange(14), 30) + np.tile(0.025 * np.arange(30) / 60, 14)
    r = rng.uniform(2, 5, len(time))
    xyz = np.stack([100 + 1.5 * time, 50 - r * np.cos(angle), 10 + r * np.sin(angle)], axis=1)
    lasmaker.write_las(folder / "a.las", xyz, point_format=6, gps_time=1000 + time, classification=5)
    rows = [f"{1000 + t:.4f},{100 + 1.5 * t:.4f},50,10" for t in np.arange(0, 0.5, 0.05)]
    (folder / "a.txt").write_text("time,x,y,z\n" + "\n".join(rows) + "\n")
    seed = _taken(folder, "las", "a.las", _las_numbers(folder / "a.las"), ["a.txt"])
    return [seed]
