"""What may be a secret is cut from texts before anyone sees them: parts of an address, settings that hold one."""

from __future__ import annotations

import re
from collections.abc import Iterable

CUT = "…"

_ADDRESS = re.compile(r"\b([A-Za-z][A-Za-z0-9+.-]*)://([^\s'\"<>|`]*)")
_HOST = re.compile(r"^(\[[0-9A-Fa-f:.]+\]|[\w.-]+)(:\d+)?$")
_PLACES = frozenset({"tcp", "tls", "ucx", "inproc", "file", "local", "memory", "s3", "gs", "az", "abfs"})
"""Schemes whose path names a place that the reader must know; only user and query are cut."""

_TELLING = re.compile(r"webhook|token|secret|password|command|^\s*schedule\s*$", re.IGNORECASE)


def redacted(text: str) -> str:
    """`text` with every address cut to scheme and host: ``https://user:key@host/path?query`` is ``https://host/…``."""
    return _ADDRESS.sub(_cut, text) if "://" in text else text


def _cut(match: re.Match[str]) -> str:
    scheme, rest = match[1], match[2]
    place, query, _ = rest.partition("?")
    host, slash, path = place.partition("/")
    host = host.rpartition("@")[2]
    if not _HOST.match(host):
        host = CUT if host else ""
    if scheme.lower() in _PLACES:
        return f"{scheme}://{host}{slash}{path.rpartition('@')[2]}" + (f"?{CUT}" if query else "")
    return f"{scheme}://{host}" + (f"/{CUT}" if path or query else slash)


def redacted_setting(text: str) -> str:
    """``section.key=value`` without the value where the key may hold a secret, else with addresses cut."""
    key, equals, _ = text.partition("=")
    return f"{key}={CUT}" if equals and _TELLING.search(key) else redacted(text)


def redacted_words(words: Iterable[str]) -> list[str]:
    """The words of a command line; values of ``--set`` as `redacted_setting`."""
    shown, before = [], ""
    for word in words:
        if before == "--set":
            shown.append(redacted_setting(word))
        elif word.startswith("--set="):
            shown.append("--set=" + redacted_setting(word[6:]))
        else:
            shown.append(redacted(word))
        before = word
    return shown
