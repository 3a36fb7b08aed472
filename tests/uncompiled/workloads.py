"""Small seeded work for the public functions of the numeric rooms, to be done with compiled kernels and without.

`WORK` names it. Every piece of work gets an empty directory and gives what it computed: arrays, numbers, tables, and
dictionaries, tuples and dataclasses of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import lasmaker
import modelmaker
import numpy as np
import plsmaker
import plzmaker
import shapely
import watermaker
import wavemaker
import woodmaker
from numpy.typing import NDArray
from streetmaker import with_features

from fwclass import conf
from fwclass.assess.distribution import distribution
from fwclass.classify.context import coarse_share_columns, context_of
from fwclass.classify.lines import settle_lines
from fwclass.classify.mean_field import agreed_shares
from fwclass.classify.stage import classify
from fwclass.classify.vote import walkable, winners
from fwclass.columns import FEATURES
from fwclass.conf.street import scanner
from fwclass.decompose.deconvolution import backscatter_samples
from fwclass.decompose.least_squares import evaluate, moments
from fwclass.decompose.matching import nearest_of_pulse, rank_in_pulse
from fwclass.decompose.params import DecomposeParams, SampleParams, StackParams
from fwclass.decompose.placement import AS_STORED
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.quiet import with_correlated_noise
from fwclass.decompose.shapes import lookup
from fwclass.decompose.stack_candidates import Surface, candidates
from fwclass.decompose.stacking import stack
from fwclass.decompose.stage import decompose
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.features.stage import features
from fwclass.formats.wkb import shapes
from fwclass.grid import Box, Tile, Window
from fwclass.ground.filters import FILTERS, ground_points
from fwclass.ground.measure import measure
from fwclass.ground.methods.noise import noise
from fwclass.ground.methods.params import NoiseParams
from fwclass.ground.params import GroundParams
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.terrain import terrain
from fwclass.ground.terrain.thinning import thin_points
from fwclass.ground.tin.tin import tin_of
from fwclass.label.polygons import Polygons, owners
from fwclass.label.stage import from_cloud
from fwclass.model import ClassDef
from fwclass.neighbours import nearest_within
from fwclass.publish.class_raster import class_rasters
from fwclass.publish.octree import octree
from fwclass.read.params import ReadParams
from fwclass.read.pls_waves import read_records
from fwclass.read.source import open_source
from fwclass.read.stage import index_source, read_span
from fwclass.read.text import read_text
from fwclass.schema import Table
from fwclass.simulate.flight import plan_strips
from fwclass.simulate.params import SimulateParams
from fwclass.simulate.stage import simulate_strip
from fwclass.stage import Chunk
from fwclass.street.params import StreetParams, StreetSceneParams
from fwclass.street.simulate import simulate_frames
from fwclass.street.track import Track
from fwclass.train.baselines.trees import pair_children
from fwclass.train.importance import drops
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import grow_trees, out_of_bag, train
from fwclass.units import METRES_PER_NS
from fwclass.vectors.cells import count_cells, count_passage
from fwclass.vectors.outline import fill_holes, rings, simplify, sound
from fwclass.vectors.trees import trees
from fwclass.view.blocks import block
from fwclass.view.pyramid import Pyramid, levels_of, order_blocks
from fwclass.voxels.traversal import follow

EAST, NORTH = 512_000.0, 5_403_200.0
ENDS = {"r": ("r150",), "c": ("c200",), "k": ("k7",), "g": ("g250",), "o": ("opt",)}
NAMES = tuple(f"{c.name}_{end}" for c in FEATURES for kind in c.scales for end in ENDS[kind]) + tuple(
    c.name for c in FEATURES if not c.scales
)
CLASSES = tuple(ClassDef(n, c, (c,)) for n, c in zip("xyz", (2, 5, 6), strict=True))

Answers = dict[str, NDArray[Any]]


def flat(found: Any, name: str = "") -> Answers:
    """The arrays and numbers in what a function gave, by their path in it."""
    if is_dataclass(found) and not isinstance(found, type) and not isinstance(found, Table):
        found = {f.name: getattr(found, f.name) for f in fields(found)}
    if isinstance(found, Table):
        found = {column: found[column] for column in found}
    if isinstance(found, dict):
        parts = found.items()
    elif isinstance(found, tuple | list):
        parts = enumerate(found)  # type: ignore[assignment]
    elif isinstance(found, np.ndarray | np.generic | int | float):
        return {name: np.asarray(found)}
    else:
        return {}
    return {k: v for key, part in parts for k, v in flat(part, f"{name}/{key}").items()}


def town(wide: float = 24.0, density: float = 2.0) -> tuple[NDArray, NDArray, NDArray]:
    """x, y, z [m] of a gentle slope with a house, a tree, and a point far below."""
    rng = np.random.default_rng(3)
    n = int(density * wide * wide)
    x, y = rng.uniform(0.5, wide - 0.5, (2, n)).round(3)
    z = 300.0 + 0.04 * x + np.sin(y / 20.0) + rng.normal(0.0, 0.02, n)
    z[(abs(x - 8.0) < 4.0) & (abs(y - 9.0) < 3.0)] = 306.0
    tree = np.hypot(x - 17.0, y - 16.0) < 3.0
    z[tree] += rng.uniform(0.0, 8.0, tree.sum())
    z[5] -= 30.0
    return EAST + x, NORTH + y, z.round(3)


def echoes(n: int = 160, wide: float = 6.0) -> Table:
    """Echoes of two strips, of pulses with up to three of them."""
    rng = np.random.default_rng(5)
    of = rng.integers(1, 4, n)
    pulse = np.repeat(np.arange(n), of)[:n]
    x, y = rng.uniform(0.0, wide, (2, n))
    z = np.where(rng.random(n) < 0.6, 0.1 * x, rng.uniform(0.0, 5.0, n))
    number = np.arange(n) - np.searchsorted(pulse, pulse) + 1
    return Table(
        {
            "strip": (pulse % 2).astype(int),
            "pulse": pulse,
            "gps_time": pulse * 1e-5,
            "echo_number": number,
            "number_of_echoes": of[pulse],
            "x": (EAST + x).round(3),
            "y": (NORTH + y).round(3),
            "z": (300.0 + z).round(3),
            "amplitude": np.where(rng.random(n) < 0.1, np.nan, rng.uniform(5, 200, n)),
            "width": rng.uniform(3, 7, n),
            "intensity": rng.integers(0, 65536, n),
        }
    )


def section(name: str, **changes: Any) -> dict[str, Any]:
    return {**conf.section(name).model_dump(), **changes}


def work_neighbours(_: Path) -> Any:
    x, y, z = town()
    apart = nearest_within((x + 0.3, y, z), (x, y, z), 2.0)
    rng = np.random.default_rng(1)
    crowd = tuple(rng.integers(0, 900, (3, 2300)) / 1000.0)
    return apart, nearest_within(tuple(v[:20] + 0.1 for v in crowd), crowd, 1.0)  # type: ignore[arg-type]


def work_features(_: Path) -> Any:
    params = conf.section("features").model_copy(
        update={
            "noise_counts": True,
            "optimal_radii": (0.5, 1.0),
            "nearest_reach": 3.0,
            "orientation_rounds": 2,
            "pulse_reach": 6.0,
        }
    )
    table = echoes()
    return features(Chunk(table, np.arange(0, table.rows, 3), Tile(0, 0, 1e7)), NAMES, params)


def work_features_of_one_scale(_: Path) -> Any:
    """What is summed without gathering neighbours, and squares that pass 2^53."""
    params, table = (
        conf.section("features").model_copy(update={"noise_counts": True, "orientation_rounds": 2}),
        echoes(),
    )
    chunk = Chunk(table, np.arange(0, table.rows, 3), Tile(0, 0, 1e7))
    wide = Table({**{n: table[n] for n in table}, "amplitude": table["amplitude"] * 1e6, "width": table["width"] * 1e6})
    return (
        features(chunk, ("planarity_r150", "amplitude_mean_r150", "ebi_r150"), params),
        features(chunk, ("height_std_c200", "width_std_c200"), params),
        features(replace(chunk, table=wide), ("amplitude_std_c150", "width_std_c300", "height_above_p50_c300"), params),
        features(replace(chunk, table=wide), ("width_std_c300",), params),
    )


def work_crowded_features(_: Path) -> Any:
    params = conf.section("features").model_copy(
        update={"noise_counts": True, "dense_echoes": 4, "orientation_rounds": 2}
    )
    table = echoes(120, 0.6)
    names = ("planarity_r70", "height_above_p50_c100", "oriented_inclination_r50", "count_g100")
    return features(Chunk(table, np.arange(0, table.rows, 4), Tile(0, 0, 1e7)), names, params)


def ground_by(method: str) -> Callable[[Path], Any]:
    def work(_: Path) -> Any:
        x, y, z = town()
        return ground_points(x, y, z, np.ones(len(x), bool), GroundParams(**section("ground", method=method)))

    return work


def work_noise_below_surfaces(_: Path) -> Any:
    x, y, z = town()
    z = z - np.where(np.arange(len(z)) % 200 == 0, 0.8, 0.0)  # too little for the rules of gaps
    return noise(x, y, z, np.ones(len(x), bool), NoiseParams(**{**section("ground")["noise"], "surface": True}))


def work_measure(_: Path) -> Any:
    x, y, z = town()
    return measure(x, y, z, np.ones(len(x), bool))


def terrain_by(height: str) -> Callable[[Path], Any]:
    def work(_: Path) -> Any:
        x, y, z = town()
        ground, noise = z < 302.5, z < 290.0
        core = Window(1.0, int(EAST), int(NORTH), 24, 20)
        params = TerrainParams(
            cell=1.0, thin=0.5, max_gap=12.0, dsm_gap=3.0, height=height, block=64.0, block_halo=16.0
        )
        return terrain(x, y, z, ground & ~noise, noise, core.box.contains(x, y), core, params)

    return work


def work_tin(_: Path) -> Any:
    rng = np.random.default_rng(2)
    x, y = np.concatenate([rng.integers(0, 9, (2, 60)) * 1.0, rng.uniform(0, 9, (2, 60)).round(3)], axis=1)
    mesh = tin_of(x, y, x + 2.0 * y).mesh
    return {
        "vertex": mesh.vertex[: int(mesh.state[0])],
        "x": mesh.x,
        "thin": thin_points(x, y, x, Window(1.0, 0, 0, 9, 9), 0.5),
    }


def rows(n: int = 240) -> Sample:
    rng = np.random.default_rng(6)
    y = rng.integers(0, 3, n).astype(np.uint8)
    X = np.stack([y + rng.normal(0, 0.7, n), rng.normal(size=n), rng.integers(0, 3, n)], axis=1).astype(np.float32)
    X[rng.random(n) < 0.05, 1] = np.nan
    key = np.arange(n, dtype=np.uint64)
    return Sample(tuple("abc"), X, y, key, key, np.bincount(y))


def work_bags_and_trees(_: Path) -> Any:
    sample = rows()
    made: list[Any] = []
    for split in ("equal-width", "exact", "histogram"):
        for criterion in ("entropy", "gini"):
            share = {"replacement": False, "bagging": 0.7} if criterion == "gini" else {}
            weights = {"class_weights": "balanced" if split == "exact" else "none"}
            params = TrainParams(**section("train", split=split, criterion=criterion, steps=20, **share, **weights))
            made.append(modelmaker.grow_tree(sample.X, sample.y, 3, 1, params))
            trees = grow_trees(sample, CLASSES, 0, 2, params)
            made.append((trees, out_of_bag(sample, trees, 3, params), drops(sample, trees, 0, params.drawing, 3)))
    return made


def work_votes(_: Path) -> Any:
    X = np.random.default_rng(7).normal(size=(70, 2)).astype(np.float32) * 2.0
    X[::9, 0] = np.nan
    return {name: classify(X, model, probabilities=True) for name, model in modelmaker.models().items()}


def work_forest(_: Path) -> Any:
    """Answers alone, for which rows stop asking once nothing can change them, and all votes."""
    sample, params = rows(), TrainParams(**section("train"))
    forest = train(sample, grow_trees(sample, CLASSES, 0, 12, params), params, CLASSES)
    return winners(sample.X, walkable(forest)), classify(sample.X, forest, probabilities=True)


def work_tree_of_many_values(_: Path) -> Any:
    """Nodes of many rows with few of the sample's values, which are sorted digit by digit."""
    sample = rows(1300)
    params = TrainParams(**section("train", split="exact", features_per_split="all", min_samples_split=90))
    return modelmaker.grow_tree(sample.X[:, :2].copy(), sample.y, 3, 0, params)


