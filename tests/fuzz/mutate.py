"""Damage to files as text: a recipe says what is changed where, so that no damaged file has to be kept.

An operation is ``FILE:AT-END=HEX`` (bytes [AT, END) are replaced), ``FILE:AT-END=HEX*N`` (by N times HEX) or
``FILE:FROM-TO>AT`` (bytes [FROM, TO) are written over those at AT), or one of `forge.py`. A recipe is
operations joined by ``;``.
"""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from forge import forged, forgery

Files = dict[str, bytes]
"""Content by name."""

WHOLE = {
    1: (0, 1, 2, 127, 128, 254, 255),
    2: (0, 1, 2, 0x7FFF, 0x8000, 0xFFFE, 0xFFFF),
    4: (0, 1, 2, 60, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF, 100_000_000),
    8: (0, 1, 60, 2**31, 2**32, 2**63 - 1, 2**63, 2**64 - 1, 2**56, 10**12),
}
REAL = tuple(
    struct.pack("<d", v) for v in (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, 0.0, -1.0, 1e-9)
)
NUMBERS = (
    b"0",
    b"-1",
    b"1e308",
    b"-1e308",
    b"1e-320",
    b"1e999",
    b"nan",
    b"inf",
    b"NaN",
    b"1" + b"0" * 12,
    b"9",
    b"0x",
    b".nan",
    b".inf",
    b"1_000",
    b"01",
    b"65536",
    b"4294967296",
    b"18446744073709551616",
    b"1:2:3",
    b"2001-99-99",
)
WORDS = (
    b"null",
    b"true",
    b"''",
    b"[]",
    b"{}",
    b"[[], {}]",
    b"!!python/object/apply:os.system [id]",
    b"!!binary x",
    b"*a",
    b"!!timestamp x",
    b"&a [*a, *a]",
    b"? [a, b] : c",
    b"<<: {a: b}",
    b'"../../x"',
    b"/etc/passwd",
    b'"\\u0000"',
    b"'\\x1b[31m'",
    b"<script>",
    b"a\x00b",
    b"\xff\xfe",
    b"a\nb",
    b"%",
    b"@",
    b"- - - -",
    b"#",
    b",",
    b";;;",
    b"\t",
    b"EPSG:0",
    b"[",
    b"{a: ",
    b'{"a":',
    b"- ",
    b"&x [a, a, a, a]",
    b"a",
)
OPENING = (b"9", b"[", b"{a: ", b'{"a":', b"- ", b"a")
"""These are written many times."""
TOKEN = re.compile(rb"[-+.\w]*\d[-+.\w]*|[A-Za-z_][\w-]*|[\[\]{}:,]")


@dataclass(frozen=True)
class Field:
    """Bytes [`at`, `at` + `size`) of file `name` that mean one number."""

    name: str
    at: int
    size: int


def applied(files: Mapping[str, bytes], recipe: str) -> Files:
    """`files` with the damage of `recipe`; places beyond a file's end are its end."""
    made = dict(files)
    for operation in filter(None, recipe.split(";")):
        name, rest = operation.rsplit(":", 1)
        data = made[name]
        if "@" in rest:
            way, _, number = rest.partition("@")
            made[name] = forged(data, way, int(number))
            continue
        place, mark, what = re.split("([=>])", rest, maxsplit=1)
        a, b = (min(int(v), len(data)) for v in place.split("-"))
        if mark == ">":
            at = min(int(what), len(data))
            made[name] = data[:at] + data[a:b] + data[at + max(b - a, 0) :]
        else:
            text, _, times = what.partition("*")
            made[name] = data[:a] + bytes.fromhex(text) * int(times or 1) + data[max(a, b) :]
    return made


FORGED = ("forged",)
"""In the place of names of texts: files whose values are changed, by `forge.py`."""


def recipe(files: Mapping[str, bytes], fields: Sequence[Field], texts: Sequence[str], rng: random.Random) -> str:
    """Damage of one to four operations, drawn by `rng`.

    `fields`: numbers worth an extreme value; `texts`: names of files that are text.
    """
    if texts == FORGED:
        return forgery(files, rng)
    made = []
    names = [n for n in files if files[n]]
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        name = rng.choice(names)
        if fields and rng.random() < 0.55:
            made.append(_field(rng.choice(fields), files, rng))
        elif name in texts and rng.random() < 0.8:
            made.append(_token(name, files[name], rng))
        else:
            made.append(_anywhere(name, files[name], rng))
    return ";".join(made)


def _value(size: int, files: Mapping[str, bytes], rng: random.Random) -> bytes:
    """Bytes of an extreme number."""
    if size == 8 and rng.random() < 0.3:
        return rng.choice(REAL)
    lengths = [len(d) + k for d in files.values() for k in (-60, -1, 0, 1)]
    pool = [*WHOLE[size], *(n for n in lengths if 0 <= n < 256**size), rng.randrange(256**size)]
    return rng.choice(pool).to_bytes(size, rng.choice(("little", "little", "little", "big")))


def _field(field: Field, files: Mapping[str, bytes], rng: random.Random) -> str:
    old = files[field.name][field.at : field.at + field.size]
    value = _value(field.size, files, rng)
    if rng.random() < 0.3 and len(old) == field.size:  # near what it was
        value = ((int.from_bytes(old, "little") + rng.choice((-1, 1, 2, 256))) % 256**field.size).to_bytes(
            field.size, "little"
        )
    return f"{field.name}:{field.at}-{field.at + field.size}={value.hex()}"


def _token(name: str, data: bytes, rng: random.Random) -> str:
    """One word or number of a text becomes another."""
    found = [m.span() for m in TOKEN.finditer(data)]
    a, b = rng.choice(found) if found else (0, 0)
    draw = rng.random()
    if draw < 0.1:  # a line twice, or none
        line = data[data.rfind(b"\n", 0, a) + 1 : data.find(b"\n", a) + 1]
        return f"{name}:{a}-{a}={line.hex()}*{rng.choice((1, 2, 50))}"
    if draw < 0.2 and len(found) > 1:
        c, d = rng.choice(found)
        return f"{name}:{a}-{b}={data[c:d].hex()}"
    new = rng.choice(NUMBERS) if draw < 0.6 else rng.choice(WORDS)
    times = rng.choice((300, 3000)) if new in OPENING else 1
    return f"{name}:{a}-{b}={new.hex()}*{times}"


def _anywhere(name: str, data: bytes, rng: random.Random) -> str:
    """Bits, extreme numbers, pieces cut out, doubled or exchanged, an end cut off: mostly near the ends of a file."""
    size = len(data)
    at = min(
        rng.choice((rng.randrange(size), rng.randrange(min(size, 400)), size - 1 - rng.randrange(min(size, 400)))),
        size - 1,
    )
    kind = rng.randrange(7)
    if kind == 0:
        return f"{name}:{at}-{at + 1}={data[at] ^ (1 << rng.randrange(8)):02x}"
    if kind in (1, 2):
        width = rng.choice((1, 2, 4, 8))
        return f"{name}:{at}-{at + width}={_value(width, {name: data}, rng).hex()}"
    if kind == 3:
        return f"{name}:{at}-{size}="
    length = rng.choice((1, 4, 16, rng.randrange(1, 300)))
    if kind == 4:
        return f"{name}:{at}-{at + length}="
    if kind == 5:
        return f"{name}:{at}-{at}={data[at : at + length].hex()}*{rng.choice((1, 1, 2, 20))}"
    return f"{name}:{at}-{at + length}>{rng.randrange(size)}"
