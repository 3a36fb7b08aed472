"""A recording by its path, whatever kind it is."""

from __future__ import annotations

from pathlib import Path

from fwclass.errors import InputError
from fwclass.street.frames import Recording, Scan
from fwclass.street.recording_bag import BagRecording
from fwclass.street.recording_csv import CsvRecording
from fwclass.street.recording_parquet import ParquetRecording

KINDS = "Parquet or CSV of frames, a ROS 1 bag, a ROS 2 bag's directory (sqlite3 or MCAP), a mobile LAS or LAZ"


def open_recording(path: Path, scan: Scan, topic: str | None = None) -> Recording:
    """The recording at `path`; `scan` holds where it does not say itself, `topic` chooses in a bag."""
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return BagRecording(path, scan, topic)
        raise InputError("this directory is no recording", where=path, expected=KINDS, do="check the path")
    if not path.exists():
        raise InputError("no such recording", where=path, expected=KINDS, do="check the path")
    with path.open("rb") as stream:
        head = stream.read(16)
    if head.startswith(b"#ROSBAG") or path.suffix in (".bag", ".mcap", ".db3"):
        return BagRecording(path, scan, topic)
    if head.startswith(b"PAR1"):
        return ParquetRecording(path, scan)
    if path.suffix.lower() in (".csv", ".txt"):
        return CsvRecording(path, scan)
    raise InputError(
        "this is no recording that can be read", where=path, expected=KINDS, got=repr(head), do="check the path"
    )
