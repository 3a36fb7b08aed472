"""Waveforms that are left aside, where the sources' own returns tell all that is asked."""

from __future__ import annotations

from fwclass.errors import ConfigError
from fwclass.graph.sources import MEASURE_PULSE, strips_declared
from fwclass.graph.stage import Plan
from fwclass.store.run_store import Store

LEFT_ASIDE = "by the returns of the sources: their waveforms are left aside"
"""What is said of it, by a run and in its report."""


def takes_returns(plan: Plan, store: Store) -> bool:
    """Whether the sources have waveforms and every one has returns too, so that these are taken for echoes.

    `survey.echoes` ``auto`` keeps to the echoes of waveforms where `store` has some: to make tiles of returns there
    would cost more, and take them from who needs them. `ConfigError` where it is ``returns`` and a file has none.
    """
    strips = strips_declared(plan)
    lacking = [s for s in strips if not plan.indexed["index", s.key].meta["points"]]
    asked = plan.config.survey.echoes == "returns"
    if lacking and asked:
        raise ConfigError(
            "a source has waveforms alone, and no returns",
            where=f"{plan.config.path}: survey.echoes",
            got=f"returns, and {lacking[0].path.name} has none",
            do="--set survey.echoes=waveforms",
        )
    held = any(store.receipt(MEASURE_PULSE.name, s.key) for s in strips)
    return bool(strips) and not lacking and (asked or not held)
