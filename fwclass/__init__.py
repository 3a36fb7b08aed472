"""fwclass: classification of airborne full-waveform lidar surveys."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from fwclass.isolation import guard

__version__ = "0.1.0"
_LATER = {"open": "open_delivery", "process": "process"}
"""What Python users call, of `fwclass.delivery`; loaded with the first use: ``import fwclass`` takes no time."""

guard()


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'fwclass' has no attribute {name!r}")
    return getattr(import_module("fwclass.delivery"), _LATER[name])
