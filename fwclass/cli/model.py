"""Commands about models: train, classify."""

from __future__ import annotations

import json
from collections.abc import Mapping
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
    RUN,
    SCHEDULER,
    SET,
    WORKERS,
    Finite,
    cli,
    tell,
    work_here,
)
from fwclass.cli.runner import open_runner
from fwclass.errors import ConfigError, nearest


@cli.command()
@click.argument("conf", type=PATH)
@click.option("--model", "target", type=OUTPUT, help="Directory that the model is written to.")
@CLASSIFIER
@click.option("--compare", metavar="all|NAME,NAME,…", help="Several classifiers side by side; no --model.")
@click.option("--assess/--no-assess", default=True, help="Judge the model on the test areas (default: yes).")
@click.option("--leave-out", is_flag=True, help="Judge it on each of survey.sources, left out in turn.")
@click.option(
    "--keep-rows",
    type=click.IntRange(1, 1_000_000),
    metavar="N",
    help="Keep N rows of every class beside the model, to be learned from further (survey.base_model).",
)
@click.option("--out", type=OUTPUT, help="Run directory (default: runs/<survey>).")
@SET
@SCHEDULER
@WORKERS
@ACCEPT_IMPLAUSIBLE
@OVERWRITE
@JSON
def train(
    conf: Path,
    target: Path | None,
    method: str | None,
    compare: str | None,
    out: Path | None,
    settings: tuple[str, ...],
    accept_implausible: bool,
    **options: Any,
) -> None:
    """Train a model on a survey's training areas, and judge it on its test areas.

    What is computed on the way stays in the run directory; `fwclass run` there goes on from it. With --compare no model
    is written: a table tells accuracy and time of each classifier on the same sample and the same echoes.
    """
    if (compare is None) == (target is None):
        raise click.UsageError("give --model DIR, or --compare NAME,NAME,…")
    if compare is not None and options["leave_out"]:
        raise click.UsageError("--leave-out judges one model; --compare has a table of its own")
    if compare is not None and options["keep_rows"]:
        raise click.UsageError("--keep-rows belongs to --model")
    if compare is not None and method is not None:
        raise click.UsageError("--compare names its classifiers itself")
    if method is not None:
        settings = (*settings, f"train.method={_known(method, '--method')}")
    settings += ("plausibility.accept=true",) if accept_implausible else ()
    from fwclass.operate.configured import configured

    config = configured(conf, settings)
    root = out if out is not None else Path("runs") / config.survey.name
    if target is not None:
        _train(config, root, target, options)
    elif compare is not None:
        _compare(config, root, _methods(compare), options)


def _known(method: str, where: str) -> str:
    from fwclass.train.baselines.stage import METHODS

    if method not in METHODS:
        raise ConfigError(
            "no such classifier", where=where, expected=", ".join(METHODS), got=method, do=nearest(method, METHODS)
        )
    return method


def _methods(text: str) -> tuple[str, ...]:
    from fwclass.train.baselines.stage import METHODS

    return METHODS if text == "all" else tuple(dict.fromkeys(_known(n.strip(), "--compare") for n in text.split(",")))


def _count(config: Any, options: dict[str, Any]) -> int:
    return int(config.run.workers if options["workers"] is None else options["workers"])


def _train(config: Any, root: Path, target: Path, options: dict[str, Any]) -> None:
    from fwclass.assess.remarks import judge_chance, judge_folds
    from fwclass.report.labels import judge_labels
    from fwclass.single_file.model_directory import check_target, copy_model
    from fwclass.study.left_out import leave_out
    from fwclass.study.training import kept_rows, training
    from fwclass.study.training_text import describe, measured_facts

    check_target(target, options["overwrite"])
    with open_runner(root, _count(config, options), options["scheduler"], config.run) as runner:
        left_out = leave_out(config, runner) if options["leave_out"] else None
        result = training(config, runner, options["assess"] and left_out is None) | {"left_out": left_out}
        measured = measured_facts(result)
        rows = kept_rows(config, runner.store, options["keep_rows"]) if options["keep_rows"] else None
        copy_model(runner.store.path("train", "model", "model"), target, options["overwrite"], measured, rows)
    click.echo(f"{describe(result)}\nmodel       {target}", err=True)
    if options["as_json"]:
        click.echo(json.dumps({**result, "model": str(target)}, indent=1))
    judge_labels(result["labels"], config.plausibility, config.path)
    if result["accuracy"]:
        judge_chance(result["accuracy"], config.plausibility.accept, config.path)
    elif result["cross_validation"]:
        judge_folds(result["cross_validation"], config.plausibility.accept, config.path)


