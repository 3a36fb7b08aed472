"""Recordings and streams of frames, as `fwclass street` takes them."""

from __future__ import annotations

import zlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import modelmaker
import seeds
from cases import Case, given
from mutate import Files
from seeds import Seed

from fwclass.street.stream import HEAD, LIT, MAGIC

STREAM = "a.stream"


@cache
def _settings() -> tuple[str, ...]:
    return ("--set", "street.speed=1.0", "--set", "street.prescription.fewest=1", "--set", "street.stream.stall=0.5")


def _model(folder: Path) -> Files:
    """A forest that calls crown what lies high, by the features of frames."""
    from fwclass import conf
    from fwclass.graph.street import feature_parameters
    from fwclass.store.models import save_model
    from fwclass.street.ring import feature_names

    params = conf.load("street-sim").street
    forest = modelmaker.models()["forest"]
    card = modelmaker.card(features=list(feature_names(params)), computed=feature_parameters(params))
    save_model(folder / "m", replace(forest, card={k: v for k, v in card.items() if k != "preparation"}))
    return {f"m/{p.name}": p.read_bytes() for p in (folder / "m").iterdir()}


def stream(folder: Path) -> list[Case]:
    """Bytes of a socket, from standard input: damaged, and damaged with sums that fit."""
    model, frames = _model(folder), [s for s in seeds.frame_seeds(folder / "frames") if s.name.startswith("stream")]
    words = ("street", "run", "-", "--model", "m", "--out", "o", *_settings())
    cases = [replace(case, stdin=STREAM) for case in given(frames, *words, fixed=model)]
    return cases + [replace(c, seed=replace(c.seed, name="sealed"), sealed=_summed) for c in cases]


def _summed(files: Files) -> Files:
    """Every frame of the stream with the sum of what it holds now."""
    data, at = bytearray(files[STREAM]), 0
    while 0 <= (at := data.find(MAGIC[:3], at)) <= len(data) - HEAD.size:
        each = 8 if data.startswith(LIT, at) else 4
        end = at + HEAD.size + each * int.from_bytes(data[at + 4 : at + 8], "little")
        total = zlib.crc32(data[at + HEAD.size : end], zlib.crc32(data[at : at + HEAD.size - 4]))
        data[at + HEAD.size - 4 : at + HEAD.size] = total.to_bytes(4, "little")
        at += len(MAGIC)
    return {**files, STREAM: bytes(data)}


def recordings(folder: Path) -> list[Case]:
    """Files of frames: looked at, answered one by one, and in parts."""
    model = _model(folder)
    made: list[Seed] = [s for s in seeds.frame_seeds(folder / "frames") if not s.name.startswith("stream")]
    made += seeds.bag_seeds(folder / "bags")
    more = (*_settings(), "--model", "m")
    return [
        *given(made, "street", "info", "{}", *_settings(), mark="-info"),
        *given(made, "street", "run", "{}", *more, "--out", "o", fixed=model),
        *given(made, "street", "classify", "{}", "o", *more, "--workers", "0", fixed=model, mark="-classify"),
    ]
