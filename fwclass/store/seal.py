"""A digest of itself in a piece of plain data, by which a change after it was written is seen.

Against accidents: who can write the file can seal it anew.
"""

from __future__ import annotations

from typing import Any

from fwclass.store.atomic import digest_of

_SEAL = "seal"


def seal(plain: dict[str, Any]) -> dict[str, Any]:
    """`plain` with a digest of itself."""
    return {**plain, _SEAL: digest_of(plain)}


def unseal(value: Any) -> dict[str, Any]:
    """What was sealed; as it is where there is no seal, as in files of before they were sealed.

    `ValueError` for what was changed after it was written, `TypeError` for what is no JSON object.
    """
    plain = dict(value)
    seal = plain.pop(_SEAL, None)
    if seal is not None and seal != digest_of(plain):
        raise ValueError("it was changed after it was written")
    return plain
