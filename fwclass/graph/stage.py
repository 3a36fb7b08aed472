"""What a stage of a run is: one record, from which its tasks, their needs and keys, and the unit of its cost follow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from fwclass.conf import Config
from fwclass.errors import FwclassError
from fwclass.graph.key_values import merge_disjoint, plain_values
from fwclass.graph.stage_work import Result, StageInputs, Work
from fwclass.grid import Box, Tile
from fwclass.run.part import Name, Task
from fwclass.run.tasks import Tasks
from fwclass.schema import Column
from fwclass.store.receipts import Receipt
from fwclass.store.remote_file import Location
from fwclass.store.row_digests import Within
from fwclass.survey.layout import FileDigests, Layout, Survey

Names = tuple[str, ...]

Over = Literal["file", "strip", "chunk", "tile", "block", "survey"]
"""What a part of a stage is: a file that is no strip, a strip, a span of a strip (`chunk`: another thing than the
overlapping chunk, `fwclass.stage.Chunk`, that a stage over tiles gets), a tile, a block of the fixed grid, or something
of which the survey has few."""

Unit = Literal["point", "pulse", "echo", "reference", "cell", "tree_row", "row", "part"]
"""What the cost of a stage is counted in: a point of a file, a pulse, an echo, a point of the reference, a cell of the
delivered rasters, a row of the training sample times the trees that it grows, such a row, or a part."""

Flown = Mapping[str, tuple[float, float]]
"""First and last time of every trajectory, on the survey's time scale [s]."""


@dataclass(frozen=True)
class Plan:
    """What is known of a run when its tasks are made: configuration, features, files, tiles.

    Attributes
    ----------
    names, computed : the features that the classifier decides by; all that are computed.
    model : location and digest of the model that is given, None where one is trained.
    base : location and digest of the model whose rows are learned from too, None without one.
    files : the survey's files, once they are found and checked.
    indexed : receipts of the strips' index.
    splits : receipts of the spans that are cut into tiles.
    tiled : the tiles that there are, once the echoes lie in them.
    flown : when each trajectory was.
    returns : the sources' returns are taken for echoes, and their waveforms left aside.
    only_judges : the run says how good the survey is and delivers no echoes: the ground of its sources' returns is
        filtered for check points alone.
    pointing : beams are held against the trajectory before a range is taken from it.
    declares : columns that the program does not know, of a user's own stages.
    providers : the stage that writes each column, as far as records tell.
    """

    config: Config
    names: Names = ()
    computed: Names = ()
    model: tuple[Location, str] | None = None
    base: tuple[Location, str] | None = None
    files: Survey | None = None
    indexed: Mapping[Name, Receipt] = field(default_factory=dict)
    splits: Mapping[Name, Receipt] = field(default_factory=dict)
    tiled: Layout | None = None
    flown: Flown = field(default_factory=dict)
    returns: bool = False
    only_judges: bool = False
    pointing: bool = False
    declares: tuple[Column, ...] = ()
    providers: Mapping[str, str] = field(default_factory=dict)

    @property
    def survey(self) -> Survey:
        """The survey's files; `FwclassError` before they are known."""
        if self.files is None:
            raise FwclassError("a stage is planned by the survey's files before they are known")
        return self.files

    @property
    def layout(self) -> Layout:
        """The tiles; `FwclassError` before they are known."""
        if self.tiled is None:
            raise FwclassError("a stage is planned by the tiles before they are known")
        return self.tiled


def always(plan: Plan) -> bool:
    """True: the stage is part of every run."""
    return True


Columns = Names | Callable[[Plan], Iterable[str]]


