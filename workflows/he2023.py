"""He 2023 as a run: five families of ground filter and CSF + SMRF on labelled samples, figures beside the paper's."""

from __future__ import annotations

from typing import Any

from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.errors import ConfigError
from fwclass.run.runner import Runner, require_all
from fwclass.study.papers.he import deliver, facts, filter_tasks, samples_of
from fwclass.survey.area_of_interest import Area
from fwclass.walk.workflow import Workflow

NAME = "he2023"


def walk(config: Config, runner: Runner, tiles: frozenset[str] | Area | None = None) -> dict[str, Any]:
    """Search and judge every filter on every sample; return the report. There are no tiles to choose."""
    if tiles is not None:
        raise ConfigError("samples have no tiles", where="--tiles", do="leave --tiles out")
    printed, samples = paper(NAME), samples_of(config)
    receipts = require_all(runner, filter_tasks(config, printed, samples))
    runner.finish(whole=True)
    return runner.carry_out(lambda: deliver(config, runner, samples, facts(config, printed, samples, receipts)))


he2023 = Workflow(NAME, "He 2023: ground filters, and CSF + SMRF, beside the paper's figures", (), walk, lambda c: c)
