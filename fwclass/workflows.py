"""The workflows by name: in `workflows` at the top of a checkout, in `_workflows` of an installed package.

So an installed fwclass claims no top-level name but its own: ``fwclass.workflows.classification`` is a file of either.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from fwclass.errors import ConfigError, nearest

if TYPE_CHECKING:
    from fwclass.walk.workflow import Workflow


_HERE = Path(__file__).resolve().parent
_INSTALLED = _HERE / "_workflows"
__path__ = [str(_INSTALLED if _INSTALLED.is_dir() else _HERE.parent / "workflows")]
"""Where ``import fwclass.workflows.NAME`` looks."""


class _Named(Mapping[str, "Workflow"]):
    """Workflows by name; each stands in the file of its name, which is imported when it is taken."""

    papers = ("fan2013", "he2023", "li2018", "shi2019", "xiong2018")
    names = ("classification", *papers, "backscatter", "ground", "quality")

    def __getitem__(self, name: str) -> Workflow:
        if name not in self.names:
            raise KeyError(name)
        workflow: Workflow = getattr(import_module(f"{__name__}.{name}"), name)
        return workflow

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)


WORKFLOWS: Mapping[str, Workflow] = _Named()
"""Workflows by the name that `fwclass run --workflow` takes."""


def workflow_of(name: str) -> Workflow:
    """The workflow of a name, or of the user's own file where the name ends in ``.py``; `ConfigError` for none."""
    if name.endswith(".py"):
        from fwclass.walk.own_workflow import own_workflow

        return own_workflow(Path(name))
    if name not in WORKFLOWS:
        raise ConfigError("no such workflow", where="--workflow", got=name, do=nearest(name, WORKFLOWS))
    return WORKFLOWS[name]