@dataclass(frozen=True)
class Stage:
    """One stage of a run.

    Attributes
    ----------
    name : its name in the store, in receipts, reports and `plan.stages` of the configuration. Two records may share a
        name where their `when` or their parts exclude each other.
    version : raised by hand whenever the same inputs and arguments would give another output.
    over : what a part of it is.
    unit : what its cost is counted in.
    function : ``function(inputs: StageInputs, **arguments)`` makes a part; importable, it travels to the workers.
    when : whether a run has this stage.
    parts : its parts; unless given all tiles, the blocks that own an echo, or the one part `all` of the survey.
    number : how many parts a run may have, where each is planned by what others say, and `parts` cannot tell them.
    load : units of every part, where they follow from the settings alone.
    waves : of strips and chunks those with (True) or without (False) waveforms alone.
    edge, margin : of its blocks [m], and how many more lie around those that own an echo.
    part_name : of a part, in the store and in receipts: unless given its `key`, as tiles, blocks, strips and spans have
        one (the `key` of a receipt is another, a digest of all that the part is made from).
    arguments : what `function` gets besides, the same for every part; all of it enters the key. One called `params`, a
        section of the configuration, enters field by field, so that its fields stand beside the other arguments.
    each : likewise, of one part.
    keyed : what enters the key besides, as it decides which columns or parts are read: the function does not see it.
    silent : settings among the arguments' own that change no byte, and stay out of the key.
    reads : columns of echoes that are read of the part's tile and of its neighbours within `halo`; a stage over the
        survey reads those of all tiles, or of `tiles`.
    own : columns that are read of the own tile alone.
    writes : columns of the table that it writes. Those of a stage over tiles can be read by others.
    halo : distance around the part's square that is read [m], None for none; what lies there enters the key by digests.
    area : what the halo is around; the part's own box unless given.
    after : stages that it comes after, besides those that write its columns: it reads parts of them, or is planned by
        them.
    needs : these parts, of stages in `after`.
    source : the file from outside that a part is made from, with its digests.
    named : of each part it needs, it reads only the rows stored under its own part name, as a tile's rows of a chunk
        (`store.row_digests.digests_by_name`).
    declares : columns among those it writes that the program does not know.
    row_digests : its rows are digested by square, as others read them in a halo.
    bulky : its files take much room for the time that they took: they go first (``run.keep_intermediate: lean``).
    check : it only judges: a delivery is whole though it failed.
    place : "store"; "deliver" for what the user gets; "run" for files of the run directory itself.
    """

    name: str
    version: int
    over: Over
    unit: Unit
    function: Callable[..., Result]
    when: Callable[[Plan], bool] = always
    parts: Callable[[Plan], Sequence[Any]] | None = None
    number: Callable[[Plan], int] | None = None
    load: Callable[[Plan], float] | None = None
    waves: bool | None = None
    edge: Callable[[Plan], float] | None = None
    margin: int = 0
    part_name: Callable[[Any], str] = lambda part: str(getattr(part, "key", part))
    arguments: Callable[[Plan], Mapping[str, Any]] = lambda plan: {}
    each: Callable[[Plan, Any], Mapping[str, Any]] = lambda plan, part: {}
    keyed: Callable[[Plan], Mapping[str, Any]] = lambda plan: {}
    silent: frozenset[str] = frozenset()
    reads: Columns = ()
    tiles: Callable[[Plan], Sequence[Tile]] = lambda plan: plan.layout.tiles
    own: Columns = ()
    writes: Columns = ()
    halo: float | Callable[[Plan], float] | None = None
    area: Callable[[Plan, Tile], Box] = lambda plan, square: square.box
    after: Names = ()
    needs: Callable[[Plan, Any], Iterable[Name]] = lambda plan, part: ()
    source: Callable[[Plan, Any], tuple[Location, FileDigests] | None] = lambda plan, part: None
    named: bool = False
    declares: tuple[Column, ...] = ()
    row_digests: bool = False
    bulky: bool = False
    check: bool | Callable[[Plan], bool] = False
    place: Literal["store", "deliver", "run"] = "store"

    def all_parts(self, plan: Plan) -> Sequence[Any]:
        """The parts of a run; none where it has not this stage."""
        if not self.when(plan):
            return ()
        if self.parts is not None:
            return self.parts(plan)
        if self.edge is not None:
            return plan.layout.blocks(self.edge(plan), self.margin)
        return plan.layout.tiles if self.over == "tile" else ("all",)

    def tasks(self, plan: Plan) -> Tasks:
        """A task for every part, made when it is asked for."""
        parts = self.all_parts(plan)
        return Tasks.of(self.name, parts, _Maker(self, plan)) if len(parts) else Tasks()

    def task(self, plan: Plan, part: Any) -> Task:
        """The task of one part."""
        return _Maker(self, plan)(part)

    def reach(self, plan: Plan) -> float:
        """Distance around a part's square that is read [m]."""
        return float(self.halo(plan) if callable(self.halo) else self.halo or 0.0)

    def box(self, plan: Plan, square: Tile) -> Box:
        """Where a part of `square` reads echoes."""
        return self.area(plan, square).grown(self.reach(plan))

    def columns_read(self, plan: Plan) -> dict[str, str]:
        """The columns that it reads under this plan, and the stage that writes each, as far as a record tells."""
        names = (*names_under(self.reads, plan), *names_under(self.own, plan)) if self.when(plan) else ()
        return {n: plan.providers[n] for n in names if n in plan.providers}

    def columns(self, plan: Plan) -> Names:
        """The columns that it writes under this plan."""
        return names_under(self.writes, plan) if self.when(plan) else ()


