"""A run on object storage in the viewer: blocks, waveforms and votes of one on a disk, corrections in the bucket."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from commandline import fwclass
from drawn import box, drawn
from objectstore import Server, quick, serving, used
from runmaker import SETTINGS

from fwclass import conf
from fwclass.delivery.opened import Delivery, open_at, open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_large import OverviewRun
from fwclass.errors import InputError
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.schema import IDENTITY
from fwclass.store.bucket import Remote
from fwclass.store.corrections import read_corrections
from fwclass.store.run_location import lock_run
from fwclass.store.url import Url
from fwclass.view.scene import ECHOES
from fwclass.view.selection import Selection
from workflows import workflow_of

VIEW = ("view.block=2000", "view.together=6000")


@pytest.fixture(scope="module")
def s3() -> Iterator[Server]:
    with serving() as server:
        yield server


@pytest.fixture(scope="module")
def far(s3: Server, run: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Remote]:
    """The run of the local fixture once more, made in a bucket."""
    survey, place = run.parent / "survey", s3.url("run")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in used(s3, tmp_path_factory.mktemp("copies")).items():
            patch.setenv(name, value)
        words = (*SETTINGS, f"survey.directory={survey}", "tile.size=40")
        features = "survey.features=[zc, echo_number, amplitude, width, echo_ratio_r100]"
        config = conf.load("demo", (*words, features))
        with Display() as display, lock_run(Remote(place, quick()), display.say) as (own, held):
            runner = Runner(own, Loop(), display, held=held)
            workflow_of("classification")(config, runner, None)
            runner.publish(config.run.keep_generations)
        yield Remote(place, quick())


def scene_of(delivery: Delivery) -> ViewedRun:
    return ViewedRun(delivery, conf.section("view", VIEW))


@pytest.mark.slow
def test_it_shows_what_a_run_on_a_disk_shows(far: Remote, run: Path) -> None:
    scene, near = scene_of(open_at(far)), scene_of(open_run(run))
    assert scene.echoes == near.echoes
    for level in scene.pyramid.levels():
        assert scene.level(ECHOES, level) == near.level(ECHOES, level)
    node = next(iter(scene.open.coarse().nodes))
    values = scene.echo(node, 0)["values"]
    who = tuple(values[n] for n in IDENTITY)
    assert scene.pulse(*who[:2]) == near.pulse(*who[:2])
    assert scene.why(*who) == near.why(*who)


@pytest.mark.slow
def test_only_what_is_asked_for_is_fetched(far: Remote, s3: Server) -> None:
    copies = far.copies / "generations"
    delivery = open_at(far)
    there = {p.name for p in copies.rglob("*") if p.is_file()}
    assert not any(name.endswith(".copc.laz") for name in there)
    first = delivery.tiles[0]["tile"]
    assert delivery.table(first).is_file()
    large = ViewedRun(delivery, conf.section("view", (*VIEW, "view.together=1000", "view.whole=0")))
    assert type(large.open) is OverviewRun and large.work_list() and not list(copies.rglob("overview.copc.laz"))
    assert large.level(ECHOES, 0) and list(copies.rglob("overview.copc.laz"))
    assert len(delivery.echoes().to_arrow()) == sum(t["echoes"] for t in delivery.tiles)


@pytest.mark.slow
def test_corrections_lie_in_the_bucket(far: Remote) -> None:
    scene = scene_of(open_at(far))
    x0, y0, *_ = scene.tiles[next(iter(scene.tiles))]["bounds"]
    told = scene.relabel.select(Selection.of(drawn(box(x0, y0, x0 + 8, y0 + 8))))
    assert told["echoes"] > 0
    code = int(scene.delivery.report["classes"][0]["code"])
    scene.relabel.correct(told["selection"], code)
    assert read_corrections(far).rows == scene.relabel.corrections.rows().all.rows > 0
    again = scene_of(open_at(far))
    assert again.relabel.corrections.rows().all.rows == read_corrections(far).rows


@pytest.mark.slow
def test_the_command_takes_the_address(far: Remote, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = fwclass("view", far.url, "--worklist", tmp_path / "w.gpkg", "--set", "view.unsure=0.9")
    assert made.returncode == 0 and (tmp_path / "w.gpkg").is_file(), made.stderr
    exported = fwclass("view", far.url, "--export", tmp_path / "page")
    assert exported.returncode == 0 and (tmp_path / "page" / "index.html").is_file(), exported.stderr


def test_a_bucket_without_a_delivery_is_said(s3: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in used(s3, tmp_path / "copies").items():
        monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match="not a run"):
        open_at(Remote(s3.url("nothing"), quick()))
    with pytest.raises(InputError, match="fwclass view"):
        open_run(Url("s3://b/r"))
