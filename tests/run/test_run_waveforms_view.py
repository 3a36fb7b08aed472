"""`fwclass info --waveforms`: what it chooses, what it counts, and that its answer does not depend on chunks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commandline import Ended, fwclass
from lasmaker import METRES_PER_NS, Descriptor, digitise, gaussian, write_las

from fwclass.errors import ConfigError, InputError
from fwclass.single_file.waveforms.shown import tie
from fwclass.single_file.waveforms.text import describe
from fwclass.single_file.waveforms.view import STRONGEST, look

SINGLES = 60
SATURATED, SEVERAL, EMPTY = SINGLES, SINGLES + 1, SINGLES + 2


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixty single echoes; one saturated; one of four echoes with three returns; one return without an echo."""
    rng = np.random.default_rng(3)
    singles = [[(20.0 + 2.0 * k, 40 + rng.random(), 3.5)] for k in range(SINGLES)]
    echoes = [*singles, [(400, 40, 3.5)], [(90, 40, 3.5), (60, 48, 3.5), (30, 60, 4), (12, 90, 4)], []]
    vendor = [[e[0][1]] for e in singles] + [[40.0], [40.0, 48.1, 60.0], [40.0]]
    waves = [digitise(gaussian(150, e, 10) + rng.normal(0, 1, 150)) for e in echoes]
    pulse = np.repeat(np.arange(len(vendor)), [len(v) for v in vendor])
    times = np.concatenate([np.array(v) for v in vendor])
    number = np.concatenate([np.arange(len(v)) + 1 for v in vendor])
    xyz = np.c_[5e5 + 0.5 * pulse, np.full(len(pulse), 5.4e6), 200 - times * METRES_PER_NS]
    return write_las(
        tmp_path_factory.mktemp("view") / "a.las",
        xyz,
        waveforms=waves,
        pulse=pulse,
        location=times,
        return_number=number,
        number_of_returns=np.array([len(v) for v in vendor])[pulse],
        descriptors={1: Descriptor(8, 150)},
        gps_time=1000 + pulse * 1e-5,
    )


def test_it_shows_what_a_user_wants_to_see(survey: Path, tmp_path: Path) -> None:
    found = look(survey, (), (), tmp_path / "a.png", False)
    why = {p["pulse"]: p["why"] for p in found["pulses"]}
    assert why[0].startswith("weakest single") and why[SINGLES - 1].startswith("brightest single")
    assert why[SATURATED].startswith("saturated") and why[EMPTY] == "kept without echo"
    assert why[SEVERAL].startswith("most echoes, echo the vendor lacks")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    several = next(p for p in found["pulses"] if p["pulse"] == SEVERAL)
    assert [e["return"] for e in several["echoes"]] == [1, 2, 3, None]
    assert np.allclose([e["time"] for e in several["echoes"]], [40, 48, 60, 90], atol=0.5)
    assert np.allclose([e["from_return"] for e in several["echoes"][:3]], [0, -0.1, 0], atol=0.2)
    saturated = next(p for p in found["pulses"] if p["pulse"] == SATURATED)
    assert "saturated" in saturated["echoes"][0]["flags"] and saturated["echoes"][0]["amplitude"] > 300
    assert next(p for p in found["pulses"] if p["pulse"] == EMPTY)["echoes"] == []


def test_echoes_that_the_vendor_lacks_are_counted(survey: Path, tmp_path: Path) -> None:
    found = look(survey, (), (), tmp_path / "a.png", False)
    assert found["waveforms"] == SINGLES + 3 and found["returns"] == SINGLES + 5
    missed = found["unexplained"]
    assert missed["count"] == found["echoes"] - (SINGLES + 4)
    best = missed["strongest"][0]
    assert best["pulse"] == SEVERAL and best["significance"] == pytest.approx(
        best["amplitude"] / best["amplitude_sigma"]
    )
    assert best["significance"] > 8 and best["nearest_return"] == pytest.approx(30, abs=0.5)
    text = describe(found)
    assert f"{missed['count']:,} echoes" in text and "NONE OF THE VENDOR'S" in text and "saturated" in text
    assert "no echo fitted; vendor returns at [ns]: 40.00" in text


@pytest.mark.slow
def test_the_answer_does_not_depend_on_chunks(survey: Path, tmp_path: Path) -> None:
    answers = []
    for k, size in enumerate((100_000, 7)):
        found = look(survey, (), (f"read.chunk_pulses={size}",), tmp_path / f"{k}.png", False)
        answers.append({**found, "png": "", "pulse_png": ""})
    assert answers[0] == answers[1]
    assert (tmp_path / "0.png").read_bytes() == (tmp_path / "1.png").read_bytes()


def test_chosen_pulses_come_in_the_order_asked_for(survey: Path, tmp_path: Path) -> None:
    all_of_it = look(survey, (), (), tmp_path / "a.png", False)
    found = look(survey, (SEVERAL, 3, SEVERAL, 0), ("read.chunk_pulses=7",), tmp_path / "b.png", False)
    assert [p["pulse"] for p in found["pulses"]] == [SEVERAL, 3, 0] and "unexplained" not in found
    for p in found["pulses"]:
        same = [q for q in all_of_it["pulses"] if q["pulse"] == p["pulse"]]
        assert all({**q, "why": ""} == p for q in same), "the fit of a pulse does not depend on which are looked at"


