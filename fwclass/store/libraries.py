"""Which libraries a part was made with: those that compute or write, by their versions.

Another version of one of them may give other bytes. Versions are read from the metadata of installed packages, so that
no library is loaded for it, and do not depend on the machine.
"""

from __future__ import annotations

import hashlib
import importlib
import platform
import re
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import fwclass
from fwclass.store.atomic import digest_of

LIBRARIES = (
    *("numpy", "numba", "llvmlite", "scipy", "scikit-learn"),
    *("pyarrow", "zarr", "numcodecs"),
    *("laspy", "lazrs", "laszip"),
    *("rasterio", "pyogrio", "pyproj"),
)

BESIDE = {
    "gdal": ("rasterio", "__gdal_version__"),
    "gdal of pyogrio": ("pyogrio", "__gdal_version_string__"),
    "proj": ("pyproj", "__proj_version__"),
}
"""Libraries in C that a package brings or is linked with: the package, and what it calls their version."""

OWN = ("fwclass", "source")
"""Of this program: a stage's version tells when its code gives other results, so these make no part stale."""

LOST: Mapping[str, str] = {}
"""The fingerprint of a receipt that names one which is gone from the store, or damaged."""

_KNOWN: dict[str, Mapping[str, str]] = {}
"""Fingerprints that were read, by digest."""


@cache
def installed_versions() -> Mapping[str, str]:
    """Versions of Python and of all libraries by name, of this environment; "none" for one that is not there."""
    versions = {"python": platform.python_version()}
    folders = {}
    for name in LIBRARIES:
        try:
            package = distribution(name)
        except PackageNotFoundError:
            versions[name] = "none"
        else:
            versions[name], folders[name] = package.version, Path(str(package.locate_file("")))
    for name, (package_name, attribute) in BESIDE.items():
        if package_name in folders:
            short = name.split()[0]
            versions[name] = _bundled(folders[package_name], package_name, short) or _linked(package_name, attribute)
    return versions


def _bundled(folder: Path, package: str, name: str) -> str:
    """Version of a library that lies in a package's wheel, by its file name; empty where there is none."""
    pattern = re.compile(rf"lib{name}[-.].*?\.so\.\d+\.(\d+\.\d+\.\d+)$")
    try:
        names = sorted(p.name for p in (folder / f"{package}.libs").iterdir())
    except OSError:
        return ""
    return next((match[1] for match in map(pattern.match, names) if match), "")


def _linked(package: str, attribute: str) -> str:
    """Version of the library that a package was linked with, asked of itself."""
    try:
        return str(getattr(importlib.import_module(package), attribute))
    except (ImportError, AttributeError):
        return "unknown"


@cache
def source_digest() -> str:
    """Digest of this program's own code and pages, 16 hex digits: two commits of one version differ in it."""
    state = hashlib.blake2b(digest_size=8)
    package = Path(fwclass.__file__).parent
    beside = [] if (package / "_workflows").is_dir() else [package.parent / "workflows"]  # of a checkout
    for top in (package, *beside):
        for path in sorted(p for ending in ("*.py", "*.j2") for p in top.rglob(ending)):
            state.update(f"{path.relative_to(package.parent).as_posix()}\0".encode() + path.read_bytes())
    return state.hexdigest()


@cache
def fingerprint() -> Mapping[str, str]:
    """`installed_versions`, and what tells this program's own code (`OWN`): what a part is made with here."""
    return {"fwclass": fwclass.__version__, "source": source_digest(), **installed_versions()}


def fingerprint_under(digest: str, read: Callable[[], Any]) -> Mapping[str, str] | None:
    """The fingerprint that a store keeps under `digest`, `read` once unless it is that of here; `LOST` if it is not
    there, None for no digest."""
    if digest and digest not in _KNOWN:
        here = dict(fingerprint())
        value = here if digest == digest_of(here) else read()
        whole = isinstance(value, dict) and all(isinstance(v, str) for v in value.values())
        _KNOWN[digest] = value if whole and digest_of(value) == digest else LOST
    return _KNOWN.get(digest)


def changes(then: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Where the versions of two environments differ, in words: ``pyarrow 26.0.1 to 22.0.0``."""
    pairs = {n: (then.get(n, "none"), now.get(n, "none")) for n in (*now, *then)}
    return [f"{name} {before} to {after}" for name, (before, after) in pairs.items() if before != after]


def stale_by(then: Mapping[str, str] | None) -> list[str]:
    """How the libraries of a part differ from those here, in words; nothing where its receipt names none."""
    if then is None or then == fingerprint():  # as nearly every part
        return []
    if not then:
        return ["what it was made with is not recorded any more: a file of store/libraries is gone or damaged"]
    return changes({n: v for n, v in then.items() if n not in OWN}, installed_versions())
