"""The layer that decides in context which a run has: of the settings, or of the model that is given."""

from __future__ import annotations

from dataclasses import dataclass

from fwclass.classify.context import coarse_share_columns, halo_of
from fwclass.errors import InputError
from fwclass.graph.loaded_models import model_at
from fwclass.graph.stage import Plan
from fwclass.model import Contextual
from fwclass.model.contextual import context_names
from fwclass.store.remote_file import local


@dataclass(frozen=True)
class ContextLayer:
    """What it decides by: `codes` of the classes, in the order of the shares, and edges of `cells` [m]."""

    codes: tuple[int, ...]
    cells: tuple[float, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its features besides those of the first layer."""
        return context_names(self.codes, self.cells)

    @property
    def halo(self) -> float:
        """What it reads around a tile [m]."""
        return halo_of(self.cells)

    def columns(self, base: str = "coarse_share") -> tuple[str, ...]:
        """Columns with the first layer's share of every class."""
        return coarse_share_columns(self.codes, base)


def context_layer(plan: Plan) -> ContextLayer | None:
    """The layer of a run, None without one."""
    if plan.model is not None:
        model = model_at(local(plan.model[0]), plan.model[1], True)
        return ContextLayer(tuple(model.codes.tolist()), model.cells) if isinstance(model, Contextual) else None
    context = plan.config.classify.context
    cells = () if context.cells == "auto" and not tries(plan) else context.tried
    return ContextLayer(tuple(c.code for c in plan.config.classes), cells) if cells else None


def tries(plan: Plan) -> bool:
    """Whether a run has a second layer only where it pays: `auto`, and nothing that it cannot stand behind."""
    config = plan.config
    alone = config.thin.rate == 1.0 and config.train.method == "forest" and not config.classify.refine.between
    return plan.model is None and config.classify.context.cells == "auto" and alone


def layer_of(plan: Plan) -> ContextLayer:
    """The layer of a run that has one."""
    layer = context_layer(plan)
    if layer is None:
        raise InputError("the run decides without context", where="classify.context")
    return layer
