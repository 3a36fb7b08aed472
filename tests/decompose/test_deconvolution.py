"""Waveforms freed of the pulse: energy kept, layers parted, samples in their place."""

import numpy as np
import pytest
import wavemaker as wm
from woodmaker import SIDE, flown

from fwclass import conf
from fwclass.decompose.deconvolution import backscatter_samples, join_samples, pulse_at_samples
from fwclass.decompose.placement import AS_STORED
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.schema import Table

FIT = conf.section("decompose", ())
PULSE = SystemPulse.gaussian(wm.PULSE_WIDTH)
AREA = wm.PULSE_WIDTH / wm.FWHM * np.sqrt(2.0 * np.pi)


def params(**changed):
    return conf.section("samples", tuple(f"samples.{k}={v}" for k, v in changed.items()))


@pytest.fixture(scope="module")
def wood():
    return flown(100.0, 30.0, seed=3)[0]


@pytest.mark.parametrize(("method", "excess"), [("richardson-lucy", 0.06), ("gold", 0.12)])
def test_energy_stays_and_lies_where_it_came_from(wood, method, excess):
    table, facts = backscatter_samples(wood, 1, params(method=method), FIT, PULSE, AS_STORED)
    true = (60.0 + 45.0) * AREA * SIDE**2
    assert 0.98 < facts["energy"] / true < 1.0 + excess and facts["dropped"] < 0.06 * facts["energy"]
    ground = np.abs(table["z"] - 100.0) < 2.0
    energy = table["returned_energy"].astype(float)
    assert energy[ground].sum() / energy.sum() == pytest.approx(45.0 / 105.0, abs=0.01)
    middle = (energy * table["z"])[ground].sum() / energy[ground].sum()
    assert middle == pytest.approx(100.0, abs=0.005)
    spread = np.sqrt((energy * (table["z"] - middle) ** 2)[ground].sum() / energy[ground].sum())
    assert spread < 0.75 * wm.PULSE_WIDTH / wm.FWHM * wm.METRES_PER_NS
    shares = np.bincount(table["pulse"], weights=table["share"])
    assert np.allclose(shares, 1.0, atol=1e-5)


def test_noise_has_no_samples():
    waves, _ = wm.noise_only(2000, seed=4)
    table, facts = backscatter_samples(waves, 1, params(threshold=4.5), FIT, PULSE, AS_STORED)
    assert len(np.unique(table["pulse"])) < 10 and facts["energy"] < 1000.0


def test_two_layers_that_one_pulse_joins_are_parted():
    time = np.tile([20.0, 24.0], (400, 1))
    waves, _ = wm.simulate(
        np.full((400, 2), 80.0), time, np.full((400, 2), wm.PULSE_WIDTH / wm.FWHM), noise=1.0, seed=5
    )
    table, _ = backscatter_samples(waves, 1, params(iterations=100), FIT, PULSE, AS_STORED)
    energy = np.bincount(table["sample"], weights=table["returned_energy"], minlength=48)
    recorded = np.bincount(np.tile(np.arange(72), 400), weights=waves.samples.astype(float) - 10.0)
    assert energy[22] < 0.35 * min(energy[20], energy[24]) and recorded[22] > 0.75 * recorded[20]


def test_the_pulse_at_samples():
    h, before = pulse_at_samples(PULSE, 1.0)
    assert h[before] == 1.0 and h.sum() == pytest.approx(AREA, rel=0.01)
    h, before = pulse_at_samples(SystemPulse.gaussian(2.0), 2.0)
    assert h[before] == 1.0 and len(h) >= 3


def test_chunks_in_one_order(wood):
    table, _ = backscatter_samples(wood, 1, params(), FIT, PULSE, AS_STORED)
    rng = np.random.default_rng(1)
    parts = np.array_split(rng.permutation(table.rows), 3)
    again = join_samples([table.take(p) for p in parts])
    assert all(np.array_equal(again[n], table[n]) for n in ("pulse", "sample", "z"))
    assert join_samples([]).rows == 0 and isinstance(join_samples([]), Table)