def work_paired_nodes(_: Path) -> Any:
    return pair_children(np.array([1, -1, 3, -1, -1]), np.array([2, -1, 4, -1, -1]))


def work_decompose(_: Path) -> Any:
    params, found = conf.section("decompose"), {}
    for name, (waves, _) in {
        "survey": wavemaker.survey_mix(25, seed=1),
        "hard": wavemaker.hard_mix(12, seed=2),
        "noise": wavemaker.noise_only(3, seed=3),
    }.items():
        found[name] = decompose(waves, 0, params, SystemPulse.gaussian(3.5))
    return found


def work_correlated_noise(_: Path) -> Any:
    params, noise = conf.section("decompose"), {"phi": (0.5,), "growth": 0.05}
    waves, _truth = wavemaker.survey_mix(60, seed=4, **noise)
    channel = Channel(1.0, 255.0, 10.0, 0.1, 1.5, 18.0, 255.0, (0.45, 0.02), 0.04, misfit=1.0)
    pulse = SystemPulse("gaussian", 3.5, channels=(channel,))
    return with_correlated_noise(pulse, waves, params), decompose(waves, 0, params, pulse)


def work_water(place: Path) -> Any:
    """Water from a file, its noise white and correlated; the last waveform is of land."""
    truth = watermaker.lake(place / "a.las", 3, samples=180, shore=0.3, depths=(2.0, 5.0))
    source, read = open_source(truth.path), conf.section("read")
    (span,) = index_source(source, read)
    waves, found = read_span(source, span, read), {}
    for name, phi in (("white", ()), ("coloured", (0.4, 0.05))):
        channel = Channel(1.0, 255.0, 12.0, 0.1, 1.2, 18.0, 255.0, phi, 0.02)
        pulse = SystemPulse("gaussian", 3.5, shape_error=0.01, channels=(channel,))
        bathymetry = conf.section("bathymetry")
        found[name] = decompose(waves, 0, conf.section("decompose"), pulse, bathymetry=bathymetry)
    return found


