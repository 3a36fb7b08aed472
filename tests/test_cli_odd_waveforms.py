"""Waveforms that no fit can be right on: their echoes point down, their level was cut off, their times have another
unit. Each is told, and ends with exit code 4."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import rawmaker
from commandline import fwclass
from rawmaker import scene, write_csv, write_parquet

from fwclass.report import judge_echoes

HEAD = {"crs": "EPSG:32632", "spacing_ns": "1.0"}


def decompose(tmp_path: Path, columns: dict, *words: str, head: dict = HEAD) -> tuple[int, str]:
    write_parquet(tmp_path / "a.parquet", columns, head)
    ended = fwclass("decompose", tmp_path / "a.parquet", tmp_path / "a.laz", "--overwrite", *words)
    assert "Traceback" not in ended.stderr
    return ended.returncode, ended.stderr


def upside_down(columns: dict) -> dict:
    return columns | {"samples": [np.asarray(255 - s.astype(int), s.dtype) for s in columns["samples"]]}


def without_level(columns: dict) -> dict:
    return columns | {"samples": [np.maximum(s.astype(int) - 12, 0).astype(s.dtype) for s in columns["samples"]]}


def high_byte_first(columns: dict) -> dict:
    """As a receiver of 12 bits whose samples were written high byte first."""
    return columns | {"samples": [(7 * s.astype(np.uint16)).byteswap() for s in columns["samples"]]}


def every_sample_twice(columns: dict) -> dict:
    return columns | {"samples": [np.repeat(s[::2], 2) for s in columns["samples"]]}


def with_a_stuck_bit(columns: dict) -> dict:
    return columns | {"samples": [s | 8 for s in columns["samples"]]}


def begun_late(columns: dict) -> dict:
    """Every third record begins two to three samples behind its echo's peak."""
    late = np.where(np.arange(len(columns["begin_ns"])) % 3, 0, 28)
    samples = [s[k : len(s) - 28 + k] for s, k in zip(columns["samples"], late, strict=True)]
    return columns | {"samples": samples, "begin_ns": columns["begin_ns"] + late}


def in_picoseconds(columns: dict) -> dict:
    return columns | {"begin_ns": 1000 * columns["begin_ns"]}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, str]:
    """What is said of them as they should be."""
    return decompose(tmp_path_factory.mktemp("sound"), scene(pulses=600, n=80).columns(at="sensor"))


@pytest.mark.parametrize(
    ("change", "said", "fault"),
    [
        (upside_down, "have echoes that point down, and are not found", "waveforms have echoes that point down"),
        (without_level, "have more than a quarter of their samples at 0", "waveforms stand at 0"),
        (high_byte_first, "are smooth only with the two bytes", "waveforms have their samples' bytes exchanged"),
        (
            every_sample_twice,
            "600 of 600 waveforms (100.0 %) have every sample twice",
            "waveforms have every sample twice",
        ),
        (with_a_stuck_bit, "have a bit that never changes, though higher", "waveforms have a bit that never changes"),
        (begun_late, "begin behind the peak of an echo, which is lost", "waveforms begin behind the peak of an echo"),
        (in_picoseconds, "where no land is: are times in nanoseconds", "echoes are implausible"),
    ],
)
def test_it_is_told_and_ends_with_4(tmp_path: Path, sound: tuple[int, str], change, said: str, fault: str) -> None:
    columns = scene(pulses=600, n=80).columns(at="sensor")
    assert sound[0] == 0 and said not in sound[1], sound
    with mock.patch.object(judge_echoes, "judge_echoes", wraps=judge_echoes.judge_echoes) as judged:
        code, words = decompose(tmp_path, change(columns))
    assert code == 4 and said in words and f"more {fault} than a sound survey has" in words, words
    facts, bounds, where = judged.call_args.args
    judge_echoes.judge_echoes(facts, bounds.model_copy(update={"accept": True}), where)  # as --accept-implausible


@pytest.mark.parametrize(("turned", "code"), [(60, 4), (9, 0), pytest.param(0, 0, marks=pytest.mark.slow)])
def test_a_rare_channel_of_another_sign(tmp_path: Path, turned: int, code: int) -> None:
    """60 of 3 000 waveforms end with 4, 9 are told."""
    columns = scene(pulses=3000, n=80).columns(at="sensor")
    some = set(np.linspace(7, 2990, turned).astype(int).tolist())
    other = upside_down(columns)["samples"]
    mixed = [other[i] if i in some else s for i, s in enumerate(columns["samples"])]
    ended, words = decompose(tmp_path, columns | {"samples": mixed})
    assert ended == code and (f"{turned} of 3,000 waveforms" in words) == (turned > 0), words


