"""What a file of labels by echo holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import visible
from fwclass.formats.echo_labels import TAKEN_BACK, read_echo_labels


def echo_labels_info(path: Path) -> dict[str, Any]:
    """Contents of labels by echo, or corrections, as plain data for JSON: rows, echoes, which code how often (``null``
    takes earlier rows back), and the echoes' bounds [m].

    `InputError`: the file is damaged.
    """
    labels = read_echo_labels(path, path)
    codes, counts = np.unique(labels.code, return_counts=True)
    low_high = [float(f(getattr(labels, n))) for f in (np.min, np.max) for n in "xyz"] if labels.rows else None
    return {
        "path": str(path),
        "size": path.stat().st_size,
        "labels": labels.rows,
        "echoes": len(np.unique(labels.key)),
        "codes": {
            "null" if c == TAKEN_BACK else str(c): n for c, n in zip(codes.tolist(), counts.tolist(), strict=True)
        },
        "bounds": low_high,
        "faults": [] if labels.rows else ["no label"],
    }


def describe_echo_labels(info: dict[str, Any]) -> str:
    """`echo_labels_info` for a terminal."""
    box = info["bounds"]
    rows = [
        ("file", f"{info['path']}  ({info['size']:,} bytes)"),
        ("format", "labels by echo (survey.reference.kind: echoes)"),
        ("labels", f"{info['labels']:,} of {info['echoes']:,} echoes"),
        ("class", ", ".join(f"{code}: {n:,}" for code, n in info["codes"].items()) or "none"),
        (
            "bounds",
            "x {0:.10g} to {3:.10g}, y {1:.10g} to {4:.10g}, z {2:.6g} to {5:.6g}".format(*box) if box else "none",
        ),
    ]
    lines = [f"{name:<12} {visible(text)}" for name, text in rows]
    lines += [f"  ! {fault}" for fault in info["faults"]] or ["  no faults found"]
    return "\n".join(lines)
