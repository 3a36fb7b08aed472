"""Stages that compare variants of a classifier: one sample trains them all, one set of test echoes judges them all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from fwclass.classify.stage import CLASSIFY
from fwclass.conf import Config
from fwclass.graph.areas import IDENTITY_AND_PLACE, training_tiles
from fwclass.graph.learn import TREES_PER_PART
from fwclass.graph.stage import Plan, Stage, always
from fwclass.graph.training_rows import DRAW_SAMPLE, NOT_OF_THE_SAMPLE, sample_rows
from fwclass.model import ClassDef
from fwclass.study.papers import work
from fwclass.study.papers.work import DRAWN, DROPPED, JUDGED, MODELS, TESTED, TRAINING, Variant
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.stage import VERSION as OTHERS_VERSION
from fwclass.train.params import TrainParams
from fwclass.train.stage import TRAIN_IMPORTANCE, TRAIN_TREES

VERSION = 3
_OF_MODELS = 1000 * OTHERS_VERSION + TRAIN_TREES.version

Names = tuple[str, ...]
Pairs = Sequence[tuple[Variant, Variant]]


@dataclass(frozen=True)
class Comparison:
    """What the tables of a paper compare, under a plan whose `names` decide and whose `computed` are at hand.

    Attributes
    ----------
    columns : features of the sample, all that any variant decides by.
    variants, pairs, timed : the classifiers, which of them are held against each other, and whose time is taken.
    ranked : the forest whose features are ranked by permutation, None without one.
    filtered : some variant leaves a class to the ground filter.
    compare : by which settings a variant that is no forest learns.
    """

    columns: Callable[[Plan], Names]
    variants: Callable[[Plan], Sequence[Variant]]
    pairs: Callable[[Plan], Pairs]
    timed: Callable[[Plan], Sequence[Variant]]
    ranked: Callable[[Plan], Variant] | None = None
    filtered: bool = False
    compare: Callable[[Plan, Variant], CompareParams] = lambda plan, one: plan.config.compare

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Sample, test echoes, models, their answers, differences and importances, in the order of the run."""
        return (*self._of_data(), self._train, *self._of_answers(), *self._of_importance())

    @property
    def times(self) -> tuple[Stage, ...]:
        """How long classifiers train and answer: made when all else is done, as nothing is to run beside them."""
        return (
            replace(
                self._train,
                name="paper-time",
                function=work.time_variant,
                parts=self.timed,
                after=(MODELS, TESTED, TRAINING),
                needs=lambda plan, one: ((MODELS, one.name), (TESTED, "all"), (TRAINING, "all")),
            ),
        )

    def _of_data(self) -> tuple[Stage, ...]:
        columns = self.columns
        also = ("ground",) if self.filtered else ()
        draw_sample = replace(
            DRAW_SAMPLE,
            name=DRAWN,
            when=always,
            arguments=lambda plan: {
                **_sample_arguments(plan, columns(plan)),
                "areas": plan.config.areas.boxes("train"),
            },
            each=lambda plan, tile: {},
            own=lambda plan: (*IDENTITY_AND_PLACE, *columns(plan), "reference"),
            after=(),
            needs=lambda plan, tile: (),  # a paper's tables know no corrections
        )
        merge_sample = Stage(
            TRAINING,
            VERSION,
            "survey",
            "row",
            work.merge_sample,
            arguments=lambda plan: _sample_arguments(plan, columns(plan)),
            silent=NOT_OF_THE_SAMPLE,
            reads=lambda plan: ("x", "y", *columns(plan)),
            tiles=training_tiles,
            after=(DRAWN,),
            needs=lambda plan, part: [(DRAWN, t.key) for t in training_tiles(plan)],
        )
        draw_test = Stage(
            "paper-test",
            VERSION,
            "tile",
            "echo",
            work.draw_test_echoes,
            arguments=lambda plan: {
                "names": columns(plan),
                "also": also,
                "train": plan.config.areas.boxes("train"),
                "test": plan.config.areas.boxes("test"),
                "gap": plan.config.areas.gap,
                "classes": all_classes(plan.config),
                "share": min(1.0, plan.config.papers.test_echoes / max(1, plan.layout.echoes)),
                "seed": plan.config.papers.seed,
            },
            own=lambda plan: (*IDENTITY_AND_PLACE, *columns(plan), *also, "reference"),
        )
        gather_test = Stage(
            TESTED,
            VERSION,
            "survey",
            "row",
            work.gather_test_echoes,
            load=lambda plan: plan.config.papers.test_echoes,
            after=(draw_test.name,),
            needs=lambda plan, part: [(draw_test.name, t.key) for t in plan.layout.tiles],
        )
        return draw_sample, merge_sample, draw_test, gather_test

    @property
    def _train(self) -> Stage:
        return Stage(
            MODELS,
            _OF_MODELS,
            "survey",
            "tree_row",
            work.learn,
            parts=self.variants,
            load=_rows_of_trees,
            part_name=_name,
            arguments=lambda plan: {"names": self.columns(plan), "classes": all_classes(plan.config)},
            each=self._each,
            after=(TRAINING,),
            needs=lambda plan, one: ((TRAINING, "all"),),
        )

    def _of_answers(self) -> tuple[Stage, ...]:
        judge = Stage(
            JUDGED,
            1000 * CLASSIFY.version + VERSION,
            "survey",
            "row",
            work.judge,
            parts=self.variants,
            load=lambda plan: plan.config.papers.test_echoes,
            part_name=_name,
            arguments=lambda plan: {
                "names": self.columns(plan),
                "classes": all_classes(plan.config),
                "edge": plan.config.papers.block,
            },
            each=lambda plan, one: {"one": one},
            after=(MODELS, TESTED),
            needs=lambda plan, one: ((MODELS, one.name), (TESTED, "all")),
        )
        compare = Stage(
            "paper-difference",
            VERSION,
            "survey",
            "row",
            work.compare,
            parts=self.pairs,
            load=lambda plan: plan.config.papers.test_echoes,
            part_name=lambda pair: f"{pair[0].name}-{pair[1].name}",
            arguments=lambda plan: {"edge": plan.config.papers.block},
            each=lambda plan, pair: {
                "name": pair[0].name,
                "other": pair[1].name,
                "known": min(one.classes for one in pair),
            },
            after=(JUDGED, TESTED),
            needs=lambda plan, pair: (*((JUDGED, one.name) for one in pair), (TESTED, "all")),
        )
        return judge, compare

    def _of_importance(self) -> tuple[Stage, ...]:
        ranked = self.ranked
        if ranked is None:
            return ()
        measure = Stage(
            DROPPED,
            TRAIN_IMPORTANCE.version,
            "survey",
            "tree_row",
            work.measure_drops,
            parts=lambda plan: range(0, ranked(plan).train.trees, TREES_PER_PART),
            part_name=lambda first: f"{first:05d}",
            arguments=lambda plan: {
                "one": ranked(plan),
                "names": self.columns(plan),
                "repeats": plan.config.papers.repeats,
            },
            each=lambda plan, first: {"first": first, "count": min(TREES_PER_PART, ranked(plan).train.trees - first)},
            after=(TRAINING, MODELS),
            needs=lambda plan, first: ((TRAINING, "all"), (MODELS, ranked(plan).name)),
        )
        gather = Stage(
            "paper-importance",
            VERSION,
            "survey",
            "part",
            work.importance,
            arguments=lambda plan: {"features": ranked(plan).features},
            after=(DROPPED,),
            needs=lambda plan, part: [(DROPPED, measure.part_name(first)) for first in measure.all_parts(plan)],
        )
        return measure, gather

    def _each(self, plan: Plan, one: Variant) -> Mapping[str, Any]:
        return {"one": one, "compare": self.compare(plan, one)}


def all_classes(config: Config) -> tuple[ClassDef, ...]:
    """The survey's classes, then those that the paper does not have."""
    more = (ClassDef(**c.model_dump()) for c in config.papers.more_classes)
    return (*config.classes, *more)


def make_variant(
    config: Config, name: str, features: Sequence[str], classes: int | None = None, rows: int = 0, **train: Any
) -> Variant:
    """The run's own classifier with other features, classes or training parameters."""
    settings = config.train.model_dump(mode="json")
    params = TrainParams.model_validate({**settings, "importance_repeats": 0, **train})
    return Variant(name, tuple(features), params, len(config.classes) if classes is None else classes, rows)


def _sample_arguments(plan: Plan, names: Names) -> dict[str, Any]:
    return {"names": names, "params": plan.config.train, "classes": all_classes(plan.config)}


def _rows_of_trees(plan: Plan) -> float:
    return sample_rows(plan.config) * plan.config.train.trees


def _name(one: Variant) -> str:
    return one.name
