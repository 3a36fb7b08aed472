"""What a run was asked for: kept in the run directory, so that it can be looked at and parts of it replayed."""

from __future__ import annotations

import shlex
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fwclass.errors import ConfigError, DamagedError, StoreError, visible
from fwclass.store.generations import Generation
from fwclass.store.run_store import Store
from fwclass.store.seal import seal, unseal
from fwclass.store.url import Url

_KEPT = "run.json"

if TYPE_CHECKING:
    from fwclass.survey.area_of_interest import Area


@dataclass(frozen=True)
class Request:
    """The words of ``fwclass run`` that decide which parts there are, and from what.

    `conf`: absolute path or shipped name; `root`: the run directory, or its address; `tiles`: None for all; `aoi`: a
    file of polygons.
    """

    conf: str
    root: str
    settings: tuple[str, ...] = ()
    workflow: str = "classification"
    tiles: tuple[str, ...] | None = None
    aoi: str | None = None

    @classmethod
    def of(
        cls, conf: Path, root: Path | Url, settings: tuple[str, ...], workflow: str, tiles: frozenset[str] | Path | None
    ) -> Request:
        """As typed; paths are made absolute, so that the command holds wherever it is given.

        Settings of the section `schedule` are left out: no part depends on them, and they may hold secrets.
        """
        settings = tuple(s for s in settings if not s.strip().startswith("schedule."))
        named = str(conf.resolve()) if conf.is_file() else str(conf)
        aoi = str(tiles.resolve()) if isinstance(tiles, Path) else None
        keys = tuple(sorted(tiles)) if isinstance(tiles, frozenset) else None
        where = root if isinstance(root, Url) else root.resolve()
        return cls(named, str(where), settings, workflow, keys, aoi)

    @property
    def wanted(self) -> frozenset[str] | Area | None:
        """What the run is restricted to, None for nothing."""
        if self.aoi is not None:
            from fwclass.survey.area_of_interest import Area

            return Area(Path(self.aoi))
        return None if self.tiles is None else frozenset(self.tiles)

    def command(self, only: tuple[str, str] | None = None) -> str:
        """The command that does this again, or that replays the one part `only` (stage, part)."""
        return shlex.join(["fwclass", *self.words(only)])

    def words(self, only: tuple[str, str] | None = None) -> list[str]:
        """`command` as words, without the program."""
        words = ["run", self.conf, "--out", self.root]
        for setting in self.settings:
            words += ["--set", setting]
        if self.workflow != "classification":
            words += ["--workflow", self.workflow]
        if only is not None:
            words += ["--only", "/".join(only)]
        elif self.tiles is not None:
            words += ["--tiles", ",".join(self.tiles)]
        elif self.aoi is not None:
            words += ["--aoi", self.aoi]
        return words

    def replay(self, name: tuple[str, str]) -> str:
        """The command that makes the part `name` alone."""
        return self.command(name)

    def keep(self, store: Store, shown: Generation | None = None, workflow: str | None = None) -> None:
        """Write it into the run (the holder of the lock calls this), with the `workflow` that the delivery `shown` is
        of, where that is known."""
        of = None if shown is None or workflow is None else [shown.name, workflow]
        store.keep(_KEPT, seal({n: v for n, v in asdict(self).items() if n != "root"} | {"shown": of}))

    @staticmethod
    def workflow_of_shown(store: Store, shown: Generation | None) -> str | None:
        """The workflow that made the delivery `shown`, None where nothing tells: the last run may have made none."""
        try:
            plain = unseal(store.recall(_KEPT) or {})
            if "shown" not in plain:  # kept before it was
                return str(plain["workflow"])
            name, workflow = plain["shown"]
            return str(workflow) if shown is not None and name == shown.name else None
        except (KeyError, TypeError, ValueError, DamagedError):
            return None

    @classmethod
    def kept(cls, store: Store, own: str | None = None) -> Request:
        """What the last run in `store` was asked for; `StoreError` where nothing tells.

        A workflow's file is code, which a run directory cannot have started: it must be named as `own` by the user.
        """
        where, plain = store.where, store.recall(_KEPT)
        if plain is None:
            raise StoreError(
                "nothing tells which configuration this run is of",
                where=where,
                expected=f"store/{_KEPT}, which every run writes",
                do=f"run it once more (what is done is kept), or, for its status, name the configuration: "
                f"fwclass status CONF --out {shlex.quote(str(where))}",
            )
        try:
            plain = unseal(plain)
            tiles, aoi = plain["tiles"], plain["aoi"]
            root = str(where if isinstance(where, Url) else where.resolve())
            workflow = str(plain["workflow"])
            if workflow.endswith(".py") and (own is None or str(Path(own).resolve()) != workflow):
                raise ConfigError(
                    "this run is of a workflow's file, whose code a run directory cannot have started",
                    where=where,
                    expected=f"--workflow {shlex.quote(workflow)}",
                    got="no --workflow" if own is None else f"--workflow {own}",
                    do="name the file yourself, if you trust it",
                )
            return cls(
                str(plain["conf"]),
                root,
                _words(plain["settings"]),
                str(plain["workflow"]),
                None if tiles is None else _words(tiles),
                None if aoi is None else str(aoi),
            )
        except (KeyError, TypeError, ValueError) as fault:
            raise DamagedError(
                "not the words of a run", where=f"{where}/store/{_KEPT}", got=fault, do="remove the file"
            ) from fault


def replaced(earlier: str | None, workflow: str, before: Generation, keep: int) -> list[str]:
    """What to say of a delivery `before` that another workflow's has replaced; nothing of one by the same."""
    if earlier in (None, workflow):
        return []
    return [
        f"showed what the workflow {earlier} delivered, and shows what {workflow} does now; the earlier delivery is "
        f"its {visible(before.key)}, and goes after {keep} more (run.keep_generations); --out gives every workflow a "
        "directory of its own"
    ]


def _words(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        raise TypeError(f"{value!r} is no list of words")
    return tuple(value)