def work_estimated_pulse(_: Path) -> Any:
    waves, _truth = wavemaker.survey_mix(60, seed=4, pulse=wavemaker.skewed())
    pulse = estimate_pulse(waves, conf.section("pulse").model_copy(update={"min_echoes": 8}))
    few = wavemaker.rows_of(waves, np.arange(4))
    return pulse, decompose(few, 0, conf.section("decompose"), pulse)


def work_recovery(_: Path) -> Any:
    """Saturated waveforms of a receiver that swings below its level behind them; echoes so near to each other that
    the height of one is not known."""
    rng, t = np.random.default_rng(11), np.arange(70)
    near = rng.uniform(2.0, 7.0, (40, 3)).cumsum(axis=1) + 22.0
    height = rng.uniform(10.0, 500.0, (40, 3))
    shape = np.exp(-0.5 * ((t - near[:, :, None]) / (3.5 / wavemaker.FWHM)) ** 2)
    y = 25.0 + rng.normal(0.0, 1.0, (40, 70)) + (height[:, :, None] * shape).sum(axis=1)
    waves = wavemaker.waves_of(list(np.clip(np.rint(y), 0, 230).astype(np.uint8)))
    channel = Channel(1.0, 255.0, 25.0, 0.1, 1.0, 18.0, 230.0, recovery=15.0, recovery_depth=10.0, recovery_doubt=0.3)
    pulse = SystemPulse("gaussian", 3.5, channels=(channel,))
    return decompose(waves, 0, conf.section("decompose"), pulse)


