"""The command that chooses features: select."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import JSON, OUTPUT, OVERWRITE, PATH, SCHEDULER, SET, WORKERS, cli, tell
from fwclass.cli.runner import open_runner
from fwclass.errors import ConfigError


def _split_names(context: click.Context, parameter: click.Parameter, text: str | None) -> tuple[str, ...]:
    """``a,b,c`` as names."""
    return tuple(word.strip() for word in text.split(",") if word.strip()) if text else ()


@cli.command()
@click.argument("conf", type=PATH)
@click.option(
    "--method",
    type=click.Choice(["forward", "rffs", "fscore", "thinning", "scales"]),
    required=True,
    help="How to choose.",
)
@click.option("--candidates", metavar="SET|FILE|A,B,…", help="What to choose from (default: survey.features).")
@click.option(
    "--order", metavar="A,B,…", callback=_split_names, help="With forward: add in this order, drop what gains nothing."
)
@click.option(
    "--pick",
    type=click.Choice(["best", "smallest", "cheapest"]),
    default="best",
    show_default=True,
    help="Which set is written: the best, or the smallest or cheapest as good within one standard error.",
)
@click.option(
    "--to", "target", type=OUTPUT, help="The feature-set file (default: OUT/select/METHOD.yaml); .json and .png beside."
)
@click.option("--out", type=OUTPUT, help="Run directory, shared with `fwclass run` (default: runs/<survey>).")
@SET
@SCHEDULER
@WORKERS
@OVERWRITE
@JSON
def select(
    conf: Path,
    method: str,
    candidates: str | None,
    target: Path | None,
    out: Path | None,
    settings: tuple[str, ...],
    scheduler: str | None,
    workers: int | None,
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Choose features on the training areas of a survey, and tell what they cost.

    forward (Fan 2013) adds the best feature again and again, rffs (Xiong 2018) drops the least important, fscore
    (Shi 2019) adds by rank; each set is judged by forests in spatial folds. The file it writes is what
    `--set survey.features=FILE` takes. thinning tells accuracy and time if only a share of the echoes is classified.
    scales chooses among the radii of a second layer (classify.refine).
    """
    from fwclass.operate.configured import configured
    from fwclass.study.scales import scale_selection
    from fwclass.study.select import output
    from fwclass.study.select.thinning import thinning
    from fwclass.study.selection import selection

    config = configured(conf, settings)
    root = out if out is not None else Path("runs") / config.survey.name
    names = output.candidates_of(config, candidates)
    if method != "forward" and options["order"]:
        raise ConfigError("--order belongs to --method forward", where="--order", got=f"--method {method}")
    if method not in ("thinning", "scales") and len(names) < 2:
        raise ConfigError(
            "there is nothing to choose",
            where="--candidates" if candidates else f"{config.path}: survey.features",
            expected="two features or more",
            got=", ".join(names) or "none",
            do="--candidates with a feature set, its file, or a list a,b,c",
        )
    path = output.check_target(target, root, method, overwrite)
    count = config.run.workers if workers is None else workers
    with open_runner(root, count, scheduler, config.run) as runner:
        if method == "thinning":
            result = thinning(config, runner, names)
        elif method == "scales":
            result = scale_selection(config, runner, options["pick"])
        else:
            result = selection(config, runner, names, method, **options)
    output.write(result, path)
    tell(result, output.describe(result, path), as_json)
