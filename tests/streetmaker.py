"""A short simulated drive, a model trained on it, and the command line on both."""

import functools
import tempfile
from pathlib import Path

from fwclass import conf
from fwclass.conf.street import scanner
from fwclass.street.frames import Frame
from fwclass.street.ring import Ring
from fwclass.street.simulate import simulate_frames

SHORT = ("street_scene.length=5", "street_scene.speed=1.5", "street.speed=1.5")
QUICK = ("train.method=forest", "train.trees=10", "train.samples_per_class=1500")


def config(*settings):
    return conf.load("street-sim", (*SHORT, *QUICK, *settings))


@functools.cache
def drive() -> tuple[Frame, ...]:
    """Some 135 frames of 1 081 beams with labels, a stop among them."""
    made = config()
    return tuple(simulate_frames(made.street_scene, scanner(made.street.scanner), made.street.mounting))


@functools.cache
def directory() -> Path:
    """Holds drive.parquet and model/, a forest."""
    from fwclass.single_file.street.train import train
    from fwclass.street.recording_parquet import write_recording

    place = Path(tempfile.mkdtemp(prefix="fwclass-street-"))
    write_recording(place / "drive.parquet", drive())
    said = []
    made = config("street.split=random")
    train(made, place / "model", False, False, said.append, place)
    return place


def with_features(frames, geometry, params):
    """Every placed frame of a recording with its features, in order."""
    ring = Ring(geometry, params)
    for frame in frames:
        yield from ring.take(frame)
    yield from ring.rest()