def test_refusals(survey: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such pulse") as fault:
        look(survey, (5, 63), (), tmp_path / "a.png", False)
    assert "0 to 62" in fault.value.expected
    (tmp_path / "there.png").write_bytes(b"old")
    with pytest.raises(ConfigError, match="the output exists"):
        look(survey, (), (), tmp_path / "there.png", False)
    assert look(survey, (1,), (), tmp_path / "there.png", True)["pulses"]
    with pytest.raises(ConfigError, match="PNG"):
        look(survey, (), (), tmp_path / "a.svg", False)
    with pytest.raises(ConfigError, match="directory does not exist"):
        look(survey, (), (), tmp_path / "no" / "a.png", False)
    plain = write_las(tmp_path / "plain.las", [[0, 0, 0]], point_format=6)
    with pytest.raises(InputError, match="no waveforms"):
        look(plain, (), (), tmp_path / "a.png", False)
    lost = write_las(tmp_path / "lost.las", [[0, 0, 0]] * 2, waveforms=[np.zeros(60, np.uint8)], pulse=[0, -1])
    with pytest.raises(InputError, match="pulse 1 has no waveform"):
        look(lost, (1,), (), tmp_path / "a.png", False)
    assert not (tmp_path / "a.png").exists()


def test_the_command(survey: Path, tmp_path: Path) -> None:
    def run(*words: object) -> Ended:
        return fwclass("info", *words, cwd=tmp_path)

    told = run("--waveforms", survey, "--json", "--pulse", f"3,{EMPTY}")
    assert told.returncode == 0, told.stderr
    assert [p["pulse"] for p in json.loads(told.stdout)["pulses"]] == [3, EMPTY]
    assert (tmp_path / "a-waveforms.png").exists()
    again = run("--waveforms", survey)
    assert again.returncode == 2 and "the output exists" in again.stderr and "Traceback" not in again.stderr
    assert run("--waveforms", survey, survey).returncode == 2
    assert run("--waveforms", survey, "--pulse", "three").returncode == 2
    assert run(survey, "--pulse", "3").returncode == 2
    assert "picture" in run("--waveforms", survey, "--overwrite").stdout


@pytest.mark.parametrize("seed", range(30))
def test_tying_takes_the_likeliest_pair_first(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, r = rng.integers(0, 25, 2)
    pulse, back = np.sort(rng.integers(0, 6, m)), rng.integers(0, 6, r)
    time, location = rng.uniform(0, 20, m), rng.uniform(0, 20, r)
    height = rng.uniform(1, 100, m)
    matched, gap = tie(pulse, time, height, back, location, 5.0)
    wanted = np.full(m, -1)
    pairs = sorted((abs(time[i] - location[j]), i, j) for i in range(m) for j in range(r) if pulse[i] == back[j])
    for apart, i, j in sorted(pairs, key=lambda p: -height[p[1]] * np.exp(-0.5 * p[0] ** 2)):
        if apart <= 5.0 and wanted[i] < 0 and j not in wanted:
            wanted[i] = j
    assert np.array_equal(matched, wanted)
    for i in range(m):
        assert gap[i] == min((p[0] for p in pairs if p[1] == i), default=np.inf)


def test_a_cropped_pulse_is_not_held_against_the_vendor(tmp_path: Path) -> None:
    """Its first return was cut away; the vendor had it."""
    rng = np.random.default_rng(2)
    waves = [digitise(gaussian(90, [(150, 20, 3.5), (80, 60, 3.5)], 10) + rng.normal(0, 1, 90)) for _ in range(2)]
    source = write_las(
        tmp_path / "c.las",
        [[0, 0, 0], [1, 0, 0]],
        waveforms=waves,
        pulse=[0, 1],
        location=60.0,
        return_number=[2, 1],
        number_of_returns=[2, 1],
        descriptors={1: Descriptor(8, 90)},
        gps_time=[1.0, 2.0],
    )
    found = look(source, (), (), tmp_path / "a.png", False)
    assert found["unexplained"]["count"] == 1 and found["unexplained"]["incomplete_pulses"] == 1
    assert found["unexplained"]["strongest"][0]["pulse"] == 1
    text = describe(look(source, (0, 1), (), tmp_path / "b.png", False))
    assert text.count("none in the file") == 1 and text.count("NONE OF THE VENDOR'S") == 1


def test_of_two_echoes_at_a_return_the_higher_is_the_vendor_s() -> None:
    none, one = np.zeros(2, np.int64), np.zeros(1, np.int64)
    assert tie(none, np.array([17.0, 17.2]), np.array([3.0, 160.0]), one, np.array([17.0]), 5.0)[0].tolist() == [-1, 0]
    far = tie(none, np.array([40.0, 43.0]), np.array([100.0, 90.0]), one, np.array([43.1]), 5.0)[0]
    assert far.tolist() == [-1, 0], "but not the higher one at any distance"


def test_the_list_of_missed_echoes_is_short(survey: Path, tmp_path: Path) -> None:
    """The most significant come first, and no more than a screenful."""
    rng = np.random.default_rng(1)
    heights = rng.permutation(np.linspace(15, 120, 40))
    waves = [digitise(gaussian(90, [(150, 20, 3.5), (a, 60, 3.5)], 10) + rng.normal(0, 1, 90)) for a in heights]
    source = write_las(
        tmp_path / "m.las",
        np.c_[5e5 + np.arange(40), np.full(40, 5.4e6), np.full(40, 200.0)],
        waveforms=waves,
        pulse=np.arange(40),
        location=20.0,
        descriptors={1: Descriptor(8, 90)},
        gps_time=1000.0 + np.arange(40),
    )
    missed = look(source, (), ("read.chunk_pulses=9",), tmp_path / "a.png", False)["unexplained"]
    assert missed["count"] == 40 and len(missed["strongest"]) == STRONGEST
    order = [row["significance"] for row in missed["strongest"]]
    assert order == sorted(order, reverse=True)
    strongest = {row["pulse"] for row in missed["strongest"]}
    assert strongest >= set(np.argsort(-heights)[:15].tolist())
