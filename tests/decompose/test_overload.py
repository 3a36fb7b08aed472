"""Echoes behind those that saturate are told where those that nearly do have fewer; what scenes make is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from commandline import fwclass
from rawmaker import HALF_LIGHT, SIGMA, scene, write_parquet

from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.overload import followed_echoes
from fwclass.decompose.placement import AS_STORED, Placement

LIMIT = 255.0


def fits(followed: float, usual: float = 0.3, n: int = 3000, seed: int = 0) -> Any:
    """Waveforms whose highest echo is 20 to 500 DN high, and of which another one follows these shares."""
    rng = np.random.default_rng(seed)
    height, time = np.exp(rng.uniform(np.log(20.0), np.log(500.0), n)), rng.uniform(20.0, 60.0, n)
    some = np.flatnonzero(rng.random(n) < np.where(height > LIMIT, followed, usual))
    row, time = np.append(np.arange(n), some), np.append(time, time[some] + rng.uniform(5.0, 60.0, len(some)))
    height = np.append(height, rng.uniform(4.0, 15.0, len(some)))
    order = rng.permutation(len(row))
    flags = np.where(height > LIMIT, SATURATED, 0).astype(np.uint8)
    return cast(Any, SimpleNamespace(row=row[order], time=time[order], amplitude=height[order], flags=flags[order]))


def test_more_echoes_behind_the_limit_than_before_it() -> None:
    behind, usual = followed_echoes(fits(0.8))
    assert behind == pytest.approx(0.8, abs=0.05) and usual == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize("followed", [0.0, 0.3, 0.4])
def test_what_scenes_make_is_not_told(followed: float) -> None:
    assert followed_echoes(fits(followed)) == (0.0, 0.0)


def test_few_waveforms_tell_nothing() -> None:
    assert followed_echoes(fits(0.9, n=60)) == (0.0, 0.0) == followed_echoes(fits(0.0, 0.0, n=0))


def test_placements_remember_it() -> None:
    kept = replace(AS_STORED, followed=(0.8, 0.3))
    assert Placement.from_json(kept.to_json()) == kept


@pytest.mark.parametrize("rings", [False, True])
def test_ringing_of_rare_saturated_echoes_is_told(tmp_path: Path, rings: bool) -> None:
    """One waveform in 25 saturates: too few for echoes that recur (`max_recurring`)."""
    truth = scene(pulses=2000, n=120)
    columns, t = truth.columns(at="sensor"), np.arange(120)
    centre = np.linalg.norm(truth.place - truth.first, axis=1) / HALF_LIGHT
    samples = np.stack(columns["samples"]).astype(np.float64)
    for k in range(0, 2000, 25):
        behind = t - centre[k]
        samples[k] += 700.0 * np.exp(-0.5 * (behind / SIGMA) ** 2)
        swing = 60.0 * np.sin(2.0 * np.pi * (behind - 6.0) / 40.0) * np.exp(-(behind - 6.0) / 25.0)
        samples[k] -= np.where(behind > 6.0, swing, 0.0) * rings
    whole = np.clip(np.rint(samples), 0, 255).astype(np.uint8)
    write_parquet(
        tmp_path / "a.parquet", columns | {"samples": list(whole)}, {"crs": "EPSG:32632", "spacing_ns": "1.0"}
    )
    ended = fwclass("decompose", tmp_path / "a.parquet", tmp_path / "a.laz")
    assert ended.returncode == 0, ended.stderr
    assert ("of the saturated ones" in ended.stderr) == rings, ended.stderr
