"""Commands on recordings of a vehicle's 2-D scanner: street info, simulate, train, classify, run, annotate."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import (
    ACCEPT_DRIFT,
    ACCEPT_IMPLAUSIBLE,
    CLASSIFIER,
    JSON,
    OUTPUT,
    OVERWRITE,
    PATH,
    SCHEDULER,
    SET,
    WORKERS,
    Finite,
    cli,
    tell,
)
from fwclass.cli.runner import open_runner

CONF = click.option("--conf", type=PATH, help="A street's configuration, for mounting, speed and scanner.")
MODEL = click.option("--model", type=PATH, required=True, help="Directory of the model.")


@cli.group()
def street() -> None:
    """Street-tree crowns from a vehicle's 2-D scanner, frame by frame (docs/street.md)."""


def _config(conf: Path | None, settings: tuple[str, ...], model: Path | None = None) -> Any:
    """The sections of a street's configuration; without one the base's, with the mounting that `model` learned with."""
    from fwclass import conf as configuration
    from fwclass.graph.street import learned_mounting
    from fwclass.store.models import load_model

    if conf is None and model is not None and (mounting := learned_mounting(load_model(model))) is not None:
        settings = (*(f"street.mounting.{name}={json.dumps(value)}" for name, value in mounting.items()), *settings)
    return configuration.load(conf if conf is not None else "street-sim", settings)


def _judge(summary: dict[str, Any], config: Any, options: dict[str, Any], source: object, model: Path) -> None:
    from fwclass.assess.remarks import judge_chance
    from fwclass.report.drift import judge_drift
    from fwclass.street.soundness import judge_recording

    taken = options["accept_implausible"] or config.plausibility.accept
    judge_recording(summary["implausible"], taken, source)
    if summary.get("accuracy"):
        judge_chance(summary["accuracy"], taken, source)
    accepted = options["accept_drift"] or config.classify.accept_drift
    judge_drift(summary["drift"], config.classify.model_copy(update={"accept_drift": accepted}), model)


def _say(text: str) -> None:
    click.echo(text, err=True)


@street.command()
@click.argument("recordings", metavar="REC…", type=PATH, nargs=-1, required=True)
@CONF
@SET
@JSON
def info(recordings: tuple[Path, ...], conf: Path | None, settings: tuple[str, ...], as_json: bool) -> None:
    """Tell what recordings hold, and what is wrong with them."""
    from fwclass.graph.street_recordings import TrajectoryFiles
    from fwclass.single_file.street.info import describe
    from fwclass.single_file.street.info import info as look

    config = _config(conf, settings)
    trajectory = TrajectoryFiles.of(config)
    summary = [look(path, config.street, trajectory) for path in recordings]
    if as_json:
        click.echo(json.dumps(summary, indent=1))
    else:
        click.echo("\n\n".join(map(describe, summary)))


@street.command()
@click.argument("conf", type=PATH, default=Path("street-sim"))
@click.option("--out", type=OUTPUT, required=True, help="Parquet file that is written.")
@SET
@OVERWRITE
def simulate(conf: Path, out: Path, settings: tuple[str, ...], overwrite: bool) -> None:
    """Simulate a drive along a street; a class code for every return (section street_scene)."""
    from fwclass.conf.street import scanner
    from fwclass.publish.files import check_free, written_whole
    from fwclass.street.recording_parquet import write_recording
    from fwclass.street.simulate import simulate_frames

    config = _config(conf, settings)
    check_free(out, overwrite)
    frames = simulate_frames(config.street_scene, scanner(config.street.scanner), config.street.mounting)
    with written_whole(out) as beside:
        count = write_recording(beside, frames)
    _say(f"recording    {out}: {count} frames, {config.street_scene.length:g} m of street")


@street.command()
@click.argument("conf", type=PATH)
@click.option("--model", "target", type=OUTPUT, required=True, help="Directory that the model is written to.")
@CLASSIFIER
@click.option("--recordings", "directory", type=PATH, help="Where the recordings lie (default: survey.directory).")
@click.option("--assess/--no-assess", default=True, help="Judge the model on the returns that are left (default: yes).")
@SET
@OVERWRITE
@ACCEPT_IMPLAUSIBLE
@JSON
def train(
    conf: Path, target: Path, method: str | None, settings: tuple[str, ...], as_json: bool, **options: Any
) -> None:
    """Train a model on labelled recordings, at random or by stretches of road (street.split), and judge it."""
    from fwclass.assess.remarks import judge_chance
    from fwclass.cli.model import _known
    from fwclass.single_file.street.train import describe
    from fwclass.single_file.street.train import train as training
    from fwclass.street.soundness import judge_recording

    if method is not None:
        settings = (*settings, f"train.method={_known(method, '--method')}")
    config = _config(conf, settings)
    accepted = options.pop("accept_implausible") or config.plausibility.accept
    summary = training(config, target, say=_say, **options)
    tell(summary, describe(summary), as_json)
    judge_recording(summary["implausible"], accepted, conf)
    if summary["accuracy"]:
        judge_chance(summary["accuracy"], accepted, conf)


