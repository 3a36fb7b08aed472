"""Li 2018 as a run: streets are simulated, tables 1 and 2 made, and a page sets our figures beside the paper's."""

from __future__ import annotations

from typing import Any

from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.errors import ConfigError
from fwclass.graph.stage import Plan
from fwclass.run.runner import Runner, require_all
from fwclass.study.papers.li import NAME, STAGES, facts, write_li2018
from fwclass.survey.area_of_interest import Area
from fwclass.walk.steps import tasks_of
from fwclass.walk.workflow import Workflow


def walk(config: Config, runner: Runner, tiles: frozenset[str] | Area | None = None) -> dict[str, Any]:
    """Drive along three streets, train and judge at all radii and by each feature alone; return the report.

    There are no tiles to choose, and no shares to average.
    """
    if tiles is not None:
        raise ConfigError("a street has no tiles", where="--tiles", do="leave --tiles out")
    if config.street.smooth is not None:
        raise ConfigError(
            "the paper's returns decide alone",
            where="street.smooth",
            expected="null",
            got=config.street.smooth,
            do="leave it out; `fwclass street train` and `classify` heed it",
        )
    receipts = require_all(runner, tasks_of(Plan(config), STAGES))
    runner.finish(whole=True)
    return runner.carry_out(lambda: write_li2018(runner, facts(config, paper(NAME), receipts)))


li2018 = Workflow(
    NAME, "Li 2018: street-tree crowns from a 2-D scanner, figures beside the paper's", (), walk, study=STAGES
)
