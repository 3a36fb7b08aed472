"""A plan is held against what it plans: laws of spreading, a real run's receipts, and a survey of 10 000 km²."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pyogrio
import pytest
from runmaker import SETTINGS

from fwclass import conf
from fwclass.errors import ConfigError, InputError
from fwclass.grid import Box, TileGrid
from fwclass.operate.estimate.amounts import amounts
from fwclass.operate.estimate.costs import costs_of_survey
from fwclass.operate.estimate.estimate import choices, estimate_run, propose_size
from fwclass.operate.estimate.forecast import make_forecast
from fwclass.operate.estimate.headers import facts_of, sample_points, survey_facts
from fwclass.operate.estimate.limits import Room, limits, refuse, room_at
from fwclass.operate.estimate.measured import WHOLE, measure_costs
from fwclass.operate.estimate.output import write_plan
from fwclass.operate.estimate.spread import Spread
from fwclass.read.source import las_of, open_source
from fwclass.store.run_store import Store
from fwclass.workflows import workflow_of

begin = workflow_of("classification").begin

ROOM = Room(16_000.0, 1e12)
SCALE = Path(__file__).with_name("planning_scale.py")


def pieces(seed: int) -> list[tuple[Box, float]]:
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(20):
        x, y = rng.uniform(-300, 300, 2)
        made.append((Box(x, y, x + rng.uniform(0.001, 200), y + rng.uniform(1, 200)), float(rng.integers(1, 1000))))
    return made


@pytest.mark.parametrize("size", [7.0, 50.0, 333.0])
def test_no_echo_is_lost_or_made_whatever_the_tiles(size: float) -> None:
    spread = Spread.of(pieces(1), size)
    assert spread.counts.sum() == pytest.approx(sum(n for _, n in pieces(1)))
    assert 0 < spread.number <= (spread.counts > 0).sum()


@pytest.mark.parametrize("number", [1, 2, 300, 3000])
def test_echoes_fewer_than_tiles_lie_in_as_many_as_chance_gives_them(number: int, tmp_path: Path) -> None:
    spread = Spread.of([(Box(0, 0, 1000, 1000), float(number))], 50.0)
    rng = np.random.default_rng(number)
    occupied = [len({tuple(t) for t in rng.integers(0, 20, (number, 2)).tolist()}) for _ in range(200)]
    assert spread.number == pytest.approx(np.mean(occupied), rel=0.02, abs=0.5)
    xyz = np.column_stack([rng.uniform(0, 1000, (max(number, 2), 2)), np.zeros(max(number, 2))])
    cloud(tmp_path / "few.las", xyz)
    survey = tmp_path / "few.yaml"
    survey.write_text("survey: {name: few, sources: [few.las], crs: 'EPSG:2154'}")
    begun = workflow_of("ground").begin(conf.load(survey, classifies=False))
    plan = make_forecast(begun, survey_facts(begun.config, tmp_path), 1, room_at(tmp_path))
    assert min(choice.tiles for choice in plan.choices) > 0
    assert all(path.exists() for path in write_plan(plan, tmp_path / "plan"))


def test_echoes_lie_in_the_tiles_where_uniform_points_would() -> None:
    made = pieces(2)
    spread, rng = Spread.of(made, 40.0), np.random.default_rng(0)
    counted = np.zeros_like(spread.counts)
    for box, number in made:
        x, y = rng.uniform(box.xmin, box.xmax, 20_000), rng.uniform(box.ymin, box.ymax, 20_000)
        i, j = (np.searchsorted(n, np.floor(v / 40)) for n, v in ((spread.cols, x), (spread.rows, y)))
        np.add.at(counted, (i, j), number / 20_000)
    assert np.abs(counted - spread.counts).max() < 0.05 * spread.counts.max()


@pytest.mark.parametrize("halo", [0.0, 3.0, 10.0, 14.0, 35.0])
def test_a_halo_of_even_ground_is_its_area(halo: float) -> None:
    spread = Spread.of([(Box(-100, -100, 100, 100), 40_000.0)], 10.0)
    inside = spread.grown(halo)[8:12, 8:12]
    assert inside == pytest.approx(np.full((4, 4), (10 + 2 * halo) ** 2))
    corner = min(halo, 100)
    assert spread.grown(halo)[0, 0] == pytest.approx((10 + corner) ** 2)


def test_the_heaviest_tile_comes_first() -> None:
    spread = Spread.of([(Box(0, 0, 10, 10), 5.0), (Box(20, -10, 30, 0), 9.0), (Box(50, 50, 60, 60), 0.2)], 10.0)
    assert [t.key for t in spread.heaviest(5)] == ["2_-1", "0_0"]


def test_stray_points_do_not_take_all_memory() -> None:
    with pytest.raises(ConfigError, match="too many tiles"):
        Spread.of([(Box(0, 0, 1e7, 1e7), 5.0)], 1.0)


def cloud(path: Path, xyz: np.ndarray, returns: int = 1) -> Path:
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales, las.header.offsets = [0.001] * 3, [0.0] * 3
    las.x, las.y, las.z = xyz.T
    las.number_of_returns = np.full(len(xyz), returns)
    las.return_number = np.arange(len(xyz)) % returns + 1
    las.write(path)
    return path


def test_a_sample_sees_that_a_strip_does_not_fill_its_bounds(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    along, across = np.sort(rng.uniform(0, 1000, 60_000)), rng.uniform(-50, 50, 60_000)
    slant = np.c_[(along + across) * 0.7071, (along - across) * 0.7071, np.zeros(60_000)]
    told = sample_points(las_of(open_source(cloud(tmp_path / "slant.las", slant, 3))), 20_000)
    assert told.points == 20_000 and told.returns_per_pulse == pytest.approx(3.0)
    assert told.density == pytest.approx(0.6, rel=0.15)  # 60 000 points on 1000 m x 100 m
    assert told.crowding == pytest.approx(0.6 / told.even, rel=0.15) and told.crowding > 4


def test_points_in_no_order_tell_nothing_of_density(tmp_path: Path) -> None:
    xyz = np.random.default_rng(0).uniform(0, 100, (50_000, 3))
    assert sample_points(las_of(open_source(cloud(tmp_path / "a.las", xyz))), 5_000).crowding == 1.0


def test_points_on_the_last_tiles_edge_are_planned_as_the_run_has_them(tmp_path: Path) -> None:
    """Coordinates in steps of 0.01 m, cut with both edges: those on the north and east edge are the next tiles'."""
    xyz = np.random.default_rng(0).uniform(0, 100, (200_000, 3))
    lasmaker.write_las(tmp_path / "a.las", np.round(xyz, 2), point_format=6, scale=0.01)
    source = las_of(open_source(tmp_path / "a.las"))
    spread = Spread.of([(facts_of(source).bounds, float(source.n_points))], 50.0)
    x, y, _ = np.round(xyz, 2).T
    tiles = TileGrid(50.0).keys(x, y)
    assert len(tiles) > 4 and {f"{t.ix}_{t.iy}" for t in spread.squares()} - {"2_2"} == set(tiles) - {"2_2"}


