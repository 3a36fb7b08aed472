"""Voxels: beams followed by the kernel against the same reckoned by brute force, and laws of light."""

import numpy as np
import pytest

from fwclass import conf
from fwclass.errors import InputError
from fwclass.grid import Window
from fwclass.schema import Table
from fwclass.voxels.voxels import ECHOES_READ, voxels_of

WINDOW = Window(1.0, 0, 0, 20, 20)
NONE = Table.empty(("x", "y", "z", "returned_energy"))


def params(**changed):
    return conf.section("voxels", tuple(f"voxels.{k}={v}" for k, v in changed.items()))


def table(pulses):
    """`pulses`: (first place, beam, distances along it, energies, height of the last above ground)."""
    rows = []
    for k, (place, beam, along, energy, drop) in enumerate(pulses):
        beam = np.array(beam, float) / np.linalg.norm(beam)
        for m, (d, e) in enumerate(zip(along, energy, strict=True), 1):
            x, y, z = np.round(np.array(place) + d * beam, 3)
            hag = drop if m == len(along) else np.nan
            rows.append((x, y, z, 1, k, m, e, *beam, 0, False, hag))
    return Table(dict(zip(ECHOES_READ, map(np.array, zip(*rows, strict=True)), strict=True)))


def test_a_beam_straight_down():
    echoes = table([((5.5, 5.5, 12.5), (0, 0, -1), (0.0, 4.0), (30.0, 10.0), 3.5)])
    made, lattice = voxels_of(echoes, NONE, WINDOW, params(above=2.0), "")
    assert lattice.layer == 8 and lattice.shape == (5, 20, 20)  # from the lowest to the highest echo
    column = {n: v[:, 5, 5] for n, v in made.items()}
    assert column["passes"].tolist() == [1, 1, 1, 1, 1] and column["hits"].tolist() == [1, 0, 0, 0, 1]
    assert np.allclose(column["entering"], [0.25, 0.25, 0.25, 0.25, 1.0])
    assert np.allclose(column["intercepted"], [0.25, 0, 0, 0, 0.75])
    assert np.allclose(column["path"], [0.5, 1, 1, 1, 1])
    assert made["passes"].sum() == 5 and made["occluded"].sum() == 0  # the ground lies below the lowest voxel


def test_what_lies_behind_the_last_echo_is_occluded():
    hidden = ((5.5, 5.5, 12.5), (0, 0, -1), (0.0,), (30.0,), 6.0)
    ground = ((9.5, 5.5, 6.5), (0, 0, -1), (0.0,), (30.0,), 0.0)
    made, _ = voxels_of(table([hidden, ground]), NONE, WINDOW, params(above=3.0), "")
    assert made["occluded"][:, 5, 5].tolist() == [1, 1, 1, 1, 1, 1, 0]
    assert made["passes"][:, 5, 5].tolist() == [0, 0, 0, 0, 0, 0, 1]
    assert made["passes"][:, 5, 9].tolist() == [1, 1, 1, 1, 0, 0, 0]


@pytest.mark.statistics
def test_slanted_beams_against_small_steps():
    rng = np.random.default_rng(1)
    pulses = []
    for _ in range(60):
        along = np.sort(rng.uniform(0.0, 12.0, rng.integers(1, 4)))
        beam = (*rng.uniform(-0.6, 0.6, 2), -1.0)
        pulses.append(((*rng.uniform(2.0, 18.0, 2), 20.0), beam, along, rng.uniform(1, 9, len(along)), 2.0))
    echoes = table(pulses)
    made, lattice = voxels_of(echoes, NONE, WINDOW, params(above=4.0), "")
    path, passes = np.zeros(lattice.shape), np.zeros(lattice.shape, int)
    step = 0.0005
    for place, beam, along, _, _ in pulses:
        beam = np.array(beam) / np.linalg.norm(beam)
        begin = along[0] - 4.0 / -beam[2]
        s = np.arange(begin, along[-1], step) + 0.5 * step
        cell = np.floor(np.array(place) + s[:, None] * beam - (0, 0, lattice.layer)).astype(int)[:, ::-1]
        cell = cell[((cell >= 0) & (cell < lattice.shape)).all(axis=1)]
        np.add.at(path, tuple(cell.T), step)
        for one in np.unique(cell, axis=0):
            passes[tuple(one)] += 1
    assert np.abs(path - made["path"]).max() < 0.02  # places are whole millimetres
    assert (passes != made["passes"]).sum() <= 0.01 * (passes > 0).sum()  # corners cut by less than a millimetre
    assert (made["entering"] <= made["passes"] + 1e-4).all()
    assert made["intercepted"].sum() <= len(pulses) + 1e-4


def test_unsound_echoes_and_empty_blocks():
    echoes = table([((5.5, 5.5, 12.5), (0, 0, -1), (0.0,), (30.0,), 0.0)])
    assert voxels_of(echoes.with_columns({"noise": np.ones(1, bool)}), NONE, WINDOW, params(), "") is None
    assert voxels_of(echoes.with_columns({"fit_flags": np.full(1, 128)}), NONE, WINDOW, params(), "") is None
    assert voxels_of(echoes, NONE, Window(1.0, 100, 0, 5, 5), params(), "") is None
    blind = echoes.with_columns({f"beam_{a}": np.full(1, np.nan) for a in "xyz"})
    made, _ = voxels_of(blind, NONE, WINDOW, params(), "")
    assert made["hits"].sum() == 1 and made["passes"].sum() == 0


def test_too_many_voxels_are_refused():
    echoes = table([((5.5, 5.5, z), (0, 0, -1), (0.0,), (30.0,), 0.0) for z in (0.0, 9000.0)])
    with pytest.raises(InputError, match="too many voxels"):
        voxels_of(echoes, NONE, WINDOW, params(most=1_000_000), "tile")