def work_model_of_a_waveform(_: Path) -> Any:
    look = lookup(SystemPulse.gaussian(3.5), 1.0, 0.5, 3.0)
    size = 30 + look.before + look.after + 4
    weight, residual = np.ones(size), np.zeros(size)
    basis, window = np.empty((1, 3, look.table.shape[2])), np.zeros((1, 4), np.int64)
    p, y, pad = np.array([0.0, 5.0, 12.3, 1.2]), np.zeros(size), look.before + 2
    sums = moments(y, weight, pad, 30)
    return evaluate(p, 1, y, weight, pad, 30, look, sums, residual, basis, window), residual, window


def work_matching(_: Path) -> Any:
    rng = np.random.default_rng(8)
    pulse, xyz, found = np.sort(rng.integers(0, 9, 40)), rng.normal(size=(40, 3)), np.empty(40, np.int64)
    nearest_of_pulse(pulse, xyz, pulse[::2], xyz[::2] + 0.1, found)
    rank = np.empty(40, np.int64)
    rank_in_pulse(pulse, np.arange(40), rank)
    return found, rank


def work_labels(_: Path) -> Any:
    rng = np.random.default_rng(9)
    table = echoes(60)
    chunk = Chunk(table, np.arange(60), Tile(0, 0, 1e7))
    place = {n: table[n] + rng.normal(0, 0.1, 60) for n in "xyz"}
    cloud = Table({**place, "gps_time": table["gps_time"], "source_class": rng.integers(1, 7, 60)})
    holed = shapely.Polygon([(0, 0), (9, 0), (9, 9), (0, 9)], [[(3, 3), (6, 3), (6, 6), (3, 6)]])
    codes = np.array([2, 9, 6], np.int16)
    parts = [holed, shapely.box(3, 3, 5, 7), shapely.Point(8, 8).buffer(2)]
    polygons = Polygons.of(shapes([shapely.to_wkb(p) for p in parts], "here"), codes, codes, "here")
    return from_cloud(chunk, cloud, 1.0)[0], owners(*rng.integers(-900, 11_000, (2, 200)), polygons)


