"""A delivery of many tiles, all with the echoes of one, moved and with pulses of their own: for the size of surveys."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyproj

from fwclass import conf
from fwclass.delivery.echoes import table_columns
from fwclass.delivery.opened import Delivery
from fwclass.formats.geoparquet import header
from fwclass.publish.copc import write_tile_copc
from fwclass.publish.geoparquet import about_delivery, write_geoparquet
from fwclass.publish.octree import echo_hashes
from fwclass.publish.tile_facts import point_schema, tile_facts
from fwclass.publish.vpc import write_vpc
from fwclass.schema import Table
from fwclass.store.atomic import file_digest
from fwclass.store.run_store import Store


def many_tiles(source: Delivery, root: Path, edge: int, echoes: int) -> Path:
    """A run directory `root` with `edge` x `edge` tiles and an overview of `echoes`; it has a delivery and no store."""
    params, grid = conf.load("demo", ()).publish, source.report["config"]["tile"]["size"]
    first = max(source.tiles, key=lambda t: t["echoes"])
    at = [int(v) for v in first["tile"].split("_")]
    path = source.path / "parquet" / f"{first['tile']}.parquet"
    names = [n for n in table_columns(path, source.echoes().columns) if n not in ("fit_flags",)]
    table, crs = Table(table_columns(path, names)), pyproj.CRS.from_epsg(25832)
    assert header(path)["crs"] is not None
    called = {int(c["code"]): c["name"] for c in source.report["classes"]}
    about, files, tiles, coarse = about_delivery(called, params.parquet_bits), {}, {}, []
    share = min(1.0, echoes / (table.rows * edge * edge))
    pulses, _ = int(table["pulse"].max()) + 1, (root / "made").mkdir(parents=True)
    for k in range(edge * edge):
        i, j = k % edge, k // edge
        moved = Table(
            {
                **dict(table),
                "x": table["x"] + i * grid,
                "y": table["y"] + j * grid,
                "pulse": (table["pulse"] + np.uint32(k * pulses)).astype(np.uint32),
            }
        )
        key = f"{at[0] + i}_{at[1] + j}"
        coarse.append(moved.take(echo_hashes(moved) <= np.uint64(min(share * 2.0**64, float(2**64 - 2048)))))
        out = root / "made" / f"{key}.parquet"
        write_geoparquet(moved, out, crs, params, about)
        files[f"parquet/{key}.parquet"] = out
        tiles[f"tiles/{key}.copc.laz"] = tile_facts(moved)
    write_vpc(tiles, root / "made" / "survey.vpc", crs, point_schema(names), overview="overview.copc.laz")
    files["laz/survey.vpc"] = root / "made" / "survey.vpc"
    write_tile_copc(Table.concat(coarse), root / "made" / "overview.copc.laz", crs, params, called)
    files["laz/overview.copc.laz"] = root / "made" / "overview.copc.laz"
    store = Store(root)
    (store.generations.pending / "report.json").write_text(json.dumps(source.report))
    store.generations.publish({n: (p, file_digest(p)) for n, p in files.items()}, True, 1)
    return root
