"""Commands on the pages are those of the command line, and the keys of a survey's file those that it takes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import click
import pytest
import yaml
from pydantic import BaseModel

from fwclass.cli import cli
from fwclass.conf.sections import AreaFilesSection, AreasSection, ClassSection, ReferenceSection, SurveySection

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(?:sh|console|bash)?\n(.*?)^```", re.M | re.S)
TABLES: dict[str, type[BaseModel]] = {
    "survey": SurveySection,
    "survey.classes, each": ClassSection,
    "survey.reference": ReferenceSection,
    "areas": AreasSection,
    "areas.train and areas.test by files, each": AreaFilesSection,
}
LEFT_OUT = {"codes": "[code]", "name": "required", "code": "required", "sources": "required"}


def lines(page: Path) -> list[str]:
    """Every line on the page that calls the command, without what follows a comment sign."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    blocks = "\n".join(BLOCK.findall(text))
    indented = re.findall(r"^    (fwclass .*)$", BLOCK.sub("", text), re.M)
    fenced = re.findall(r"^(?:\$ )?(fwclass .*)$", blocks, re.M)
    return [re.sub(r"\s+#.*", "", line) for line in (*fenced, *indented)]


def command_of(words: list[str]) -> tuple[click.Command, list[str]]:
    """The command that `words` call, and its own words."""
    command: click.Command = cli
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"no command {words[0]}"
        command, words = command.commands[words[0]], words[1:]
    return command, words


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_and_option_on_a_page_exists(page: Path) -> None:
    for line in lines(page):
        words = re.split(r"\s[|>&;]", line)[0].replace("…", "").replace("[", "").replace("]", "")
        command, rest = command_of(shlex.split(words)[1:])
        known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
        known |= {"--help", "-h"} | ({"--version"} if command is cli else set())
        assert not [w for w in rest if w.startswith("--") and w.split("=")[0] not in known], line


def test_pages_are_read() -> None:
    assert sum(len(lines(page)) for page in PAGES) > 100


def test_the_page_of_commands_has_them_all() -> None:
    called = {command_of(shlex.split(line)[1:])[0].name for line in lines(ROOT / "docs" / "commands.md")}
    assert {name for name, command in cli.commands.items() if not isinstance(command, click.Group)} <= called


def test_the_first_screen_of_the_readme_has_five_commands() -> None:
    use = (ROOT / "README.md").read_text().split("## Use\n")[1].split("\n## ")[0]
    assert len(re.findall(r"^fwclass ", use, re.M)) == 5


def rows(title: str) -> dict[str, str]:
    """Defaults by key, of the table below a heading."""
    text = (ROOT / "docs" / "survey-file.md").read_text().split(f"\n## {title}\n")[1].split("\n## ")[0]
    return dict(re.findall(r"^\| `(\w+)` \| (.*?) \|", text, re.M))


@pytest.mark.parametrize("title", TABLES)
def test_the_table_of_keys_is_whole_and_its_defaults_hold(title: str, base: dict[str, Any]) -> None:
    table, model = rows(title), TABLES[title]
    assert set(table) == {n for n in model.model_fields if not n.endswith("_by")}
    written = base
    for name in [] if title.endswith("each") else title.split("."):
        written = written[name]
    for key, cell in table.items():
        if cell.strip("`") == LEFT_OUT.get(key):
            continue
        own = model.model_fields[key].default
        expected = written.get(key, list(own) if isinstance(own, tuple) else own)
        assert yaml.safe_load(cell.strip("`")) == expected, key


def test_required_keys_are_required() -> None:
    for model, keys in ((SurveySection, ("name", "sources")), (ClassSection, ("name", "code"))):
        for key in keys:
            assert model.model_fields[key].is_required()
    assert ClassSection.model_validate({"name": "roof", "code": 6}).codes == (6,)
