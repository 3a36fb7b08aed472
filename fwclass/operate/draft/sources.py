"""How a draft names its sources and itself, by where the files lie."""

from __future__ import annotations

import glob
import os
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path


def sources_of(paths: Sequence[Path], beside: Path, whole: bool) -> tuple[str, list[str]]:
    """`survey.directory` and `survey.sources` for files, seen from the directory `beside`.

    One pattern for each ending where the files are all of their directory with these endings, else their names.
    `whole`: it was the directory that was named, so that one file is all of it too.
    """
    own = [p.resolve() for p in paths]
    home = Path(os.path.commonpath([p.parent for p in own]))
    below = home.is_relative_to(beside.resolve())
    base = beside.resolve() if below else home
    directory = "." if below else str(home)
    endings = {p.suffix for p in own}
    alike = all(p.parent == home for p in own) and (whole or len(own) > 1)
    if alike and set(own) == {p.resolve() for p in home.iterdir() if p.suffix in endings}:
        return directory, [f"{_literal(home, base)}*{ending}" for ending in sorted(endings)]
    return directory, sorted(_literal(p, base).rstrip("/") for p in own)


def _literal(path: Path, base: Path) -> str:
    """`path` from `base` on as a pattern that matches it alone; with a slash behind unless it is `base`."""
    return "".join(f"{glob.escape(part)}/" for part in path.relative_to(base).parts)


def name_of(paths: Sequence[Path], directory: Path | None) -> str:
    """The name of the directory that was named, else the one file's, or that of the directory that holds all."""
    own = [p.resolve() for p in paths]
    if directory is not None:
        home = directory.resolve().name
    else:
        home = own[0].stem if len(own) == 1 else Path(os.path.commonpath([p.parent for p in own])).name
    return re.sub(r"[^\w .-]", "-", unicodedata.normalize("NFC", home)).lstrip("- .")[:100] or "survey"