def _compare(config: Any, root: Path, methods: tuple[str, ...], options: dict[str, Any]) -> None:
    from fwclass.study.compare import describe
    from fwclass.study.training import comparison

    with open_runner(root, _count(config, options), options["scheduler"], config.run) as runner:
        table = comparison(config, runner, methods)
    click.echo(describe(table), err=options["as_json"])
    if options["as_json"]:
        click.echo(json.dumps(table, indent=1))


def _codes(context: click.Context, parameter: click.Parameter, words: tuple[str, ...]) -> Mapping[int, int]:
    """``64=20`` as numbers."""
    codes = {}
    for word in words:
        left, _, right = word.partition("=")
        if not left.isdigit() or not right.isdigit() or not int(left) < 256 or not int(right) < 256:
            raise click.BadParameter(f"{word!r} is no pair of class codes like 64=20")
        codes[int(left)] = int(right)
    return codes


def _code_list(context: click.Context, parameter: click.Parameter, text: str | None) -> str | None:
    """``0,1`` as a list of codes for a setting."""
    if text is None:
        return None
    words = [word.strip() for word in text.split(",")]
    if not all(word.isdigit() and int(word) < 256 for word in words):
        raise click.BadParameter(f"{text!r} is no list of class codes (0 to 255) like 0,1")
    return f"[{','.join(words)}]"


@cli.command()
@click.argument("source", metavar="IN", type=PATH)
@click.argument("output", metavar="OUT", type=OUTPUT)
@click.option("--model", type=PATH, required=True, help="Directory of the model, or a name of `fwclass models`.")
@click.option("--method", metavar="NAME", help="Ground filter for heights above ground (default: ground.method).")
@click.option("--preset", metavar="NAME", help="Its preset; see docs/ground.md.")
@click.option("--param", "assignments", multiple=True, metavar="NAME=VALUE", help="A parameter of the filter.")
@click.option("--auto", is_flag=True, help="Adapt the filter's parameters to the points first.")
@click.option("--own-ground", is_flag=True, help="Heights count from class 2 of the file; no filter.")
@click.option(
    "--legacy-code",
    "legacy",
    multiple=True,
    callback=_codes,
    metavar="CODE=CODE",
    help="Write another code (formats 0 to 5 hold up to 31; default: the model's).",
)
@click.option(
    "--only",
    metavar="CODE,…",
    callback=_code_list,
    help="Classify points that have these classes, as 0,1; all others keep theirs (classify.only).",
)
@click.option(
    "--keep",
    metavar="CODE,…",
    callback=_code_list,
    help="Points of these classes keep them, as 7,9,18 (classify.keep).",
)
@click.option("--trajectory", type=PATH, help="Where the sensor flew (text or SBET), for models that need ranges.")
@click.option("--undulation", type=Finite(), default=0.0, help="Metres to take from the trajectory's heights.")
@click.option("--crs", metavar="EPSG:CODE", help="Instead of the coordinate system that the file names.")
@ACCEPT_DRIFT
@ACCEPT_IMPLAUSIBLE
@SET
@OVERWRITE
@JSON
def classify(
    source: Path,
    output: Path,
    as_json: bool,
    accept_drift: bool,
    accept_implausible: bool,
    only: str | None,
    keep: str | None,
    settings: tuple[str, ...],
    **options: Any,
) -> None:
    """Classify the points of one file by a trained model.

    Waveforms are decomposed where there are any; each point takes the class of its echo. Points keep their order and
    all other fields; confidence and entropy become extra bytes.
    """
    work_here()
    from fwclass import conf
    from fwclass.classify.unsure import judge_unsure
    from fwclass.quality.roughness import judge_roughness
    from fwclass.report.drift import judge_drift
    from fwclass.report.judge_echoes import judge_echoes
    from fwclass.single_file.classify import ClassifyJob, classify_file, describe
    from fwclass.single_file.ground.steps import StepDisplay

    if options["own_ground"] and any(options[n] for n in ("method", "preset", "assignments", "auto")):
        raise click.UsageError("--own-ground takes the file's ground: no filter is run")
    settings += (f"classify.only={only}",) if only else ()
    settings += (f"classify.keep={keep}",) if keep else ()
    settings += ("plausibility.accept=true",) if accept_implausible else ()
    job = ClassifyJob(source, output, settings=settings, **options)
    with StepDisplay() as steps:
        summary = classify_file(job, steps.tell)
    tell(summary, describe(summary), as_json)
    judge_echoes(summary["judged"], conf.section("plausibility", settings), source)
    if not accept_drift:
        params = conf.section("classify", job.settings)
        judge_drift(summary["drift"], params, job.model)
        judge_unsure(summary["unsure"], params, job.model)
        if lines := summary["judged"].get("strips"):
            judge_roughness(lines["roughness"], params.max_rough, params.accept_drift, job.model)