@street.command()
@click.argument("recording", metavar="REC", type=PATH)
@click.argument("output", metavar="OUT", type=OUTPUT)
@MODEL
@CONF
@SET
@SCHEDULER
@WORKERS
@OVERWRITE
@ACCEPT_IMPLAUSIBLE
@ACCEPT_DRIFT
@JSON
def classify(
    recording: Path, output: Path, model: Path, conf: Path | None, settings: tuple[str, ...], **options: Any
) -> None:
    """Classify a recording: answers and prescription map in the directory OUT, the bytes of `street run`."""
    from fwclass.graph.street_recordings import TrajectoryFiles
    from fwclass.single_file.street.batch import Work, check
    from fwclass.single_file.street.batch import classify as work
    from fwclass.single_file.street.online import describe_batch
    from fwclass.single_file.street.output import working_in
    from fwclass.temporary import temporary_directory

    config = _config(conf, settings, model)
    count = config.run.workers if options["workers"] is None else options["workers"]
    job = Work(recording.resolve(), model.resolve(), config.street, TrajectoryFiles.of(config))
    check(job)
    with (
        working_in(output, options["overwrite"]),
        temporary_directory("street", output.parent) as beside,
        open_runner(beside, int(count), options["scheduler"], config.run) as runner,
    ):
        summary = work(job, output, runner, config)
    tell(summary, describe_batch(summary, output), options["as_json"])
    _judge(summary, config, options, recording, model)


@street.command()
@click.argument("source", metavar="REC|-|tcp://HOST:PORT")
@MODEL
@click.option("--out", "target", type=OUTPUT, required=True, help="Directory that answers are appended in.")
@click.option(
    "--pace", type=click.Choice(["recorded", "fastest"]), default="fastest", help="Of a recording (default: fastest)."
)
@CONF
@SET
@OVERWRITE
@ACCEPT_IMPLAUSIBLE
@ACCEPT_DRIFT
@JSON
def run(
    source: str, model: Path, target: Path, pace: str, conf: Path | None, settings: tuple[str, ...], **options: Any
) -> None:
    """Answer frames as they come: crowns while the vehicle drives.

    The source is a recording, - for standard input, or tcp://host:port to listen at (docs/street.md tells the bytes).
    SIGINT ends it cleanly.
    """
    from fwclass.graph.street_recordings import TrajectoryFiles
    from fwclass.single_file.street.online import Run, describe
    from fwclass.single_file.street.online import run as work

    config = _config(conf, settings, model)
    job = Run(source, model, target, pace == "recorded", options["overwrite"], TrajectoryFiles.of(config))
    summary = work(job, config.street, _say)
    tell(summary, describe(summary, target), options["as_json"])
    _judge(summary, config, options, source, model)


@street.command()
@click.argument("recording", metavar="REC", type=PATH)
@click.argument("file", metavar="ANNOTATION", type=PATH)
@click.option("--out", type=OUTPUT, help="Parquet file that the recording is written to with its labels.")
@click.option("--preview", type=OUTPUT, help="Directory for pictures of the slices, and of the next one.")
@click.option("--slice", "slice_", type=Finite(0.01), default=2.0, help="m of road of the next slice.")
@CONF
@SET
@OVERWRITE
@JSON
def annotate(
    recording: Path, file: Path, conf: Path | None, settings: tuple[str, ...], as_json: bool, **options: Any
) -> None:
    """Label returns by rectangles in slices of road (docs/street.md): check them, show them, go on where they end."""
    from fwclass.graph.street_recordings import TrajectoryFiles
    from fwclass.single_file.street.annotate import annotate as work
    from fwclass.single_file.street.annotate import describe

    config = _config(conf, settings)
    summary = work(recording, file, params=config.street, trajectory=TrajectoryFiles.of(config), **options)
    tell(summary, describe(summary), as_json)
