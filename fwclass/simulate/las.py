"""Writing strips as a sensor's software does: LAS points, waveform packets in a WDP beside, reference labels."""

from __future__ import annotations

import struct
from datetime import timedelta
from pathlib import Path
from types import TracebackType
from typing import Any

import laspy
import numpy as np
import pyproj
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.simulate.params import Recording, SimulateParams
from fwclass.units import ADJUSTED, GPS_EPOCH, QUANTUM

WDP_HEADER = 60
"""Bytes of the extended variable length record header that opens a WDP file; packets follow."""

SHORT, LONG = 1, 2
"""Descriptor indices of the two segment lengths."""

PICOSECONDS = 1000
"""Sample spacing [ps]."""

INTENSITY_SCALE = 64.0
"""Intensity of a return per DN of its peak."""

_RANGE_KNOWN = 0b110
"""Options of an extra byte: its minimum and its maximum are stated."""

REFERENCE_EXTRA = (("amplitude", "f4", "height of the echo [DN]"), ("width", "f4", "full width at half maximum [ns]"))


class PacketWriter:
    """A WDP file; `append` gives the byte offset of the first of the new packets."""

    def __init__(self, path: Path, bits: int) -> None:
        self._file = path.open("wb")
        self._dtype = np.dtype("<u1" if bits == 8 else "<u2")
        self.size = WDP_HEADER
        self._file.write(self._header())

    def _header(self) -> bytes:
        return struct.pack("<H16sHQ32s", 0, b"LASF_Spec", 65535, self.size - WDP_HEADER, b"Waveform Data Packets")

    def append(self, samples: NDArray[np.uint16]) -> int:
        """Write `samples` (samples,) [counts]; the byte offset of the first."""
        first = self.size
        data = samples.astype(self._dtype)
        self._file.write(data.tobytes())
        self.size += data.nbytes
        return first

    def __enter__(self) -> PacketWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._file.seek(0)
            self._file.write(self._header())
        self._file.close()


def descriptor(index: int, bits: int, samples: int) -> laspy.VLR:
    """Waveform packet descriptor `index` (1 to 255) of so many `samples` of `bits` each; one without samples is a
    placeholder, as sensors leave them."""
    spacing = PICOSECONDS if samples else 0
    return laspy.VLR(
        user_id="LASF_Spec",
        record_id=99 + index,
        description="Waveform Packet Descriptor",
        record_data=struct.pack("<BBIIdd", bits, 0, samples, spacing, 1.0, 0.0),
    )


def _header(params: SimulateParams, version: str, point_format: int) -> laspy.LasHeader:
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales = np.full(3, QUANTUM)
    header.offsets = np.array([params.origin_x, params.origin_y, params.base_height])
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.system_identifier = "fwclass simulated scanner"
    header.generating_software = "fwclass simulate"
    header.creation_date = GPS_EPOCH.date() + timedelta(seconds=params.flight.first_gps_time + ADJUSTED)
    header.add_crs(_crs(params))
    return header


def _crs(params: SimulateParams) -> pyproj.CRS:
    try:
        crs = pyproj.CRS.from_user_input(params.crs)
    except pyproj.exceptions.CRSError as error:
        raise ConfigError(
            "unknown coordinate reference system",
            where="simulate.crs",
            expected="for example EPSG:25832",
            got=params.crs,
            do="correct simulate.crs in the configuration",
        ) from error
    if not crs.is_projected:
        raise ConfigError(
            "the survey's coordinate reference system is not projected",
            where="simulate.crs",
            expected="metres, for example EPSG:25832",
            got=params.crs,
            do="choose a projected system",
        )
    return crs


def strip_header(params: SimulateParams, recording: Recording) -> laspy.LasHeader:
    """Header of a strip, with a packet descriptor for each length of waveform."""
    header = _header(params, recording.las, recording.point_format)
    header.global_encoding.waveform_data_packets_external = True
    sensor = params.sensor
    lengths = (sensor.short_segment, sensor.long_segment) + (0,) * params.empty_descriptors
    for index, samples in enumerate(lengths, start=1):
        header.vlrs.append(descriptor(index, recording.bits, samples))
    return header


def reference_header(params: SimulateParams) -> laspy.LasHeader:
    """Header of the file of true echoes, LAS 1.4, with extra bytes for what is known of them."""
    header = _header(params, "1.4", 6)
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind, text) for name, kind, text in REFERENCE_EXTRA])
    for record in header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
        record.options &= ~_RANGE_KNOWN  # laspy 2.7 would state the range of each chunk's first point only
    return header


def write_points(writer: Any, columns: dict[str, NDArray]) -> None:
    """Append points; `x`, `y`, `z` are relative to the header's offsets [m], the rest laspy's field names."""
    count = len(columns["x"])
    record = laspy.ScaleAwarePointRecord.zeros(count, header=writer.header)
    for axis in "xyz":
        record[axis.upper()] = np.rint(columns[axis] / QUANTUM).astype(np.int32)
    for name, values in columns.items():
        if name not in "xyz":
            record[name] = values
    writer.write_points(record)


def packet_columns(
    index: NDArray, offset: NDArray, size: NDArray, location: NDArray, direction: NDArray, metres: float
) -> dict[str, NDArray]:
    """Wave packet fields; `location` [ns], `direction` the unit vector down the beam, `metres` per ns.

    The stored vector is in metres per picosecond and points up the beam, back to the sensor: the position at
    sample time t is P_return + (location − t) · vector.
    """
    up = -direction * (metres / 1000.0)
    return {
        "wavepacket_index": index,
        "wavepacket_offset": offset,
        "wavepacket_size": size,
        "return_point_wave_location": location * 1000.0,
        "x_t": up[:, 0],
        "y_t": up[:, 1],
        "z_t": up[:, 2],
    }