def names_under(columns: Columns, plan: Plan) -> Names:
    """The columns that a record names, under this plan, each once."""
    return tuple(dict.fromkeys(columns(plan) if callable(columns) else columns))


class _Maker:
    """Makes the tasks of a stage; what is the same for all of them is made once."""

    def __init__(self, stage: Stage, plan: Plan) -> None:
        self.stage, self.plan = stage, plan
        self.reads, self.own = names_under(stage.reads, plan), names_under(stage.own, plan)
        self.of_reads, self.of_own = self._stages(self.reads), self._stages(self.own)
        self.arguments = stage.arguments(plan)
        self.params = merge_disjoint(
            plain_values(self.arguments, stage.silent), plain_values(stage.keyed(plan), stage.silent)
        )
        self.writes = stage.columns(plan)
        self.halo = stage.reach(plan)
        self.check = stage.check(plan) if callable(stage.check) else stage.check
        self.size = plan.config.tile.size

    def _stages(self, names: Names) -> dict[str, str]:
        return self.plan.layout.columns(names) if names else {}

    def __call__(self, part: Any) -> Task:
        stage, plan = self.stage, self.plan
        name, square = stage.part_name(part), part if isinstance(part, Tile) else None
        present, within = self._around(name, square)
        read = ((s, t) for t in present for s in sorted({*self.of_reads.values(), "tile"})) if self.reads else ()
        mine = ((s, name) for s in sorted({*self.of_own.values(), "tile"})) if self.own else ()
        more_needs = tuple(stage.needs(plan, part))
        for other, _ in more_needs:
            if other not in stage.after:
                raise FwclassError(
                    "a stage needs a part of a stage that its record does not name",
                    where=stage.name,
                    expected=f"a stage of `after`: {', '.join(stage.after) or 'none'}",
                    got=other,
                )
        needs = tuple(dict.fromkeys((*read, *mine, *more_needs)))
        more = stage.each(plan, part)
        params = merge_disjoint(self.params, plain_values(more, stage.silent))
        location, external = stage.source(plan, part) or (None, ())
        here = partial(
            StageInputs,
            part=name,
            needs=needs,
            square=square,
            halo=self.halo,
            columns=self.of_reads,
            own=self.of_own,
            present=present,
            tile_size=self.size,
            source=location,
            writes=self.writes,
        )
        work = Work(stage.function, {**self.arguments, **more}, here, stage.row_digests, plan.declares)
        return Task(
            stage.name, name, stage.version, params, work, needs, external, stage.place, within, check=self.check
        )

    def _around(self, name: str, square: Tile | None) -> tuple[tuple[str, ...], Within]:
        """Tiles that echoes are read of, and within which box, or under which name."""
        if self.stage.named:
            return (), name
        if square is None:
            return (tuple(t.key for t in self.stage.tiles(self.plan)) if self.reads else ()), None
        if self.stage.halo is None:
            return (name,), None
        box = self.stage.area(self.plan, square).grown(self.halo)
        return (self.plan.layout.around(box, self.plan.layout.keys) if self.reads else (name,)), box
