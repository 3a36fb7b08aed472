"""The readers of foreign bytes: sound files of each, everything that a user can do with one, and what it may cost."""

from __future__ import annotations

import json
import os
import signal
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import seeds
from seeds import Seed

from fwclass.errors import FwclassError

Actions = list[Callable[[], object]]


@dataclass(frozen=True)
class Target:
    """A reader.

    `seeds`: makes its sound files in a directory. `uses`: what is done with a file; every one may end in an
    `FwclassError` of its own. `fixed`, `times`: it may allocate so many MiB, and so many bytes per byte of its files.
    `share`: of the inputs of a long run, relative to the others.
    """

    seeds: Callable[[Path], list[Seed]]
    uses: Callable[[Path], Actions]
    fixed: int = 64
    times: int = 200
    share: float = 1.0


def _spans(path: Path) -> None:
    from fwclass.read.params import ReadParams
    from fwclass.read.source import open_source
    from fwclass.read.stage import check_source, index_source, read_span

    params = ReadParams(
        chunk_pulses=5,
        max_span_points=1000,
        missing_packets="error",
        mirror_beams=False,
        sensor_ranges=True,
        use_flagged=False,
        project_to=None,
    )
    source = open_source(path)
    for span in index_source(source, params):
        waves = read_span(source, span, params)
        assert waves.offsets[-1] == len(waves.samples)
    check_source(source, params)


def _told(path: Path) -> None:
    from fwclass.read.info import describe, info

    found = info(path)
    json.dumps(found, allow_nan=False)
    describe(found)


def _points(path: Path) -> Actions:
    from fwclass.read.cloud import read_point_cloud
    from fwclass.read.stage import read_cloud

    return [partial(_told, path), partial(_spans, path), partial(read_cloud, path), partial(read_point_cloud, path)]


def _pulses(path: Path) -> Actions:
    return [partial(_told, path), partial(_spans, path)]


def _model(path: Path) -> Actions:
    return [partial(_forged, path), partial(_rows, path)]


def _rows(path: Path) -> None:
    from fwclass.store.model_rows import load_rows

    model, rows = load_rows(path)
    assert rows.X.shape == (len(rows.codes), len(model.features)) and len(rows.context) == len(rows.codes)


def _forged(path: Path) -> None:
    """Its digest made to fit, as anyone can, it must be refused or answer."""
    from fwclass.classify.shares import answer
    from fwclass.model import KINDS
    from fwclass.store import models

    try:
        card = json.loads((path / "card.json").read_bytes())
        arrays = {n: np.load(path / f"{n}.npy", mmap_mode="r") for n in KINDS[card["kind"]].layout}
        card["digest"] = models._digest(card, arrays)
        (path / "card.json").write_text(json.dumps(card))
    except Exception:  # no forger could either
        card = None
    model = models.load_model(path)
    columns = len(model.features)
    if columns <= 1000:
        winner, shares = answer(np.full((2, columns), [[0.5], [np.nan]], np.float32), model)
        assert shares.shape[0] == 2 and (winner < shares.shape[1]).all()


def _text(path: Path) -> Actions:
    from fwclass.read.cloud import read_point_cloud
    from fwclass.read.text import read_text

    return [lambda: read_text(path).codes, partial(read_point_cloud, path)]


def _trajectory(path: Path) -> Actions:
    from fwclass.read.trajectory import in_survey_time, read_trajectory, thin_trajectory

    def whole() -> None:
        found = thin_trajectory(read_trajectory(path, "EPSG:25832"), 0.5)
        in_survey_time(found, 1.0, 2.0, path)

    return [whole]


def _polygons(path: Path) -> Actions:
    from fwclass.read.polygons import open_polygons, read_polygons, reproject

    def whole() -> None:
        from pyproj import CRS

        opened = open_polygons(path)
        _, made = read_polygons(opened, next(iter(opened.fields), None))
        if opened.crs is not None:
            reproject(made, opened.crs, CRS.from_epsg(25833), path)

    return [partial(_told, path), whole]


def _wkb(path: Path) -> Actions:
    from fwclass.formats.wkb import shapes

    return [lambda: shapes([path.read_bytes(), None], path)]


def _conf(path: Path) -> Actions:
    from fwclass import conf
    from fwclass.conf.files import read
    from fwclass.conf.sets import feature_set
    from fwclass.errors import ConfigError

    def preset() -> None:
        try:
            for value in read(path).values():
                conf.section("ground", (), {"ground": value})
        except ConfigError:
            pass

    def setting() -> None:
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines()[:3]:
            conf.section("tile", (f"tile.size={line[:200]}",))

    return [lambda: conf.load(path), lambda: feature_set("./a.yaml", path.parent), preset, setting]