def work_histograms(_: Path) -> Any:
    rng = np.random.default_rng(10)
    values = {"zc": np.where(rng.random(80) < 0.3, 0.0, rng.gamma(2, 3, 80)), "z": rng.normal(0, 200, 80)}
    values["z"][::7] = np.nan
    return distribution(Table(values), rng.choice(np.array([0, 2, 5, 6], np.uint8), 80), CLASSES)


def work_highest_class(_: Path) -> Any:
    x, y, z = town()
    codes = np.random.default_rng(11).integers(0, 7, len(x)).astype(np.uint8)
    sure = np.random.default_rng(12).random(len(x)).astype(np.float32)
    return class_rasters(x, y, z, codes, sure, codes == 5, Window(1.0, int(EAST), int(NORTH), 24, 20))


def _read(path: Path, **changes: Any) -> Any:
    params, source = ReadParams(**section("read", **changes)), open_source(path)
    made = [read_span(source, span, params) for span in index_source(source, params)]
    return [getattr(one, "waves", one) for one in made]


def work_las(directory: Path) -> Any:
    return _read(lasmaker.survey(directory / "a.las", pulses=30).path, chunk_pulses=10)


def work_compressed_packets(directory: Path) -> Any:
    """Of 8 and of 16 bits, the latter with differences of more than 8."""
    told = [lasmaker.Descriptor(bits, 60, 1000, compression=1) for bits in (8, 16)]
    narrow, wide = (
        lasmaker.survey(directory / f"w{d.bits}.las", pulses=12, bits=d.bits, descriptors={1: d}).path for d in told
    )
    return [*_read(narrow), *_read(wide)]