def test_a_header_without_bounds_is_told(tmp_path: Path) -> None:
    source = open_source(cloud(tmp_path / "a.las", np.random.default_rng(0).uniform(0, 10, (50, 3))))
    broken = replace(source, bounds=(np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf))
    with pytest.raises(InputError, match="does not say where"):
        facts_of(broken)


@pytest.fixture(scope="module")
def walked(survey: Path, finished: tuple[Path, dict]):
    """The small survey's plan by the receipts of its whole run, the run's store and its report."""
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}"))
    root, report = finished
    return make_forecast(begin(config), survey_facts(config, root), 0, room_at(root), Store(root)), Store(root), report


@pytest.mark.slow
def test_what_the_headers_tell_is_what_the_run_finds(walked) -> None:
    plan, _, report = walked
    counts = report["counts"]
    assert plan.counts.points.sum() == counts["returns"]
    assert plan.counts.pulses.sum() == pytest.approx(counts["pulses"], rel=0.03)
    assert plan.counts.echoes.sum() == pytest.approx(counts["echoes_decomposed"], rel=0.1)
    assert plan.tiles.number == pytest.approx(counts["tiles"], abs=2)
    assert {s.name for s in plan.estimate.stages} <= {s["name"] for s in report["stages"]} | {"pulse", "index"}


