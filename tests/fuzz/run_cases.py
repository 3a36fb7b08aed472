"""Run directories that are damaged: their JSON, what their stages made, what was delivered."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from unittest import mock

import lasmaker
from cases import SURVEY, Case, patch
from commandline import fwclass
from mutate import FORGED, Field, Files
from seeds import Seed

from fwclass.store import arrays
from fwclass.store.atomic import bytes_digest
from fwclass.store.receipts import Receipt
from fwclass.store.seal import seal, unseal

Made = Callable[[Path], list[Case]]
GENERATION = "r/generations/0001"
LINKS = {"r/current": "generations/0001"}
ENDINGS = (".parquet", ".npy", ".copc.laz", ".vpc", ".tif")
FOOT = 300
"""Bytes at the end of a Parquet file in which its counts, sizes and places stand."""


@cache
def _ran(kind: str) -> Files:
    """The small survey, run into `r`; links of the run directory are left out. ``waved``: of waveforms, and
    ``grouped``: with its arrays in Zarr."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "c.yaml").write_text(SURVEY.replace("size: 20.0", "size: 5.0"))
        patch(folder) if kind == "run" else lasmaker.survey(folder / "a.las", pulses=60, n_samples=40, where="internal")
        small = 0 if kind == "grouped" else arrays.SMALL
        with mock.patch.object(arrays, "SMALL", small):  # in this process: what it loads, no input need load again
            ended = fwclass("run", "c.yaml", "--out", "r", "--workers", "0", cwd=folder)
        assert ended.returncode == 0, ended.stderr
        request = folder / "r" / "store" / "run.json"
        asked = unseal(json.loads(request.read_text()))
        request.write_text(json.dumps(seal({**asked, "conf": "c.yaml"})))
        kept = {}
        for base, _, names in os.walk(folder):
            for path in (Path(base) / n for n in names):
                below = path.relative_to(folder).as_posix()
                if below.startswith(("r/store/", "r/generations", "a.", "c.")) and not path.name.endswith("lock"):
                    kept[below] = path.read_bytes()
        return kept | {n: _timeless(data) for n, data in kept.items() if n.endswith("/receipt.json")}


def _timeless(receipt: bytes) -> bytes:
    """A receipt whose numbers stand where they stood in the last run."""
    known = Receipt.from_json(json.loads(receipt), "")
    return replace(known, seconds=0.0, peak_mib=0.0, keeping=0.0, cost={}).to_text().encode()


def _cases(files: Files, damaged: list[str], texts: list[str], words: tuple[str, ...], kind: str = "run") -> list[Case]:
    fields = tuple(
        Field(n, len(files[n]) - k, w)
        for n in damaged
        if n.endswith(".parquet")
        for k in (8, *range(12, min(FOOT, len(files[n])), 5))
        for w in (1, 4)
    )
    seed = Seed(kind, "r", {n: files[n] for n in dict.fromkeys(damaged)}, fields, tuple(texts))
    return [Case(seed, words, {n: d for n, d in files.items() if n not in seed.files}, links=LINKS)]