def work_pulsewaves(directory: Path) -> Any:
    """Besides a file whose returning samples begin in the outgoing ones."""
    path = plsmaker.survey(directory / "together.pls", 24, bits=16, two_segments=0.0).path
    plsmaker.run_together(path)
    return [*_read(plsmaker.survey(directory / "a.pls", pulses=12).path), *_read(path)]


def work_compressed_pulsewaves(directory: Path) -> Any:
    """Pulses of both kinds of sources and other bytes behind them, in chunks of fixed and of varying size."""
    answers = []
    for source, chunk in ((16, 5), (32, [3, 9])):
        out = plsmaker.Sampling(plsmaker.OUTGOING, length_bits=0, samples=20, segment_bits=0, segments=1)
        kinds = {1: plsmaker.Descriptor([out, plsmaker.Sampling()], extra=2)}
        path = plsmaker.survey(directory / f"{source}.pls", pulses=12, extra_bytes=6, descriptors=kinds).path
        answers += _read(plzmaker.compress(path, kinds, chunk=chunk, source=source))
    wild = directory / "wild.pls"
    plsmaker.write_pls(wild, [plsmaker.Pulse((0, 0, 800), (0, 0, -1), [[]])] * 90)
    raw, rows = wild.read_bytes(), plzmaker.wild_records(90, 5).tobytes()
    wild.write_bytes(raw[: -len(rows)] + rows)
    packed = open_source(plzmaker.compress(wild, {}, waves=False))
    return [*answers, read_records(packed, 0, 90).view(np.uint8)]


def work_las_of_segments(directory: Path) -> Any:
    """Pulses of two packets, which are one pulse of two segments."""
    n, rng = 6, np.random.default_rng(12)
    pulse = np.repeat(np.arange(n), 2)
    path = lasmaker.write_las(
        directory / "a.las",
        np.c_[1000.0 + 0.4 * pulse, np.full(2 * n, 2000.0), 300.0 - np.tile([5.0, 60.0], n) * METRES_PER_NS],
        return_number=np.tile([1, 2], n),
        number_of_returns=np.full(2 * n, 2),
        pulse=np.arange(2 * n),
        location=np.full(2 * n, 5.0),
        step=np.tile([0.0, 0.0, METRES_PER_NS], (2 * n, 1)),
        gps_time=1000.0 + 1e-5 * pulse,
        waveforms=list(rng.integers(0, 255, (2 * n, 40))),
        descriptors={1: lasmaker.Descriptor(n_samples=40)},
    )
    return _read(path)


def work_text(directory: Path) -> Any:
    path = directory / "a.txt"
    path.write_text("\n".join(f"{k}.5   {2 * k}  \t{k / 7:.3f} {k % 2}" for k in range(12)))
    return read_text(path).xyz, read_text(path).label


def work_simulate(directory: Path) -> Any:
    """A strip over trees, of a receiver whose pulse has a tail and rings."""
    sensor = {**section("simulate")["sensor"], "skew": 0.8, "ringing": 0.05}
    for seed in (4, 5):
        changes = {"size": 60.0, "strips": 1, "pulse_density": 0.1, "seed": seed, "chunk": 64}
        params = SimulateParams(**section("simulate", **changes | ({"sensor": sensor} if seed == 5 else {})))
        (directory / str(seed)).mkdir()
        simulate_strip(params, plan_strips(params)[0], directory / str(seed))
    files = sorted(p for p in directory.rglob("*") if p.is_file())
    return {str(p.relative_to(directory)): np.frombuffer(p.read_bytes(), np.uint8) for p in files}


def work_ground_on_a_terrace(_: Path) -> Any:
    x, y, z = town()
    z = z + 2.5 * (x > EAST + 12.0)
    own = section("ground")["ptd"] | {"res": 5.0, "max_slope": 10.0}
    return ground_points(x, y, z, np.ones(len(x), bool), GroundParams(**section("ground", method="ptd", ptd=own)))


