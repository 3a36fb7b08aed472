"""Work that does nothing, where workers can import it: a function of the program that is started travels whole."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fwclass.run.inputs import PartInputs


def nothing(inputs: PartInputs, directory: Path) -> Mapping[str, object]:
    """Write an empty file."""
    (directory / "nothing.txt").write_text("")
    return {}