def documents(*words: str) -> Made:
    """A command on a run directory whose JSON files are damaged, also with seals that fit."""

    def cases(folder: Path) -> list[Case]:
        files = {n: d for n, d in _ran("run").items() if "generations" not in n}
        plain = [n for n in files if n.startswith("r/store/") and n.endswith((".json", ".jsonl"))]
        few = [n for n in plain if n.count("/") == 2] + plain[:: max(1, len(plain) // 40)]
        return _sealed([replace(c, links={}) for c in _cases(files, few, few, words)])

    return cases


def parts(*words: str, kinds: tuple[str, ...] = ("run",), also: str = "r/store/") -> Made:
    """A command on a run directory in which what stages made is damaged, or what `also` has; no chunk of Zarr, whose
    digest is all that keeps Blosc from reading where it says."""

    def cases(folder: Path) -> list[Case]:
        made = []
        for kind in kinds:
            files = _ran(kind)
            some = [n for n in files if n.startswith(("r/store/", also)) and n.endswith((*ENDINGS, "zarr.json"))]
            documents = [n for n in some if n.endswith("zarr.json")]
            made += _sealed(_cases(files, some, documents, words, kind), kind)
        return made

    return cases


def forged(*words: str) -> Made:
    """A command on a run directory whose receipts and tables say something else, with digests and seals that fit."""

    def cases(folder: Path) -> list[Case]:
        files = _ran("run")
        some = [
            n
            for n in files
            if n.startswith("r/store/") and n.count("/") > 3 and n.endswith(("receipt.json", ".parquet"))
        ]
        made = _cases(files, some, [], words, "forged")
        return [
            replace(c, seed=replace(c.seed, fields=(), texts=FORGED), sealed=partial(_resealed, "run")) for c in made
        ]

    return cases


def chunks(*words: str) -> Made:
    """A command on a run directory in which chunks of Zarr arrays are damaged, as disks do it: digests stay."""

    def cases(folder: Path) -> list[Case]:
        files = _ran("grouped")
        return _cases(files, [n for n in files if is_chunk(n)], [], words, "chunks")

    return cases


@cache
def _checked_out() -> Files:
    """The tiles of the run, checked out into `d`; one of them was saved with other classes, by another program."""
    import laspy
    from click.testing import CliRunner

    from fwclass.cli import cli

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, data in _ran("run").items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_bytes(data)
        (folder / "r" / "current").symlink_to(LINKS["r/current"])
        tiles = ",".join(sorted(p.name.split(".")[0] for p in (folder / "r/current/laz/tiles").iterdir()))
        words = ["label", "checkout", str(folder / "r"), str(folder / "d"), "--tiles", tiles]
        ended = CliRunner().invoke(cli, words)
        assert ended.exit_code == 0, ended.output
        path = folder / "d" / f"{tiles.split(',')[0]}.copc.laz"
        cloud = laspy.read(path, laz_backend=laspy.LazBackend.Laszip)
        plain = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
        plain.header.scales, plain.header.offsets = cloud.header.scales, cloud.header.offsets
        plain.header.add_extra_dims([laspy.ExtraBytesParams("pulse", "u4")])
        plain = laspy.LasData(plain.header)
        for field in ("X", "Y", "Z", "point_source_id", "return_number", "classification", "pulse"):
            plain[field] = cloud[field]
        plain.classification[:5] = 5
        path.unlink()
        plain.write(path, laz_backend=laspy.LazBackend.Lazrs)
        return {p.relative_to(folder).as_posix(): p.read_bytes() for p in (folder / "d").rglob("*") if p.is_file()}


def collected(*words: str) -> Made:
    """A command on tiles that were checked out, of which everything is damaged."""

    def cases(folder: Path) -> list[Case]:
        made = _checked_out()
        (case,) = _cases({**_ran("run"), **made}, sorted(made), ["d/checkout.json"], words, "checked-out")
        return [case]

    return cases


def is_chunk(name: str) -> bool:
    """Whether a file of a run holds a chunk of a Zarr array."""
    return ".zarr/" in name and not name.endswith("zarr.json")


def delivery(*words: str, beside: Files | None = None) -> Made:
    """A command on a run directory in which what was delivered is damaged; `beside` lies there too."""

    def cases(folder: Path) -> list[Case]:
        files = _ran("run")
        endings = (".parquet", ".copc.laz", ".json", ".gpkg", ".npy", ".tif")
        some = [n for n in files if n.startswith("r/generations/") and n.endswith(endings)]
        made = _sealed(_cases(files, some, [n for n in some if n.endswith(".json")], words))
        return [replace(c, fixed={**c.fixed, **(beside or {})}) for c in made]

    return cases


def _sealed(cases: list[Case], kind: str = "run") -> list[Case]:
    """Damaged, and damaged with digests that fit."""
    name = "sealed" if kind == "run" else f"{kind}-sealed"
    return cases + [replace(c, seed=replace(c.seed, name=name), sealed=partial(_resealed, kind)) for c in cases]


def _resealed(kind: str, damaged: Files) -> Files:
    """Damaged files, and receipts, manifest and seals as if they had been written so."""
    files = {**_ran(kind), **damaged}
    changed = {n for n, d in damaged.items() if d != _ran(kind).get(n)}
    receipts = [n for n in files if n.endswith("/receipt.json")]
    for name in [*receipts, f"{GENERATION}/manifest.json", f"{GENERATION}/generation.json", *changed]:
        with contextlib.suppress(ValueError, TypeError, KeyError, AttributeError, RecursionError):
            plain = {n: v for n, v in json.loads(files[name]).items() if n != "seal"}
            before = json.dumps(plain)
            folder = f"{Path(name).parent}/" + (f"{plain['key']}/" if name in receipts else "")
            outputs = plain.get("outputs" if name in receipts else "files")
            for n in {c.removeprefix(folder) for c in changed} & (
                outputs.keys() if isinstance(outputs, dict) else set()
            ):
                outputs[n] |= {"bytes": len(files[folder + n]), "digest": bytes_digest(files[folder + n])}
            if name.endswith("generation.json"):
                plain["manifest"] = bytes_digest(files[f"{GENERATION}/manifest.json"])
            if name in changed or json.dumps(plain) != before:
                files[name] = json.dumps(seal(plain) if b'"seal"' in files[name] else plain).encode()
                changed.add(name)
    return {n: files[n] for n in {*damaged, *changed}}
