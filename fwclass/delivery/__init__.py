"""A finished run in Python: `fwclass.open(run)` and `fwclass.process(survey)`."""

from __future__ import annotations

from fwclass.delivery.opened import Delivery, open_delivery
from fwclass.delivery.process import process

__all__ = ["Delivery", "open_delivery", "process"]
