"""He 2023 as a run: five families of ground filter and CSF + SMRF on labelled samples, figures beside the paper's."""

from __future__ import annotations

from typing import Any

from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.errors import ConfigError
from fwclass.graph.stage import Plan
from fwclass.run.runner import Runner, require_all
from fwclass.study.papers.he import NAME, SAMPLE, STAGES, facts, with_samples, write_he2023
from fwclass.survey.area_of_interest import Area
from fwclass.walk.steps import tasks_of
from fwclass.walk.workflow import Workflow


def walk(config: Config, runner: Runner, tiles: frozenset[str] | Area | None = None) -> dict[str, Any]:
    """Search and judge every filter on every sample; return the report. There are no tiles to choose."""
    if tiles is not None:
        raise ConfigError("samples have no tiles", where="--tiles", do="leave --tiles out")
    receipts = require_all(runner, tasks_of(with_samples(Plan(config), runner.store), STAGES))
    samples = [part for stage, part in receipts if stage == SAMPLE]
    runner.finish(whole=True)
    return runner.carry_out(
        lambda: write_he2023(config, runner, samples, facts(config, paper(NAME), samples, receipts))
    )


he2023 = Workflow(
    NAME, "He 2023: ground filters, and CSF + SMRF, beside the paper's figures", (), walk, lambda c: c, study=STAGES
)