def work_stacking(_: Path) -> Any:
    """A wood of 5 x 5 pulses whose ground no single one shows."""
    waves, _ground = woodmaker.flown(100.0, 1.5, seed=1, side=5)
    heights, box = np.full((20, 20), 100.0, np.float32), Box(-5.0, -5.0, 10.0, 10.0)
    asked, fit = StackParams(**section("stack", threshold=2.0, max_false=1.0)), DecomposeParams(**section("decompose"))
    told = SystemPulse.gaussian(wavemaker.PULSE_WIDTH), AS_STORED
    found, _ = candidates(waves, 1, Surface(heights, Window(1.0, -10, -10, 20, 20)), box, asked, fit, *told)
    table, counts = stack(found, np.empty((0, 2)), box, 0.0, asked)
    return [*dict(table).values(), np.array(list(counts.values()))]


def work_deconvolution(_: Path) -> Any:
    waves, _ground = woodmaker.flown(100.0, 30.0, seed=2, side=3)
    pulse, fit = SystemPulse.gaussian(wavemaker.PULSE_WIDTH), DecomposeParams(**section("decompose"))
    answers = []
    for method in ("gold", "richardson-lucy"):
        asked = SampleParams(**section("samples", method=method, iterations=4))
        answers += list(dict(backscatter_samples(waves, 1, asked, fit, pulse, AS_STORED)[0]).values())
    return answers


def work_voxels(_: Path) -> Any:
    rng = np.random.default_rng(3)
    start, end = rng.uniform(0.0, 6.0, (9, 3)) + np.array([0.0, 0.0, 6.0]), rng.uniform(0.0, 6.0, (9, 3))
    end[0, :2] = start[0, :2]
    shares = np.stack([rng.uniform(0.0, 5.0, 9), np.ones(9)], axis=1)
    counts = [np.zeros((8, 6, 6), kind) for kind in (np.uint32, np.uint32, float, float)]
    follow(start, end, shares[:, 0].copy(), shares, np.arange(10), 1.0, 0.0, *counts)
    return counts


def work_context(_: Path) -> Any:
    """Boxes over voxels that are crowded, alone, and one above another."""
    rng = np.random.default_rng(11)
    places = rng.normal(0.0, 6.0, (3, 300))
    shares = {name: rng.integers(0, 256, 300).astype(np.uint8) for name in coarse_share_columns((2, 5, 6))}
    table = Table({**dict(zip("xyz", places, strict=True)), **shares})
    return context_of(table, np.arange(0, 300, 2), list(shares), (1.0, 3.0))


def work_mean_field(_: Path) -> Any:
    """Echoes of a lattice, many equally near, and strays."""
    rng = np.random.default_rng(12)
    place = np.concatenate([rng.integers(0, 20, (80, 3)) * 200, rng.integers(0, 60_000, (10, 3))])
    params = conf.section("classify", ("classify.regularize.strength=0.3", "classify.regularize.reach=2")).regularize
    return agreed_shares(place, rng.integers(0, 256, (90, 3)).astype(np.uint8), np.arange(0, 90, 2), params)


def work_lines(_: Path) -> Any:
    """Two wires and strays, of which some are sure."""
    rng = np.random.default_rng(14)
    along = np.arange(0.0, 40.0, 1.5)
    wires = [np.stack([along, np.full(len(along), side), np.full(len(along), 9.0)]) for side in (0.0, 1.0)]
    places = np.concatenate([*wires, rng.uniform(0, 40, (3, 60))], axis=1)
    table = Table(dict(zip("xyz", places, strict=True)) | {"echo_number": np.ones(places.shape[1], np.uint8)})
    own = rng.integers(0, 256, (table.rows, 2)).astype(np.uint8)
    lines = conf.section("classify", ("classify.lines.width=5",)).lines
    return settle_lines(table, np.arange(table.rows), own, own / 255.0, 0, lines)[0]


def work_octree(_: Path) -> Any:
    rng = np.random.default_rng(6)
    echoes = Table({"strip": np.ones(400), "pulse": np.arange(400), "echo_number": np.ones(400)})
    made = octree(rng.integers(-500, 500, (400, 3)), echoes, 20)
    return [made.low, made.order, made.keys, made.counts]


