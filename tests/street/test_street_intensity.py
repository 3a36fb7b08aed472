"""Intensities: through every door, into the features, and doubted where they are none."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from commandline import fwclass
from streetmaker import QUICK, SHORT, config, drive

from fwclass.cli.runner import open_runner
from fwclass.errors import ConfigError, InputError
from fwclass.graph.street import model_remarks, params_of
from fwclass.graph.street_recordings import open_recording
from fwclass.single_file.street import batch, online
from fwclass.single_file.street.info import info
from fwclass.single_file.street.train import train
from fwclass.store.models import load_model
from fwclass.street.answers import ANSWERS
from fwclass.street.frames import Scan
from fwclass.street.recording_parquet import write_recording
from fwclass.street.stream import Decoder, encode_frame
from fwclass.street.track import Track

FULL = 255.0
BRIGHT = ("street.split=random", f"street.intensity={FULL:g}")


@functools.cache
def lit_drive():
    """The short drive; crowns are bright, a little."""
    rng = np.random.default_rng(3)
    return tuple(
        replace(f, intensities=(rng.uniform(20, 140, len(f.ranges)) + 60 * (f.labels == 5)).astype(np.float32))
        for f in drive()
    )


@pytest.fixture(scope="module")
def lit(tmp_path_factory):
    """Holds drive.parquet with intensities, and model/, which learned by them."""
    place = tmp_path_factory.mktemp("lit")
    write_recording(place / "drive.parquet", lit_drive())
    summary = train(config(*BRIGHT), place / "model", False, True, [].append, place)
    return place, summary


def test_a_model_learns_by_intensities_and_decides_alike_on_line_and_whole(tmp_path, lit):
    place, summary = lit
    assert summary["accuracy"]["error"] < 0.02 and not summary["implausible"]
    made = config()  # the model's card tells that it takes intensities
    online.run(
        online.Run(str(place / "drive.parquet"), place / "model", tmp_path / "on", False, False), made.street, print
    )
    (tmp_path / "whole").mkdir()
    with open_runner(tmp_path / ".whole", 0, None, made.run) as runner:
        work = batch.Work(place / "drive.parquet", place / "model", made.street.model_copy(update={"chunk": 37}))
        batch.classify(work, tmp_path / "whole", runner, made)
    assert (tmp_path / "on" / ANSWERS).read_bytes() == (tmp_path / "whole" / ANSWERS).read_bytes()


def test_the_card_says_what_full_scale_was(lit):
    model, asked = load_model(lit[0] / "model"), config().street
    assert model.features[11:] == ("street_intensity_mean_r30", "street_intensity_deviation_r30")
    assert params_of(model, asked, "here").intensity == FULL
    assert not model_remarks(model, asked)
    other = config("street.intensity=65535").street
    assert params_of(model, other, "here").intensity == FULL
    assert model_remarks(model, other) == ["street.intensity is the model's, 255.0, not 65535.0"]


def test_a_card_that_tells_half_of_a_mounting_is_told_as_another(lit):
    model = load_model(lit[0] / "model")
    card = {**model.card, "computed": {**model.card["computed"], "mounting": {"height": 9.0}}}
    (said,) = model_remarks(replace(model, card=card), config().street)
    assert "height 9.0 there" in said and "side None there" in said


@pytest.mark.parametrize("settings", [None, [0.5], True, 0.5])
def test_a_card_without_settings_is_refused_and_remarked_on(lit, settings):
    model = load_model(lit[0] / "model")
    damaged = replace(model, card={**model.card, "computed": {"street": settings}})
    model_remarks(damaged, config().street)
    with pytest.raises(ConfigError, match="does not decide by features of frames"):
        params_of(damaged, config().street, "here")


def test_a_recording_without_them_is_refused_by_a_model_that_learned_by_them(tmp_path, lit):
    write_recording(tmp_path / "dark.parquet", drive()[:20])
    asked = online.Run(str(tmp_path / "dark.parquet"), lit[0] / "model", tmp_path / "out", False, False)
    with pytest.raises(InputError, match="no intensities"):
        online.run(asked, config().street, print)


def test_a_model_without_them_reads_the_same_recording(tmp_path, lit):
    from streetmaker import directory

    model = load_model(directory() / "model")
    assert params_of(model, config("street.intensity=255").street, "here").intensity is None
    bad = replace(model, card={**model.card, "computed": {"street": {"radii": [0.3], "intensity": 255.0}}})
    with pytest.raises(ConfigError, match="does not decide by features of frames"):
        params_of(bad, config().street, "here")


def test_intensities_come_through_parquet_and_stream(tmp_path):
    frames = list(lit_drive()[:5])
    frames[3] = replace(frames[3], intensities=None)
    write_recording(tmp_path / "a.parquet", frames)
    scan = Scan(1081, -2.356, 0.00436, 0.1, 30.0)
    read = list(open_recording(tmp_path / "a.parquet", scan).frames())
    streamed = list(Decoder(2000).feed(b"".join(map(encode_frame, frames))))
    for one, other, streamed_one in zip(frames, read, streamed, strict=True):
        if one.intensities is None:
            assert np.isnan(other.intensities).all() and streamed_one.intensities is None
        else:
            assert np.array_equal(one.intensities, other.intensities)
            assert np.array_equal(one.intensities, streamed_one.intensities)
        assert np.array_equal(one.ranges, streamed_one.ranges, equal_nan=True)


def test_a_frame_that_lacks_them_is_left_out_and_counted():
    frames = [replace(f, intensities=None) if k in (4, 7) else f for k, f in enumerate(lit_drive()[:12])]
    track = Track(config(*BRIGHT).street)
    assert sum(track.take(f) is not None for f in frames) == 10
    assert track.counts()["faults"]["no intensities"] == 2


def test_frames_without_them_are_left_out_alike_from_parquet_where_others_have_them(tmp_path):
    frames = [replace(f, intensities=None) if k in (4, 7) else f for k, f in enumerate(lit_drive()[:12])]
    blind = np.full(len(frames[0].ranges), np.nan, np.float32)
    frames[9] = replace(frames[9], ranges=blind, intensities=None)  # nothing is lost of it
    write_recording(tmp_path / "a.parquet", frames)
    scan = Scan(1081, -2.356, 0.00436, 0.1, 30.0)
    track, other = Track(config(*BRIGHT).street), Track(config(*BRIGHT).street)
    placed = [track.take(f) for f in open_recording(tmp_path / "a.parquet", scan).frames()]
    assert [k for k, one in enumerate(placed) if one is None] == [4, 7]
    assert [other.take(f) is None for f in frames] == [one is None for one in placed]
    assert track.counts()["faults"]["no intensities"] == 2 and placed[9].light.tolist() == [0] * 1081


def test_returns_without_one_are_told(tmp_path):
    frames = []
    for f in lit_drive()[:60]:
        light = f.intensities.copy()
        light[::20] = np.nan
        frames.append(replace(f, intensities=light))
    write_recording(tmp_path / "a.parquet", frames)
    told = info(tmp_path / "a.parquet", config(*BRIGHT).street)
    assert len([text for text in told["implausible"] if "of the returns have no intensity" in text]) == 1


@pytest.mark.parametrize(
    ("full", "words"), [(100.0, "are above street.intensity, 100"), (65535.0, "strongest is lower, or it tells none")]
)
def test_another_full_scale_is_told(tmp_path, full, words):
    write_recording(tmp_path / "a.parquet", lit_drive()[:60])
    told = info(tmp_path / "a.parquet", config(f"street.intensity={full:g}").street)
    assert len([text for text in told["implausible"] if words in text]) == 1
    assert not [t for t in info(tmp_path / "a.parquet", config(*BRIGHT).street)["implausible"] if "intensit" in t]


def test_a_list_of_another_length_is_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({"time": [0.0], "speed": [1.0], "ranges": [[1.0, 2.0, 3.0]], "intensities": [[1.0, 2.0]]})
    pq.write_table(table, tmp_path / "a.parquet")
    with pytest.raises(InputError, match="not one intensity for every beam"):
        list(open_recording(tmp_path / "a.parquet", Scan(3, -0.1, 0.1, 0.1, 30.0)).frames())


def test_a_frame_behind_the_begin_of_one_is_read():
    sent = encode_frame(lit_drive()[0])
    assert [f.number for f in Decoder(2000).feed(b"FWSFWS" + sent + b"FWS2" + sent)] == [0, 0]


@pytest.mark.slow
def test_a_simulated_street_with_intensities_goes_through_all_commands(tmp_path):
    sets = [w for s in (*SHORT, *QUICK, "street_scene.intensity=255", "street.split=random") for w in ("--set", s)]
    lit, ways = ("--set", "street.intensity=255"), []

    def done(*words):
        ended = fwclass("street", *words, *sets)
        assert ended.returncode == 0, ended.stderr
        return ended

    drive, model = tmp_path / "drive.parquet", tmp_path / "model"
    done("simulate", "--out", drive)
    assert not [line for line in done("info", drive, *lit).stdout.splitlines() if line.lstrip().startswith("!")]
    done("train", "street-sim", "--model", model, "--recordings", tmp_path, *lit)
    card = load_model(model).card
    assert card["computed"]["street"]["intensity"] == 255 and len(card["features"]) == 13
    smooth = ("--set", "street.smooth=0.3")
    for words in (("classify", drive, tmp_path / "a", "--workers", "0"), ("run", drive, "--out", tmp_path / "b")):
        done(*words, "--model", model, *smooth)
        ways.append((tmp_path / ("a" if words[0] == "classify" else "b") / ANSWERS).read_bytes())
    assert ways[0] == ways[1]
