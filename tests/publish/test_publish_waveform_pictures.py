"""Pictures of waveforms: they can be drawn whatever the pulse looks like, and the same arrays give the same bytes."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from fwclass.publish import waveform_pictures
from fwclass.publish.wave_picture import WavePicture
from fwclass.publish.waveform_pictures import draw_pulse, draw_waveforms


def picture(n: int = 60, echoes: int = 2, returns: int = 1, **changed: Any) -> WavePicture:
    rng = np.random.default_rng(n + echoes)
    time, fine = np.arange(n, dtype=float), np.append(np.arange(max(8 * n - 7, 0)) / 8, np.nan)
    at = 10.0 + 12.0 * np.arange(echoes)

    def curve(t: np.ndarray) -> np.ndarray:
        return 10.0 + 80.0 * np.exp(-0.5 * ((t - at[:, None]) / 1.5) ** 2)

    model = curve(time).sum(axis=0) - 10.0 * (echoes - 1)
    fields: dict[str, Any] = {
        "title": "pulse 7, GPS time 1000.000007 s, misfit 1.02",
        "subtitle": "most echoes; noise 0.90 DN",
        "time": time,
        "samples": np.rint(model + rng.normal(0, 1, n)),
        "clipped": np.zeros(n, bool),
        "model": model,
        "sigma": np.ones(n),
        "fine": fine,
        "total": curve(fine).sum(axis=0) - 10.0 * (echoes - 1),
        "curves": curve(fine),
        "echoes": at,
        "heights": np.full(echoes, 90.0),
        "new": np.arange(echoes) >= returns,
        "vendor": at[:returns] + 0.1,
    }
    return WavePicture(**{**fields, **changed})


def pixels(png: bytes) -> np.ndarray:
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    return np.asarray(imread(io.BytesIO(png)))


def count(image: np.ndarray, colour: str) -> int:
    """Pixels of a colour, about."""
    rgb = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    return int((np.abs(image[..., :3] - rgb).max(axis=-1) < 0.05).sum())


def test_the_same_arrays_give_the_same_bytes() -> None:
    pulses = [picture(), picture(echoes=1)]
    assert draw_waveforms(pulses, "a") == draw_waveforms(pulses, "a")
    assert draw_waveforms(pulses, "a") != draw_waveforms(pulses[::-1], "a")


@pytest.mark.parametrize("n", [1, 5, 13, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 3, 4, 6, 7))])
def test_every_panel_has_its_place(n: int) -> None:
    """A picture grows by rows of panels; none is drawn over another."""
    image = pixels(draw_waveforms([picture(seed) for seed in range(40, 40 + n)], "pulses"))
    one = pixels(draw_waveforms([picture()], "pulses"))
    ink = count(image, waveform_pictures.SUM)
    assert ink > 0.5 * n * count(one, waveform_pictures.SUM)
    assert (image[:2] == 1).all() and (image[:, -2:] == 1).all(), "nothing is cut off at the edges"


def test_echoes_without_a_return_look_different() -> None:
    none, some = (pixels(draw_waveforms([picture(echoes=3, returns=r)], "p")) for r in (3, 1))
    keys = count(pixels(draw_waveforms([picture(echoes=0, returns=0)], "p")), waveform_pictures.NEW)
    assert count(none, waveform_pictures.NEW) <= keys < count(some, waveform_pictures.NEW)
    assert count(none, waveform_pictures.VENDOR) > count(some, waveform_pictures.VENDOR) > 0


@pytest.mark.parametrize(
    "odd",
    [
        picture(echoes=0, returns=0),
        picture(echoes=0, returns=1, vendor=np.array([5.0])),
        picture(clipped=np.ones(60, bool)),
        picture(samples=np.full(60, 255.0)),
        picture(sigma=np.full(60, np.nan)),
        picture(model=np.full(60, np.nan), total=np.full(474, np.nan), curves=np.full((2, 474), np.nan)),
        picture(n=1, echoes=0, returns=0),
        picture(n=1, echoes=1),
        picture(n=0, echoes=0, returns=0),
        picture(n=20_000, echoes=2),
        picture(vendor=np.array([-4000.0, 1e9])),
    ],
)
def test_odd_pulses_are_drawn_too(odd: WavePicture) -> None:
    image = pixels(draw_waveforms([odd, picture()], "odd"))
    assert image.shape[0] < 1000 and count(image, waveform_pictures.SUM) > 100


def test_a_long_waveform_is_drawn_where_its_echoes_are() -> None:
    low, high = waveform_pictures._view(picture(n=20_000))
    assert low < 10 and 22 < high < 100
    assert waveform_pictures._view(picture(n=60))[1] > 59


def test_the_system_pulse() -> None:
    time = np.arange(-10, 30, 0.1)
    gaussian = np.exp(-0.5 * (time / 1.5) ** 2)
    tail = gaussian + 0.03 * np.exp(-0.5 * ((time - 9) / 2) ** 2)
    made = draw_pulse(time, tail, gaussian, "System's pulse")
    assert made == draw_pulse(time, tail, gaussian, "System's pulse")
    left, right = np.split(pixels(made)[:, :1140], 2, axis=1)
    rows = [
        np.flatnonzero((np.abs(h[..., :3] - [0, 0x72 / 255, 0xB2 / 255]).max(axis=-1) < 0.05).any(axis=1))
        for h in (left, right)
    ]
    assert (
        count(left, waveform_pictures.SUM) > 300
        and count(right, waveform_pictures.SUM) > 300
        and all(len(r) for r in rows)
    )
    assert pixels(draw_pulse(time[:0], time[:0], time[:0], "nothing")).size