def work_outlines(_: Path) -> Any:
    mask = np.zeros((22, 22), bool)
    mask[2:20, 2:20] = np.random.default_rng(13).random((18, 18)) < 0.6
    some = [ring.astype(np.float64) for ring in rings(fill_holes(mask, 1))]
    plain = [ring[simplify(ring, tolerance)] for ring in some for tolerance in (0.5, 1.0, 3.0)]
    return [*plain, np.array([sound([ring]) for ring in plain])]


def work_trees(_: Path) -> Any:
    rng = np.random.default_rng(14)
    x, y = rng.uniform(0, 20, (2, 3000))
    far = np.minimum(np.hypot(x - 7, y - 7) / 4.5, np.hypot(x - 13, y - 13) / 4.0)
    height = np.where(far < 1, 10.0 - 4.0 * far**2 - rng.exponential(0.5, len(x)), 0.0)
    kinds = {"classification": np.where(far < 1, 5, 2), "confidence": rng.random(len(x)).astype(np.float32)}
    table = Table({"x": x, "y": y, "height_above_ground": height, **kinds})
    params, window = conf.section("vectors").trees, Window(0.5, 0, 0, 40, 40)
    passage = count_passage(table, np.ones(len(x), bool), window, params.codes, params.clear)
    made = trees(table, count_cells(table, window, params.codes, 0.0), passage, window, window, params)
    return [made.rows, made.corners]


def work_blocks_of_the_viewer(_: Path) -> Any:
    rng = np.random.default_rng(7)
    places = rng.uniform(0, 100, (3, 300))
    pyramid = Pyramid.over(np.array([[0, 0], [1, 1]]), 300, 50.0, 40, 300)
    order, nodes = order_blocks(
        pyramid, levels_of(pyramid, rng.integers(0, 2**64, 300, np.uint64)), places[0], places[1]
    )
    echoes = {
        **dict(zip("xyz", places, strict=True)),
        "classification": rng.integers(0, 256, 300).astype(np.uint8),
        "confidence": np.where(rng.random(300) < 0.1, np.nan, rng.random(300)).astype(np.float32),
        "height_above_ground": np.where(rng.random(300) < 0.1, np.nan, rng.uniform(-150, 700, 300)).astype(np.float32),
        "intensity": rng.integers(0, 65536, 300).astype(np.uint16),
    }
    packed = [block(pyramid, n, echoes, order[a:b], (0.0, 0.0, 0.0)) for n, (a, b) in nodes.items()]
    return [order, np.array(list(nodes)), np.frombuffer(b"".join(packed), np.uint8)]


def work_street(_: Path) -> Any:
    """A drive past trees by scanners that stand upright, lean, and see their own height."""
    scene = StreetSceneParams(**section("street_scene", length=5.0, speed=4.0, stops=0))
    base, answers = StreetParams(**section("street", speed=4.0, radii=[0.3, 0.8])), []
    own = scanner("utm-30lx").model_copy(update={"beams": 90, "step": 3.0, "first_angle": -135.0})
    for mounting in ({}, {"pitch": 20.0, "yaw": 5.0}):
        asked = base.model_copy(update={"mounting": base.mounting.model_copy(update=mounting)})
        track = Track(asked)
        frames = [f for f in map(track.take, islice(simulate_frames(scene, own, asked.mounting), 7)) if f is not None]
        assert track.geometry is not None
        answers += [
            part for one in with_features(frames, track.geometry, asked) for part in (one.frame.r, one.features)
        ]
    fast = StreetSceneParams(**section("street_scene", length=30.0, speed=40.0, stops=0))
    lit = [
        f.intensities
        for f in islice(simulate_frames(scene.model_copy(update={"intensity": 255.0}), own, base.mounting), 4)
    ]
    return answers + lit + [f.ranges for f in islice(simulate_frames(fast, own, base.mounting), 20)]


WORK: dict[str, Callable[[Path], Any]] = {
    **{name.removeprefix("work_"): value for name, value in list(globals().items()) if name.startswith("work_")},
    **{f"ground_{method}": ground_by(method) for method in FILTERS},
    **{f"terrain_{height}": terrain_by(height) for height in ("tin", "nearest", "raster")},
}
