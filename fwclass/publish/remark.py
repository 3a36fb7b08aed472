"""Remarks for a page's reader, who makes no run: what they mean, and apart from that what to set."""

from __future__ import annotations

import re

_FILES = "csv|gpkg|h5|html|jpg|json|las|laz|parquet|pls|plz|png|qgz|tif|txt|wdp|wdz|yaml|zarr"
_SETTING = rf"\b[a-z_]+(?:\.(?!(?:{_FILES})\b)[a-z_]+)+\b"
_VALUE = r"(?:=[^\s()]*)?"
_COMMAND = re.compile(rf"--[a-z]|`|{_SETTING}")
_ALONE = re.compile(rf" \({_SETTING}{_VALUE}(?:(?:, | and ){_SETTING}{_VALUE})*\)")
_ASIDE = re.compile(r" \(([^()]*)\)")
_CLAUSE = re.compile(r"[:;.] ")


def parted(text: str) -> tuple[str, str]:
    """What a remark means, and what whoever makes the next run can do, "" for nothing.

    A clause that names an option, a command or a setting is of the second kind, with all that follows, and so is such a
    clause in brackets; names of settings alone in brackets go. A remark that begins with such a clause stays whole.
    """
    said, advice = _ALONE.sub("", text), []
    for aside in _ASIDE.finditer(said):
        if _COMMAND.search(aside[1]):
            advice.append(aside[1])
            said = said.replace(aside[0], "", 1)
    if (command := _COMMAND.search(said)) is not None:
        ends = [m.end() for m in _CLAUSE.finditer(said, 0, command.start())]
        if not ends:
            return text, ""
        advice.insert(0, said[ends[-1] :])
        said = said[: ends[-1] - 2]
    return said if said.endswith(".") or not advice else f"{said}.", "; ".join(advice)