def test_places_that_are_swapped_end_with_4(tmp_path: Path) -> None:
    columns = scene(pulses=600, n=80).columns()
    swapped = columns | {"x": columns["y"], "y": columns["x"], "dx": columns["dy"], "dy": columns["dx"]}
    code, words = decompose(tmp_path, swapped)
    assert code == 4 and "are x and y swapped" in words and "do not lie where" in words, words
    assert decompose(tmp_path, swapped, "--accept-implausible")[0] == 0


@pytest.mark.slow
def test_info_shows_what_is_odd(tmp_path: Path) -> None:
    columns = scene(pulses=600, n=80).columns(at="sensor")
    path = tmp_path / "a.parquet"
    line = ("info", path, "--waveforms", "--overwrite", "--out", tmp_path / "a.png")
    for change, said in ((dict, ""), (without_level, "a quarter of their samples at 0"), (upside_down, "point down")):
        write_parquet(path, change(columns), HEAD)
        ended = fwclass(*line)
        assert ended.returncode == (1 if change is upside_down else 0), ended.stderr
        words = ended.stdout + ended.stderr
        assert said in words and (said or "  ! " not in words), words
    assert "--pulse 0" in ended.stderr and fwclass(*line, "--pulse", 0).returncode == 0


def test_what_a_receiver_picks_up_is_told(tmp_path: Path) -> None:
    """A tone of 3 DN and 11 samples, in another phase in every waveform."""
    columns = scene(pulses=1500, n=120).columns(at="sensor")
    phase = np.random.default_rng(4).uniform(0, 2 * np.pi, len(columns["samples"]))
    tone = [3.0 * np.sin(2 * np.pi * np.arange(120) / 11 + p) for p in phase]
    hum = [np.rint(s + t).clip(0).astype(np.uint16) for s, t in zip(columns["samples"], tone, strict=True)]
    assert "comes back every" not in decompose(tmp_path, columns)[1]
    words = decompose(tmp_path, columns | {"samples": hum})[1]
    assert "of the noise's variance comes back every 11 samples" in words, words


def test_two_converters_in_turn_are_told(tmp_path: Path) -> None:
    """Every other sample is 3 DN higher."""
    columns = scene(pulses=1500, n=120).columns(at="sensor")
    words = decompose(tmp_path, columns | {"samples": [s + 3 * (np.arange(120) % 2) for s in columns["samples"]]})[1]
    assert "of the noise's variance comes back every 2 samples" in words, words


def test_volts_have_no_bytes_and_bits(tmp_path: Path) -> None:
    """An 8 bit digitiser's samples in volts: they were said to have their bytes exchanged, exit code 4."""
    columns = scene(pulses=600, n=80).columns(at="sensor")
    code, words = decompose(tmp_path, columns | {"samples": [0.0039 * s - 0.5 for s in columns["samples"]]})
    assert code == 0 and "plausibility" not in words, words


def test_noise_alone_is_none_of_it(tmp_path: Path) -> None:
    columns = scene(pulses=600, n=80).columns(at="sensor")
    noise = np.random.default_rng(2).normal(12.0, 1.0, (600, 80))
    code, words = decompose(tmp_path, columns | {"samples": list(np.rint(noise).astype(np.uint8))})
    assert code == 0 and "point down" not in words and "at 0" not in words, words


def test_a_pulse_narrower_than_its_samples_is_no_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rawmaker, "SIGMA", 0.7 / 2.354820045)
    truth = scene(pulses=600, spacing=2.0, n=80)
    code, words = decompose(tmp_path, truth.columns(), head={"crs": "EPSG:32632", "spacing_ns": "2.0"})
    assert code in (0, 4), words


@pytest.mark.parametrize(
    ("slip", "meant"), [("spacing", "spacing_ns"), ("sample_spacing", "spacing_ns"), ("srs", "crs")]
)
def test_a_slip_in_the_metadata_of_a_text_is_refused(tmp_path: Path, slip: str, meant: str) -> None:
    columns = scene(pulses=50, n=60).columns()
    write_csv(tmp_path / "a.csv", columns, {**HEAD, "made by": "nobody", slip: "2"})
    ended = fwclass("info", tmp_path / "a.csv")
    assert ended.returncode == 1 and f"write {meant}" in ended.stderr and "a.csv, line" in ended.stderr, ended.stderr


@pytest.mark.parametrize("pattern", ["a.parquet", "a.parq*"])
def test_a_ground_run_of_beams_measures_no_ranges(tmp_path: Path, pattern: str) -> None:
    write_parquet(tmp_path / "a.parquet", scene(pulses=400, n=80).columns(at="sensor"), HEAD)
    (tmp_path / "s.yaml").write_text(f'survey: {{name: s, sources: ["{pattern}"]}}\n')
    words = ("--workflow", "ground", "--workers", 0, "--accept-implausible")
    ended = fwclass("run", tmp_path / "s.yaml", "--out", tmp_path / "r", *words)
    assert ended.returncode == 0, ended.stderr