def test_every_stage_of_a_run_is_planned(walked) -> None:
    plan, _, report = walked
    assert {s["name"] for s in report["stages"]} == {s.name for s in plan.estimate.stages}
    assert plan.estimate.unknown == ()


def test_a_second_layer_that_is_tried_is_planned_as_one_that_is_used_by_its_own_trees(walked) -> None:
    plan, _, _ = walked

    def planned(cells: str) -> dict:
        more = ("train.trees=100", "classify.context.trees=8", f"classify.context.cells={cells}")
        config = conf.load("demo", (*SETTINGS, f"survey.directory={plan.config.survey.directory}", *more))
        return amounts(begin(config), plan.facts, config.tile.size)

    tried, used = planned("auto"), planned("[0.5, 1.0, 2.5, 5.0]")
    assert tried == used and {"fold-shares", "context-sample", "first-shares"} <= set(tried)
    rows = tried["trees"].units / 100
    assert {tried[n].units for n in ("fold-models", "context-folds")} == {5 * 8 * rows}


def test_parts_are_as_many_as_the_run_had(walked) -> None:
    plan, _, report = walked
    parts = {s["name"]: s["parts"] for s in report["stages"]}
    for stage in plan.estimate.stages:
        assert stage.amount.parts == pytest.approx(parts[stage.name], rel=0.5, abs=5), stage.name


def test_measured_costs_give_the_measured_time_and_disk_back(walked) -> None:
    """Times are set, as those of parts this small are mostly the machine's: 3 ms and 20 µs an echo."""
    plan, store, _ = walked
    ran = [s.memory_mib for s in plan.estimate.stages if s.name in plan.measured.stages and s.name not in WHOLE]
    assert set(plan.measured.stages) >= {"tile", "features", "classify", "publish-tile", "terrain"}
    assert max(ran) == pytest.approx(plan.measured.peak_mib) and plan.measured.peak_mib > 100
    echoes = {r.part: r.meta["rows"] for r in store.receipts("tile")}

    class Timed(Store):
        def receipts(self, stage):
            return (replace(r, seconds=3e-3 + 20e-6 * echoes.get(r.part, 0)) for r in super().receipts(stage))

    config = plan.config
    costs = {n: c.model_copy(update={"part": 3.0}) for n, c in config.plan.stages.items()}
    timed = Timed(store.root)
    costs = measure_costs(timed, costs, amounts(begin(config), plan.facts, config.tile.size)).costs
    made = {s.name: s for s in estimate_run(begin(config), plan.facts, config.tile.size, 2, costs).stages}
    for name in ("tile", "radiometry", "publish-tile"):
        assert costs[name].each == pytest.approx(20.0, abs=0.01), name
        assert made[name].seconds == pytest.approx(sum(r.seconds for r in timed.receipts(name)), rel=0.1), name
    for name in ("features", "publish-tile"):
        written = sum(o["bytes"] for r in store.receipts(name) for o in r.outputs.values())
        assert made[name].bytes == pytest.approx(written, rel=0.2), name


def test_a_stage_that_took_twice_as_long_costs_twice_as_much(walked) -> None:
    plan, store, _ = walked
    config = plan.config
    base = {n: c.model_copy(update={"part": 0.0}) for n, c in config.plan.stages.items()}
    made = amounts(begin(config), plan.facts, config.tile.size)
    once = measure_costs(store, base, made)

    class Slow(Store):
        def receipts(self, stage):
            return (replace(r, seconds=2 * r.seconds) for r in super().receipts(stage))

    twice = measure_costs(Slow(store.root), base, made)
    assert twice.seconds == pytest.approx(2 * once.seconds)
    for name in once.stages:
        assert twice.costs[name].each == pytest.approx(2 * once.costs[name].each, abs=0.002)


def test_what_a_tile_reads_around_it_is_not_written_again(walked) -> None:
    plan, _, _ = walked
    costs = costs_of_survey(plan.begun, plan.facts)
    made = [
        next(s for s in estimate_run(plan.begun, plan.facts, size, 2, costs).stages if s.name == "features")
        for size in (20.0, 100.0)
    ]
    assert made[0].bytes == pytest.approx(made[1].bytes) and made[0].amount.units > 1.5 * made[1].amount.units


