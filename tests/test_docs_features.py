"""The tables of docs/features.md are those of the declarations."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from fwclass.columns import FEATURES
from fwclass.conf.sets import feature_set, shipped_sets

PAGE = Path(__file__).resolve().parents[1] / "docs" / "features.md"


def tables() -> dict[str, str]:
    """The generated tables, by name."""
    rows = ["| feature | over | unit | formula | source |", "|---|---|---|---|---|"]
    rows += [
        f"| `{c.name}` | {c.scales} | {c.unit} | {c.meaning.replace('|', chr(92) + '|')} | {c.source} |"
        for c in FEATURES
    ]
    sets = ["| set | features | |", "|---|---|---|"]
    sets += [f"| `{s.name}` | {len(s.features)} | {s.about} |" for s in map(feature_set, shipped_sets())]
    return {"features": "\n".join(rows), "sets": "\n".join(sets)}


def filled(text: str) -> str:
    for name, table in tables().items():
        text = re.sub(
            rf"(<!-- table: {name} -->\n).*?(<!-- end -->)",
            lambda m, t=table: f"{m[1]}\n{t}\n\n{m[2]}",
            text,
            flags=re.S,
        )
    return text


def test_the_page_shows_the_declared_features_and_sets():
    """`python tests/test_docs_features.py write` brings the page up to date."""
    text = PAGE.read_text(encoding="utf-8")
    assert text == filled(text)


if __name__ == "__main__" and sys.argv[1:] == ["write"]:
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
