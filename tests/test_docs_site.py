"""The documentation builds as a site, strictly; pages fetch nothing from elsewhere, and name files that are there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FETCHED = re.compile(
    r"<(?:script|img|iframe)[^>]*src=[\"'](https?:)?//|<link[^>]*href=[\"'](https?:)?//[^\"']*\.(?:css|woff|ico)"
)


@pytest.mark.slow
def test_the_site_builds_and_stands_alone(tmp_path: Path) -> None:
    made = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert made.returncode == 0, made.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) >= len(list((ROOT / "docs").glob("*.md")))
    for page in pages:
        assert not FETCHED.search(page.read_text(encoding="utf-8")), page.name


def test_the_map_of_the_code_has_every_package_and_no_other() -> None:
    room = re.compile(r"`([a-z_]+)/`")
    table = (
        (ROOT / "README.md").read_text(encoding="utf-8").split("## Where to look in the code\n")[1].split("\n## ")[0]
    )
    named = {name for line in table.splitlines() if line.startswith("| `") for name in room.findall(line)}
    packages = {p.parent.name for p in (ROOT / "fwclass").glob("*/__init__.py")}
    assert named - {"workflows", "fwclass", "methods", "page"} == packages


def test_files_that_the_page_of_extensions_names_are_there() -> None:
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:fwclass|conf)/[\w/.]+\.(?:py|yaml|json))`", page))
    assert len(named) > 20 and not [name for name in named if not (ROOT / name).exists()]