def test_larger_tiles_take_more_memory_and_have_fewer_parts(walked) -> None:
    plan, _, _ = walked
    by_size = {c.size: c for c in plan.choices}
    assert by_size[50.0].tiles > by_size[100.0].tiles >= by_size[1000.0].tiles >= 1
    features = [
        next(
            s.memory_mib
            for s in estimate_run(plan.begun, plan.facts, size, 2, plan.config.plan.stages).stages
            if s.name == "features"
        )
        for size in (20.0, 50.0, 100.0)
    ]
    assert features == sorted(features) and features[0] < features[-1]


def test_a_size_that_does_not_fit_is_not_proposed(walked) -> None:
    plan, _, _ = walked
    costs = {n: c.model_copy(update={"held": 5e4 * (n == "features")}) for n, c in plan.config.plan.stages.items()}
    wide = choices(plan.begun, plan.facts, 1, costs, 1e9)
    memory = {c.size: c.memory_mib for c in wide}
    tight = choices(plan.begun, plan.facts, 1, costs, (memory[50.0] + memory[100.0]) / 2)
    best = propose_size(plan.config, tight)
    assert best is not None and best.size == 50.0 and not next(c for c in tight if c.size == 100.0).fits
    assert propose_size(plan.config, choices(plan.begun, plan.facts, 1, costs, 1.0)) is None


NO_HALO = "terrain.max_gap=0 terrain.dsm_gap=0 terrain.block_halo=0"


@pytest.mark.parametrize(
    ("room", "setting", "workers", "told"),
    [
        (ROOM, "run.worker_memory_gib=0.5", 2, "memory of a worker"),
        (Room(1000.0, 1e12), "run.workers=2", 2, "memory of this machine"),
        (Room(16_000.0, 1e6), "run.workers=2", 2, "disk"),
        (ROOM, f"{NO_HALO} terrain.cell=0.004", 2, "cells of the delivered rasters"),
    ],
)
def test_what_cannot_fit_is_refused_with_the_numbers(walked, survey, room, setting, workers, told) -> None:
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", *setting.split()))
    facts = walked[0].facts
    if "cells" in told:
        first = facts.box
        wide = Box(first.xmin, first.ymin, first.xmin + 1000.0, first.ymin + 1000.0)
        facts = replace(facts, sources=tuple(replace(s, bounds=wide) for s in facts.sources))
    plan = make_forecast(begin(config), facts, workers, room)
    with pytest.raises(ConfigError, match="does not fit") as fault:
        refuse(list(plan.limits), config.path)
    assert told in fault.value.got and "needed" in fault.value.got and fault.value.exit_code == 2
    refuse(limits(walked[0].config, walked[0].estimate, 0, ROOM, None), "")


def test_polygons_are_the_tiles_and_their_halos(walked, tmp_path: Path) -> None:
    plan, _, _ = walked
    gpkg, png, numbers = write_plan(plan, tmp_path)
    assert sorted(name for name, _ in pyogrio.list_layers(gpkg)) == ["blocks", "halos", "tiles"]
    tiles, halos = pyogrio.read_dataframe(gpkg, layer="tiles"), pyogrio.read_dataframe(gpkg, layer="halos")
    assert len(tiles) == len(halos) == plan.tiles.number and tiles.crs.to_epsg() == 25832
    first = plan.tiles.heaviest(1)[0]
    at = tiles.index[tiles["tile"] == first.key][0]
    assert (
        tiles.geometry[at].bounds == first.box.bounds and halos.geometry[at].bounds == first.box.grown(plan.halo).bounds
    )
    assert tiles["echoes"].sum() == pytest.approx(plan.counts.echoes.sum(), rel=0.01)
    assert (tiles["echoes_with_halo"] >= tiles["echoes"]).all()
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert json.loads(numbers.read_text())["tiles"]["number"] == len(tiles)


@pytest.mark.slow
def test_ten_thousand_square_kilometres_are_planned_in_a_minute(tmp_path: Path) -> None:
    line = [sys.executable, SCALE, tmp_path]
    ended = subprocess.run(line, capture_output=True, text=True, timeout=180)
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["tiles"] >= 1e5 and told["points"] >= 1e11 and told["fits"]
    assert told["cpu_seconds"] < 60 and told["peak_mib"] < 2048  # one process: of a quiet machine that is its time
