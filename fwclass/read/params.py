"""Parameters of reading."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from fwclass.params import Params


class ReadParams(Params):
    """Parameters of reading; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    chunk_pulses : pulses of a span, about.
    max_span_points : points of the longest span that memory allows.
    missing_packets : ``error`` stops at a file that declares waveforms none of which can be read; ``keep`` takes
        its returns as echoes.
    project_to : projected system in metres (EPSG:…, or WKT) that places and beams of files in degrees, in feet, or
        geocentric, are brought into; null: such files are refused.
    use_flagged : take points that their source flags as withheld or synthetic like all others; else no ground is made
        of them, and they neither train nor are tested.
    sensor_ranges : take the distances from the sensor that pulses carry; false: where these are wrong.
    mirror_beams : turn the horizontal parts of all beams round, which old converters stored with the wrong sign.
    """

    chunk_pulses: int = Field(gt=0, le=100_000_000)
    max_span_points: int = Field(gt=0, le=2_000_000_000)
    missing_packets: Literal["error", "keep"]
    project_to: str | None
    use_flagged: bool
    sensor_ranges: bool
    mirror_beams: bool
