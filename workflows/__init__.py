"""One file per workflow: which stages, in which order; composition only. Imported as `fwclass.workflows`."""

from __future__ import annotations

from fwclass.workflows import WORKFLOWS, workflow_of

__all__ = ["WORKFLOWS", "workflow_of"]