@cli.command()
@click.argument("run", type=RUN)
@click.argument("model", type=PATH)
@click.argument("target", metavar="OUT", type=OUTPUT)
@SET
@OVERWRITE
def adapt(run: Any, model: Path, target: Path, settings: tuple[str, ...], overwrite: bool) -> None:
    """Let MODEL learn from the echoes of a RUN of which it is sure, without labels, and write it to OUT.

    MODEL keeps rows (`fwclass train --keep-rows`), and RUN has its features. Labels at few places are worth far more:
    `fwclass suggest`.
    """
    from fwclass import conf
    from fwclass.cli.run_words import run_at
    from fwclass.delivery.adapting import adapt_model
    from fwclass.store.url import is_url

    conf.check_settings(settings, ("adapt", "train"))
    params, training = conf.section("adapt", settings), conf.section("train", settings)
    location = run_at(run) if is_url(run) else run
    click.echo(adapt_model(location, model, target, params, training, overwrite), err=True)


@cli.command()
@JSON
def models(as_json: bool) -> None:
    """List the models that have a name: classes, features, and how good they are on data that they have not seen."""
    from fwclass.study.installed import describe, facts_of_models

    facts = facts_of_models()
    click.echo(json.dumps(facts, indent=1) if as_json else describe(facts))


@cli.command()
@click.argument("model", type=PATH)
@click.argument("out", type=OUTPUT)
@click.option("--format", "form", type=click.Choice(["onnx"]), default="onnx", show_default=True, help="File format.")
@OVERWRITE
def export(model: Path, out: Path, form: str, overwrite: bool) -> None:
    """Write the forest in the directory MODEL as the file OUT, for programs that read its format.

    ONNX: input X, float32 (rows, features) in the order of the metadata entry "features", NaN where a value is
    missing; outputs label (class codes), votes and probabilities. Classes are the same as here for every row.
    """
    from fwclass.publish.files import written_whole
    from fwclass.publish.onnx_forest import onnx_forest
    from fwclass.single_file.ground.output import check_places
    from fwclass.store.models import load_forest

    if out.suffix.lower() != f".{form}":
        raise ConfigError(
            f"the output is {form.upper()}",
            where=out,
            expected=f"a name that ends in .{form}",
            got=out.suffix or "no suffix",
            do="name the output with this ending",
        )
    check_places(model, [out], overwrite)
    content = onnx_forest(load_forest(model))
    with written_whole(out) as beside:
        beside.write_bytes(content)
    click.echo(f"{out}: {form}, {out.stat().st_size / 1e6:.1f} MB", err=True)
