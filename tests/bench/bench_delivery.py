"""Delivered echoes: COPC beside plain LAZ of the same records, Parquet with and without features, 10 000 tiles.

python tests/bench/bench_delivery.py RUN

RUN is a finished run; its Parquet tiles are written anew, each kind after the other in one process, three times; the
median counts. Processor time.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pyproj

from fwclass import conf
from fwclass.publish.copc import copc_columns, write_tile_copc
from fwclass.publish.geoparquet import round_floats, write_geoparquet
from fwclass.publish.laz import write_tile_laz
from fwclass.publish.params import PublishParams
from fwclass.publish.tile_facts import point_schema, tile_facts
from fwclass.publish.vpc import write_vpc
from fwclass.schema import Table, split_name

FIELDS = ("strip", "echo_number", "number_of_echoes", "x", "y", "z", "classification", "gps_time", "intensity")
CRS = pyproj.CRS(25832)


def took(work: Callable[[], Any]) -> tuple[float, Any]:
    began = time.process_time()
    made = work()
    return time.process_time() - began, made


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("run", type=Path)
    run = options.parse_args().run
    params = PublishParams(**conf.section("publish").model_dump())
    tables = []
    for path in sorted((run / "parquet").glob("*.parquet")):
        read = pq.read_table(path)
        tables.append(Table({n: read[n].to_numpy() for n in read.column_names if n not in ("geometry", "bbox")}))
    echoes = sum(t.rows for t in tables)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        write_tile_copc(tables[0], out / "warm.copc.laz", CRS, params, {})
        write_tile_laz(tables[0].select(FIELDS), out / "warm.laz", CRS, params)
        same = [t.select([n for n in t if n in FIELDS or n in copc_columns(t)]) for t in tables]
        rounds = []
        for _ in range(3):
            copc = [took(lambda t=t: write_tile_copc(t, out / "a.copc.laz", CRS, params, {})) for t in same]
            laz = [took(lambda t=t: write_tile_laz(t, out / "a.laz", CRS, params)) for t in same]
            rounds.append((sum(s for s, _ in copc), sum(s for s, _ in laz)))
        bytes_copc, bytes_laz = (sum(made["bytes"] for _, made in kind) for kind in (copc, laz))
        seconds, plain = (statistics.median(r[k] for r in rounds) for k in (0, 1))
        print(f"{echoes:,} echoes in {len(tables)} tiles")
        print(f"COPC      {bytes_copc / echoes:6.1f} bytes an echo, {bytes_copc / bytes_laz:.2f} x plain LAZ")
        print(f"          {echoes / seconds / 1e6:6.2f} M echoes per CPU-second, {seconds / plain:.2f} x its time")
        bare = [t.select([n for n in t if split_name(n)[1] is None and n != "zc"]) for t in tables]
        for title, some in (("all", tables), ("none", bare)):
            size = 0
            for table in some:
                small = round_floats(table, params.parquet_bits, ("range", "confidence"))
                size += write_geoparquet(small, out / "a.parquet", CRS, params)["bytes"]
            print(f"Parquet   {size / echoes:6.1f} bytes an echo, {len(some[0])} columns (features: {title})")
        facts, names = tile_facts(max(tables, key=lambda t: t.rows)), tuple(tables[0])
        many = {f"tiles/{5000 + k // 100}_{54000 + k % 100}.copc.laz": facts for k in range(10_000)}
        seen = dict.fromkeys(many, ("overviews/256_2701.copc.laz",))
        spent, made = took(lambda: write_vpc(many, out / "s.vpc", CRS, point_schema(names), seen, "overview.copc.laz"))
        print(f"survey.vpc of 10 000 tiles: {made['bytes'] / 1e6:.1f} MB in {spent:.1f} s")
    print(f"report.html: {(run / 'report.html').stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
