"""What messages are made of."""

from __future__ import annotations

from commandline import fwclass

from fwclass.errors import first_line


def test_a_fault_without_words_is_named_by_its_kind():
    """Libraries raise such; taking the first of no lines ended in a traceback."""
    assert first_line(ValueError("one\ntwo")) == "one"
    assert first_line(OSError()) == "OSError"
    assert first_line(KeyError("")) == "''"
    assert first_line(ValueError("\n")) == "ValueError"
    assert len(first_line(ValueError("x" * 1000))) == 200


def test_memory_that_runs_out_is_told_in_words(tmp_path, monkeypatch):
    """It was a traceback, of whatever asked for some last."""

    def greedy(path):
        raise MemoryError("Unable to allocate 2.89 MiB for an array")

    monkeypatch.setattr("fwclass.read.info.info", greedy)
    (tmp_path / "a.las").write_bytes(b"LASF")
    ended = fwclass("info", tmp_path / "a.las")
    assert ended.returncode == 1 and "memory ran out" in ended.stderr and "2.89 MiB" in ended.stderr, ended.stderr
