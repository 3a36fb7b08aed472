"""What was answered, frame by frame: an Arrow stream that is whole after every frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.street.frames import Placed
from fwclass.street.recording_columns import MOST_BEAMS
from fwclass.street.sphere_kernels import UNIT

ANSWERS = "answers.arrows"
"""Name of the file: Arrow's streaming format, which every Arrow library reads."""

END = b"\xff\xff\xff\xff\x00\x00\x00\x00"
"""End of an Arrow stream."""


@dataclass(frozen=True)
class Answer:
    """A frame and its classes.

    Attributes
    ----------
    number, time [s], place [m along the road].
    classification : uint8 (beams,), class codes, 0 without a return. confidence : uint8 (beams,) [%].
    y, z : float32 (beams,), to the left and above the scanner [m]; NaN without a return.
    x : likewise, ahead of the scanner; (0,) where the scan plane is at right angles to the road.
    """

    number: int
    time: float
    place: float
    classification: NDArray[np.uint8]
    confidence: NDArray[np.uint8]
    y: NDArray[np.float32]
    z: NDArray[np.float32]
    x: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))

    @property
    def along(self) -> NDArray[np.float64]:
        """float64 (beams,): where every return lies along the road [m]; NaN without a return."""
        return self.place + (self.x.astype(np.float64) if len(self.x) else np.where(np.isnan(self.y), np.nan, 0.0))


LISTS = {"classification": pa.uint8(), "confidence": pa.uint8(), "y": pa.float32(), "z": pa.float32()}
LEANING = {**LISTS, "x": pa.float32()}
"""Columns with a value a beam, and those of a scanner that yaw or pitch turn along the road."""


def make_answer(frame: Placed, codes: NDArray[np.uint8], shares: NDArray[np.float64]) -> Answer:
    """The answer to a frame from codes and shares of its returns, in the order of the beams."""
    here = ~np.isnan(frame.r)
    classification, confidence = np.zeros(len(here), np.uint8), np.zeros(len(here), np.uint8)
    classification[here] = codes
    confidence[here] = np.rint(100.0 * shares)
    y, z, x = (
        np.where(here, v * UNIT, np.nan).astype(np.float32) if len(v) else np.empty(0, np.float32)
        for v in (frame.y, frame.z, frame.x)
    )
    return Answer(frame.number, frame.time, frame.place * UNIT, classification, confidence, y, z, x)


class Writer:
    """Bytes of the stream: `head` once, then `frame` by frame. Same answers, same bytes.

    `leaning`: the returns of a frame have places of their own along the road (`Geometry.tilted`).
    """

    def __init__(self, beams: int, leaning: bool = False) -> None:
        self._lists = LEANING if leaning else LISTS
        lists = [pa.field(n, pa.list_(kind, beams)) for n, kind in self._lists.items()]
        head = [pa.field("frame", pa.int64()), pa.field("time", pa.float64()), pa.field("place", pa.float64())]
        self.schema = pa.schema([*head, *lists])

    @property
    def head(self) -> bytes:
        """What the stream begins with."""
        return bytes(self.schema.serialize())

    def frame(self, answer: Answer) -> memoryview:
        """One message; written by one call it is there whole or not at all."""
        columns: list[Any] = [pa.array([answer.number], pa.int64()), pa.array([answer.time], pa.float64())]
        columns.append(pa.array([answer.place], pa.float64()))
        for name, kind in self._lists.items():
            values = getattr(answer, name)
            flat = pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(np.ascontiguousarray(values))])
            columns.append(pa.FixedSizeListArray.from_arrays(flat, len(values)))
        return memoryview(pa.RecordBatch.from_arrays(columns, schema=self.schema).serialize())


def read_answers(path: Path) -> Iterator[Answer]:
    """The answers of a file, up to the last whole frame; `InputError` for what is no such file."""
    try:
        with pa.OSFile(str(path)) as file:
            stream = pa.ipc.open_stream(file)
            leaning = "x" in stream.schema.names
            names = ["frame", "time", "place", *(LEANING if leaning else LISTS)]
            beams = stream.schema.field("classification").type.list_size if stream.schema.names == names else 0
            if not 0 < beams <= MOST_BEAMS or stream.schema != Writer(beams, leaning).schema:
                raise _foreign(path, "other columns")
            while True:
                try:
                    batch = stream.read_next_batch()
                except StopIteration:
                    return
                except (pa.ArrowException, OSError):  # the last frame was cut
                    return
                yield from _rows(batch)
    except (pa.ArrowException, OSError, KeyError) as fault:
        raise _foreign(path, str(fault)[:200]) from fault


def _rows(batch: pa.RecordBatch) -> Iterator[Answer]:
    for row in range(batch.num_rows):
        number, time, place = (batch.column(k)[row].as_py() for k in range(3))
        lists = [
            np.asarray(batch.column(k)[row].values.to_numpy(zero_copy_only=False)) for k in range(3, batch.num_columns)
        ]
        yield Answer(number, time, place, *lists)


def _foreign(path: Path, got: str) -> InputError:
    return InputError(
        "this is no file of answers",
        where=path,
        expected=f"{ANSWERS} of `fwclass street run` or `classify`",
        got=got,
        do="check the path",
    )
