"""What messages are made of."""

from __future__ import annotations

from fwclass.errors import first_line


def test_a_fault_without_words_is_named_by_its_kind():
    """Libraries raise such; taking the first of no lines ended in a traceback."""
    assert first_line(ValueError("one\ntwo")) == "one"
    assert first_line(OSError()) == "OSError"
    assert first_line(KeyError("")) == "''"
    assert first_line(ValueError("\n")) == "ValueError"
    assert len(first_line(ValueError("x" * 1000))) == 200
