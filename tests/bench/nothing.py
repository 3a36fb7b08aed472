"""Work that does nothing, where workers can import it: a function of the program that is started travels whole."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from fwclass.run.inputs import PartInputs


def nothing(inputs: PartInputs, directory: Path) -> Mapping[str, object]:
    """Write an empty file."""
    (directory / "nothing.txt").write_text("")
    return {}


def waiting(seconds: float, inputs: PartInputs, directory: Path) -> Mapping[str, object]:
    """Take so long, and no processor."""
    time.sleep(seconds)
    return nothing(inputs, directory)
