"""Shares that are averaged over the returns around: the same bytes everywhere, the mean of a k-d tree, fewer errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from streetmaker import config, directory, drive

from fwclass.cli.runner import open_runner
from fwclass.graph.street_answers import Answering, halo
from fwclass.single_file.street import batch, online
from fwclass.single_file.street.train import train
from fwclass.store.models import load_model
from fwclass.street.answers import ANSWERS
from fwclass.street.smoothing import Smoother
from fwclass.street.sphere_kernels import LEVELS, UNIT
from fwclass.street.track import Track

SMOOTH = ("street.smooth=0.3",)
TURNED = {"mounting.yaw": 12, "mounting.pitch": -5}


def placed(params, first=40, last=80):
    track = Track(params)
    frames = [track.take(f) for f in drive()[first:last]]
    return [f for f in frames if f is not None], track.geometry


def given_back(frames, geometry, params, shares, radius=0.3):
    smoother = Smoother(geometry, params, radius, shares.shape[2])
    for frame, share in zip(frames, shares, strict=True):
        yield from ((one.frame, one.features.copy()) for one in smoother.put(frame, share))
    yield from ((one.frame, one.features.copy()) for one in smoother.rest())


@pytest.mark.statistics
@pytest.mark.parametrize("turned", [{}, TURNED])
def test_shares_are_the_means_of_the_sphere(turned):
    params = config(*(f"street.{k}={v}" for k, v in turned.items())).street
    frames, geometry = placed(params)
    shares = np.random.default_rng(1).dirichlet([1.0, 2.0, 0.5], (len(frames), geometry.scan.beams))
    here = [~np.isnan(f.r) for f in frames]
    places = np.concatenate(
        [
            np.stack([f.place + (f.x if len(f.x) else 0 * f.y), f.y, f.z], axis=1)[h]
            for f, h in zip(frames, here, strict=True)
        ]
    )
    level = np.rint(np.concatenate([s[h, 0] for s, h in zip(shares, here, strict=True)]) * (LEVELS - 1))
    some = slice(None, None, 7)  # a Python list of each one's neighbours takes seconds
    near = cKDTree(places.astype(float)).query_ball_point(places[some].astype(float), 0.3 / UNIT)
    mean = np.array([level[i].mean() for i in near]) / (LEVELS - 1)
    got = list(given_back(frames, geometry, params, shares))
    assert [f.number for f, _ in got] == [f.number for f in frames]
    values = np.concatenate([v[h] for (_, v), h in zip(got, here, strict=True)])
    np.testing.assert_allclose(values[some, 0], mean, atol=1e-6)
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-6)
    own = np.concatenate([s[h] for s, h in zip(shares, here, strict=True)])
    np.testing.assert_allclose(values[:, 1] * own[:, 2], values[:, 2] * own[:, 1], atol=1e-5)


def test_a_return_alone_keeps_its_shares():
    params = config().street
    frames, geometry = placed(params, 40, 44)
    one = np.zeros(geometry.scan.beams, bool)
    one[np.flatnonzero(~np.isnan(frames[0].r))[0]] = True
    r = np.where(one, frames[0].r, np.nan).astype(np.float32)
    shares = np.broadcast_to([0.25, 0.75], (1, len(r), 2))
    ((_, values),) = given_back([replace(frames[0], r=r)], geometry, params, shares, 0.02)
    np.testing.assert_allclose(values[one], [[0.25, 0.75]], atol=0.5 / LEVELS)


def smoothed_online(tmp_path, settings):
    asked = online.Run(str(directory() / "drive.parquet"), directory() / "model", tmp_path / "on", False, False)
    return online.run(asked, config(*settings).street, print), (tmp_path / "on" / ANSWERS).read_bytes()


WAYS = [
    ({}, ((50, 0),)),
    pytest.param(TURNED, ((37, 0), (400, 0)), marks=pytest.mark.slow),
    pytest.param({}, ((50, 2),), marks=pytest.mark.slow),  # workers give the same bytes: `test_street_online.py`
]


@pytest.mark.parametrize(("turned", "ways"), WAYS)
def test_online_and_whole_give_the_same_bytes(tmp_path, turned, ways):
    settings = (*SMOOTH, "street.most_frames=20", *(f"street.{k}={v}" for k, v in turned.items()))
    told, there = smoothed_online(tmp_path, settings)
    for chunk, workers in ways:
        made, target = config(*settings, f"street.chunk={chunk}"), tmp_path / f"c{chunk}"
        target.mkdir()
        with open_runner(tmp_path / f".c{chunk}", workers, None, made.run) as runner:
            work = batch.Work(directory() / "drive.parquet", directory() / "model", made.street)
            whole = batch.classify(work, target, runner, made)
        assert (target / ANSWERS).read_bytes() == there
        assert whole["neighbourhood"] == told["neighbourhood"] and whole["drift"] == told["drift"]


def test_averages_that_most_frames_cut_are_counted_alike(tmp_path):
    """Frames that are cut for averages wider than the features' spheres went uncounted."""
    settings = ("street.most_frames=10", "street.chunk=37")
    plain, smooth = (
        Answering(load_model(directory() / "model"), config(*settings, *more).street, placed(config().street)[1])
        for more in ((), ("street.smooth=1.2",))
    )
    frames, _ = placed(config().street, 0, 40)
    for one in (plain, smooth):
        for frame in frames:
            list(one.take(frame))
        list(one.rest())
    assert plain.cut < smooth.cut and plain.most <= smooth.most == 21
    parts = []
    for first, last in ((0, 13), (13, 40)):
        low = max(0, first - halo(smooth.params))
        part = Answering(smooth.model, smooth.params, smooth.geometry, range(first - low, last - low))
        for frame in frames[low : last + halo(smooth.params)]:
            list(part.take(frame))
        list(part.rest())
        parts.append(part)
    assert sum(p.cut for p in parts) == smooth.cut and max(p.most for p in parts) == smooth.most


def test_training_judges_what_is_answered_and_fewer_returns_are_wrong(tmp_path):
    figures = {}
    for smooth in ("null", "0.3"):
        made = config(
            "street.split=stretch", "areas.train=[[0,-40,2.5,40]]", "areas.gap=0.3", f"street.smooth={smooth}"
        )
        summary = train(made, tmp_path / f"m{smooth}", False, True, [].append, directory())
        figures[smooth] = summary["accuracy"]
    assert figures["0.3"]["rows"] == figures["null"]["rows"]
    assert figures["0.3"]["error"] < figures["null"]["error"]


def test_a_smoothed_answer_waits_for_more_frames_and_not_for_more_than_its_halo():
    params, plain = config(*SMOOTH).street, config().street
    assert halo(params) == 2 * halo(plain)
    frames, geometry = placed(params)
    model = load_model(directory() / "model")
    waits = []
    for asked in (plain, params):
        answering = Answering(model, asked, geometry)
        waits.append(next(k for k, f in enumerate(frames) if list(answering.take(f))))
    assert waits[0] < waits[1] <= halo(params)
