"""A frame of a 2-D scanner: spheres and features beside a k-d tree, then the answer of an RBF SVM; one thread.

`python tests/bench/bench_street.py [--frames N] [--vectors N] [--answers] [--intensity] [--smooth RADIUS]`: processor
milliseconds a frame, as the machine may be busy; median, 99 % and 99.9 %. A simulated street at 1 m/s; 1 081 beams at
40 Hz, 541 at 50 Hz.

Spheres: ours with the eleven features; `cKDTree.query_ball_point` of the same frames, neighbour lists alone, and
whether its counts are ours. Answers: features and SVM of a frame as `fwclass street run` makes them, written to memory;
and scikit-learn's SVC of the same support vectors on the same rows.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import gc
import time
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from fwclass import conf
from fwclass.conf.street import scanner
from fwclass.graph.street import Rows, Split, fit_model, sample_of
from fwclass.model import class_index
from fwclass.single_file.street.online import Loop
from fwclass.street.answers import Writer
from fwclass.street.ring import Ring, feature_names
from fwclass.street.simulate import simulate_frames
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.track import Track

RADII = (0.1, 0.3, 0.5, 0.8)


def spread(values: list[float]) -> str:
    a = 1e3 * np.array(values)
    return f"median {np.median(a):6.2f}  99 % {np.percentile(a, 99):6.2f}  99.9 % {np.percentile(a, 99.9):6.2f} ms"


def drive(name: str, frames: int, extra: tuple[str, ...] = ()):
    config = conf.load("street-sim", (f"street.scanner={name}", "street_scene.stops=0", "street_scene.sway=0", *extra))
    sheet = scanner(name)
    scene = config.street_scene.model_copy(update={"length": frames * sheet.period * config.street_scene.speed})
    made = list(simulate_frames(scene, sheet, config.street.mounting))[:frames]
    if config.street.intensity is not None:
        random = np.random.default_rng(1)
        made = [replace(f, intensities=random.uniform(0, 255, len(f.ranges)).astype(np.float32)) for f in made]
    return config, made


def spheres(frames, config) -> None:
    print("spheres and features of a frame, beside cKDTree's neighbour lists")
    for radius in RADII:
        params = config.street.model_copy(update={"radii": (radius,)})
        track = Track(params)
        placed = [track.take(f) for f in frames]
        ring, ours, theirs, same = Ring(track.geometry, params), [], [], True
        held = []
        for k, one in enumerate(placed):
            held.append(one)
            begun = time.thread_time()
            seen = [(s.frame, s.features[:, 6].copy()) for s in ring.take(one)]
            took = time.thread_time() - begun
            ours += [took / len(seen)] * len(seen) if seen else []
            if k % 20 == 0 and seen and len(theirs) < 12:
                middle, counts = seen[-1]
                spent, equal = tree(held, middle, counts, radius)
                theirs.append(spent)
                same &= equal
        ratio = np.median(theirs) / np.median(ours[5:])
        print(
            f"  {radius:.1f} m  {spread(ours[5:])}   cKDTree {1e3 * np.median(theirs):7.1f} ms, {ratio:5.1f} times",
            end="",
        )
        print("   counts equal" if same else "   COUNTS DIFFER")


def tree(held, middle, counts, radius):
    near = [f for f in held if abs(f.place - middle.place) <= radius / UNIT]
    own = np.flatnonzero(~np.isnan(middle.r))

    def points(f):
        here = ~np.isnan(f.r)
        return np.stack([np.full(here.sum(), f.place - middle.place), f.y[here], f.z[here]], axis=1).astype(float)

    cloud, queries = np.concatenate([points(f) for f in near]), points(middle)
    begun = time.thread_time()
    lists = cKDTree(cloud).query_ball_point(queries, radius / UNIT)
    spent = time.thread_time() - begun
    return spent, bool((np.array([len(i) for i in lists]) == counts[own]).all())


def trained(frames, config, vectors: int):
    """An RBF SVM of the returns of every third frame, with at least so many support vectors."""
    params = config.street
    track = Track(params)
    ring, parts = None, []
    for f in frames:
        placed = track.take(f)
        ring = ring or Ring(track.geometry, params)
        for one in ring.take(placed):
            here = np.flatnonzero(~np.isnan(one.frame.r))
            key = np.uint64(one.frame.number) * np.uint64(65536) + here.astype(np.uint64)
            zero = np.zeros(len(here))
            parts.append(Rows(one.features[here].copy(), one.frame.labels[here], key, zero, zero))
    names, split = feature_names(params), Split("random", 0.2, 1, (), 0.0)
    model = None
    for c in (1.0, 0.3, 0.1, 0.03):  # the smaller, the more vectors
        rbf = config.compare.rbf_svm.model_copy(update={"c": (c,), "gamma": (1.0,), "max_rows": 16000})
        compare = config.compare.model_copy(update={"rbf_svm": rbf})
        sample = sample_of(parts[::3], names, split, config.classes, 8000)
        model = fit_model(sample, params, config.train, compare, config.classes)
        if len(model.vectors) >= vectors:
            break
    return model, parts


def answers(frames, config, vectors: int, title: str) -> None:
    model, parts = trained(frames[:300], config, vectors)
    loop, writer, spent = Loop(model, config.street), Writer(len(frames[0].ranges)), []
    gc.collect()
    gc.freeze()
    gc.disable()
    for frame in frames:
        begun = time.thread_time()
        given = [writer.frame(one) for one in loop.take(frame)]
        took = time.thread_time() - begun
        if given:
            spent.append(took)
    gc.enable()
    print(f"  {title}, {len(model.vectors)} support vectors: {spread(spent[10:])}")
    try:
        from sklearn.svm import SVC
    except ImportError:
        return
    rows = np.concatenate([p.X for p in parts[10:110:10]])
    codes = np.concatenate([p.codes for p in parts[10:110:10]])
    whole = SVC(C=1.0, gamma=1.0).fit(model.preparation(rows), class_index(codes, config.classes))
    some = replace_vectors(whole, model)
    ready = model.preparation(parts[50].X)
    begun = time.thread_time()
    for _ in range(5):
        some.predict(ready)
    print(f"    scikit-learn's SVC alone on a frame: {1e3 * (time.thread_time() - begun) / 5:6.1f} ms")


def replace_vectors(machine, model):
    """scikit-learn's machine with the support vectors of ours."""
    machine.support_vectors_ = np.ascontiguousarray(model.vectors)
    machine._dual_coef_ = machine.dual_coef_ = np.ascontiguousarray(model.dual)
    machine.support_ = np.arange(len(model.vectors), dtype=np.int32)
    machine._n_support = np.asarray(model.counts, np.int32)
    machine._intercept_ = np.asarray(model.bias, float)
    return machine


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--frames", type=int, default=1500)
    ask.add_argument("--vectors", type=int, default=900)
    ask.add_argument("--intensity", action="store_true", help="every return has an intensity, and features of it")
    ask.add_argument("--smooth", type=float, help="m, shares are averaged within")
    ask.add_argument("--answers", action="store_true", help="leave the spheres out")
    asked = ask.parse_args()
    extra: tuple[str, ...] = ("street.intensity=255",) if asked.intensity else ()
    extra += () if asked.smooth is None else (f"street.smooth={asked.smooth}",)
    config, frames = drive("utm-30lx", asked.frames, extra)
    returns = np.mean([np.isfinite(f.ranges).sum() for f in frames])
    print(f"{len(frames)} frames of 1081 beams, {returns:.0f} returns in each, 1 m/s")
    if not asked.answers:
        spheres(frames[:400], config)
    print("frame to answer: features and SVM")
    for radius in (0.3, 0.8):
        params = config.street.model_copy(update={"radii": (radius,)})
        answers(frames, replace(config, street=params), asked.vectors, f"1081 beams, {radius} m")
    config, frames = drive("lms1xx", asked.frames, extra)
    answers(frames, config, asked.vectors, "541 beams, 0.3 m")


if __name__ == "__main__":
    main()
