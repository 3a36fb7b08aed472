"""The bytes of a text, made ready for a fast reader of separated values."""

from __future__ import annotations

from fwclass.kernel import kernel

TAB, NEWLINE, RETURN, SPACE, HASH = 9, 10, 13, 32, 35


@kernel
def tidy(text, collapse, out):  # type: ignore[no-untyped-def]
    """Copy `text` (uint8) to `out`, as long: without what stands between # and the end of a line.

    With `collapse` every run of blanks becomes one space, and none stays at the ends of a line. Line ends all stay.
    The number of bytes written.
    """
    n = 0
    comment = False
    pending = False
    fresh = True
    for i in range(len(text)):
        c = text[i]
        if c in (NEWLINE, RETURN):
            comment = pending = False
            fresh = True
            out[n] = c
            n += 1
        elif comment:
            continue
        elif c == HASH:
            comment = True
        elif collapse and (c == SPACE or (TAB <= c <= 12)):
            pending = not fresh
        else:
            if pending:
                out[n] = SPACE
                n += 1
                pending = False
            out[n] = c
            n += 1
            fresh = False
    return n