def _store(path: Path) -> Actions:
    from fwclass.operate.request import Request
    from fwclass.store.lock import holder
    from fwclass.store.run_store import Store

    root = path.parent
    store = Store(root)

    def receipts() -> None:
        for receipt in list(store.receipts("publish")):
            store.done(receipt.stage, receipt.part, receipt.key)
            store.provenance.params(receipt)
            store.path("publish", receipt.part, "laz/a.laz")

    return [
        receipts,
        store.failures.all,
        lambda: Request.kept(store).command(),
        lambda: holder(root),
        lambda: store.done("publish", "1_run", "0" * 24),
        lambda: store.forget_others("publish", ["1_store"]),
    ]


def _kept(path: Path) -> Actions:
    """As if its digest had been made to fit."""
    from fwclass.store.arrays import read_arrays
    from fwclass.store.tables import read_table, row_groups_of

    if path.name.startswith("table"):
        return [
            lambda: row_groups_of(path),
            lambda: read_table(path),
            lambda: read_table(path, ("x", "classification"), [0]),
        ]
    return [lambda: read_arrays(path), lambda: read_arrays(path, ("height",))]


def _street_config() -> Any:
    from fwclass import conf

    return conf.load("street-sim", ("street.speed=1.0",))


def _recording(path: Path) -> Actions:
    from fwclass.single_file.street.info import describe, info

    def whole() -> None:
        found = info(path, _street_config().street)
        json.dumps(found)
        describe(found)

    return [whole]


def _frames(path: Path) -> Actions:
    from fwclass.street.stream import Decoder

    def stream() -> None:
        decoder, data = Decoder(4096), path.read_bytes()
        for at in range(0, len(data), 97):
            for frame in decoder.feed(data[at : at + 97]):
                assert 0 < len(frame.ranges) == frame.scan.beams <= 4096
        decoder.end()

    return [stream] if path.suffix == ".stream" else _recording(path)


def _street_las(path: Path) -> Actions:
    from fwclass.graph.street_recordings import TrajectoryFiles
    from fwclass.single_file.street.info import describe, info

    way = TrajectoryFiles((path.with_suffix(".txt"),))
    return [lambda: describe(info(path, _street_config().street, way))]


TARGETS = {
    "las": Target(seeds.las_seeds, _points, share=10),
    "laz": Target(seeds.laz_seeds, _points, share=6),
    "copc": Target(seeds.copc_seeds, _points, share=5),
    "pulsewaves": Target(seeds.pls_seeds, _pulses, times=400, share=10),
    "raw": Target(seeds.raw_seeds, _pulses, times=2000, share=6),
    "model": Target(seeds.model_seeds, _model, share=8),
    "conf": Target(seeds.conf_seeds, _conf, times=2000, share=0.4),
    "text": Target(seeds.text_seeds, _text, share=16),
    "trajectory": Target(seeds.trajectory_seeds, _trajectory, share=15),
    "polygons": Target(seeds.polygon_seeds, _polygons, share=1.5),
    "geoparquet": Target(seeds.geoparquet_seeds, _polygons, share=2.5),
    "wkb": Target(seeds.wkb_seeds, _wkb, share=16),
    "frames": Target(seeds.frame_seeds, _frames, times=2000, share=6),
    "bags": Target(seeds.bag_seeds, _recording, fixed=192, times=400, share=8),
    "streetlas": Target(seeds.street_las_seeds, _street_las, share=4),
    "store": Target(seeds.store_seeds, _store, share=10),
    "kept": Target(seeds.kept_seeds, _kept, times=2000, share=8),
}
"""By name, as ``--reader`` takes it."""


def _harm_seeds(folder: Path) -> list[Seed]:
    return [Seed("plain", "a.txt", {"a.txt": b"none"})]


def _harm(path: Path) -> Actions:
    """Not a reader: does what its file says, so that the watch over readers can be tested."""
    actions: dict[bytes, Callable[[], object]] = {
        b"crash": lambda: os.kill(os.getpid(), signal.SIGSEGV),
        b"hang": lambda: any(iter(int, 1)),
        b"hoard": lambda: bytearray(1 << 28),
        b"raise": lambda: 1 / 0,
    }
    return [actions.get(path.read_bytes(), lambda: None)]


ALL = {**TARGETS, "harm": Target(_harm_seeds, _harm)}


@cache
def seeds_of(reader: str) -> dict[str, Seed]:
    """The sound files of a reader, by name."""
    with tempfile.TemporaryDirectory() as folder:
        return {s.name: s for s in ALL[reader].seeds(Path(folder) / "made")}


class Wrong(Exception):
    """An input did what none may do."""


def used(reader: str, path: Path) -> str:
    """Do everything with a file: ``read``, or ``refused`` if something was; `Wrong` for another end."""
    ended = "read"
    for action in ALL[reader].uses(path):
        try:
            with np.errstate(all="ignore"):
                action()
        except FwclassError as fault:
            ended = "refused"
            cause: Any = fault
            while cause is not None:
                if isinstance(cause, MemoryError):
                    raise Wrong(f"memory ran out: {cause}") from fault
                cause = cause.__cause__
        except BaseException as fault:
            if isinstance(fault, KeyboardInterrupt | SystemExit):
                raise
            raise Wrong(f"{type(fault).__module__}.{type(fault).__name__}: {str(fault)[:300]}") from fault
    return ended
