"""Outputs of commands: whole, and of one command alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from fwclass.errors import ConfigError
from fwclass.publish.files import check_free, whole


def test_what_another_command_writes_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    target = tmp_path / "out.laz"
    check_free(target, False)
    with pytest.raises(ConfigError, match="another command has written the output"), whole(target) as beside:
        beside.write_text("mine")
        target.write_text("theirs")
    assert target.read_text() == "theirs" and [p.name for p in tmp_path.iterdir()] == ["out.laz"]


def test_with_overwrite_only_what_stood_there_is_replaced(tmp_path: Path) -> None:
    target = tmp_path / "out.laz"
    target.write_text("old")
    with pytest.raises(ConfigError, match="the output exists"):
        check_free(target, False)
    check_free(target, True)
    for text in ("first", "second"):
        with whole(target) as beside:
            beside.write_text(text)
        assert target.read_text() == text
    with pytest.raises(ConfigError, match="another command"), whole(target) as beside:
        beside.write_text("third")
        target.unlink()
        target.write_text("theirs")
    assert target.read_text() == "theirs"


def test_a_file_system_without_hard_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    check_free(tmp_path / "out.laz", False)
    with whole(tmp_path / "out.laz") as beside:
        beside.write_text("mine")
    assert (tmp_path / "out.laz").read_text() == "mine"
