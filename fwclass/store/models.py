"""A model on disk: `.npy` arrays and `card.json`. Loading runs no code and checks everything it reads."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.model import FORMAT, KINDS, LAYERS, Forest, Layered, Model
from fwclass.model.ranges import check_ranges
from fwclass.paths import open_regular
from fwclass.store.atomic import digest_of, file_digest

CARD = "card.json"
_CARD_LIMIT = 1 << 24
"""Bytes of a card; one of 127 features has some ten thousand."""
_ARRAY_LIMIT = 1 << 32
"""Bytes of an array: a forest of a thousand trees of a million nodes each has so many."""
_NPY = b"\x93NUMPY\x01\x00"
"""What numpy writes for arrays without fields."""
_DECIDES = ("format", "kind", "features", "classes", "params", "computed", "preparation", "refine", "context", "layers")
"""Keys of the card without which the arrays mean nothing, or something else."""


def save_model(directory: Path, model: Model) -> None:
    """Write `model` into `directory`, which is made; of two layers each into a directory below it."""
    directory.mkdir(parents=True, exist_ok=True)
    if isinstance(model, Layered):
        for name in LAYERS:
            save_model(directory / name, getattr(model, name))
        layers = {name: _card(directory / name / CARD)["digest"] for name in LAYERS}
        model = type(model)(model.coarse, model.fine, {**model.card, "layers": layers})
    for name in model.layout:
        np.save(directory / f"{name}.npy", getattr(model, name), allow_pickle=False)
    card = {**model.card, "kind": model.kind}
    card["digest"] = _digest(card, {name: getattr(model, name) for name in model.layout})
    text = json.dumps(card, sort_keys=True, indent=1, allow_nan=False)
    (directory / CARD).write_text(text + "\n", encoding="utf-8")


def load_model(directory: Path) -> Model:
    """The model in `directory`, or an `InputError` that says what is wrong with it."""
    if not directory.is_dir():
        raise InputError(
            "there is a file where a model's directory is wanted" if directory.exists() else "no such model directory",
            where=directory,
            expected="a directory that `fwclass train --model` wrote, or a name that `fwclass models` lists",
            do="check the path; `fwclass models` lists the names that there are",
        )
    try:
        card = _card(directory / CARD)
        cls = KINDS[card["kind"]]
        if issubclass(cls, Layered):
            return _two_layers(directory, cls, card)
        arrays = {name: load_array(directory / f"{name}.npy", *of) for name, of in cls.layout.items()}
        check_ranges(card)
        model: Model = cls(**arrays, card=card)  # type: ignore[call-arg]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as fault:
        raise InputError(
            "this is not a model of fwclass, or it is damaged",
            where=directory,
            expected=f"{CARD} of layout {FORMAT} and kind {', '.join(KINDS)}, and its arrays as .npy",
            got=f"{type(fault).__name__}: {fault}",
            do="train again, or copy the whole model directory",
        ) from fault
    model.check(directory)
    _check_whole(directory, card, arrays)
    return model


def _two_layers(directory: Path, cls: type[Layered], card: dict[str, Any]) -> Model:
    """A model of two layers, each of which lies in a directory below."""
    digests = {}
    for name in LAYERS:
        of_layer = _card(directory / name / CARD)
        if issubclass(KINDS[of_layer["kind"]], Layered):
            raise ValueError(f"its layer {name!r} has layers of its own")
        digests[name] = of_layer.get("digest")
    coarse, fine = (load_model(directory / name) for name in LAYERS)
    model = cls(coarse, fine, card)
    model.check(directory)
    if card.get("layers") != digests:
        card = {**card, "digest": "of other layers"}
    _check_whole(directory, card, {})
    return model


def _check_whole(directory: Path, card: dict[str, Any], arrays: Mapping[str, NDArray]) -> None:
    """`InputError` unless card and arrays were written together."""
    if card.get("digest") != _digest(card, arrays):
        raise InputError(
            "the model's card and arrays do not belong together",
            where=directory,
            expected=f"{CARD} and the arrays as they were written together, with their digest",
            got="a card without digest" if "digest" not in card else "a card or an array that was changed since",
            do="copy the whole model directory again, or train again",
        )


def load_forest(directory: Path) -> Forest:
    """As `load_model`, for what only a forest can do."""
    model = load_model(directory)
    if not isinstance(model, Forest):
        raise InputError(
            "the model is not a forest", where=directory, expected=Forest.kind, got=model.kind, do="train a forest"
        )
    return model


def _card(path: Path) -> dict[str, Any]:
    if path.stat().st_size > _CARD_LIMIT:
        raise ValueError(f"{path.name} has {path.stat().st_size} bytes")
    with open_regular(path) as stream:
        card = json.loads(stream.read().decode("utf-8"), parse_constant=_no_number)
    if not isinstance(card, dict):
        raise ValueError(f"{path.name} is no JSON object")
    if card.get("format") != FORMAT:
        raise ValueError(f"its layout is {card.get('format')!r}, this program reads {FORMAT}")
    if not isinstance(card.get("kind"), str) or card["kind"] not in KINDS:
        raise ValueError(f"its kind {card.get('kind')!r} is unknown")
    return card


def _digest(card: Mapping[str, Any], arrays: Mapping[str, NDArray]) -> str:
    """SHA-256 of the arrays and of what in the card decides: against accidents, not against forgers."""
    deciding = {key: card[key] for key in _DECIDES if key in card}
    state = hashlib.sha256(json.dumps(deciding, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        state.update(f"\n{name} {array.shape}\n".encode())
        state.update(array.astype(array.dtype.newbyteorder("<")).tobytes())
    return state.hexdigest()


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")


def load_array(path: Path, kind: str, dimensions: int) -> NDArray:
    """One array of a dtype; memory-mapped first, so that a header cannot make us allocate more than the file holds.
    `ValueError` or `OSError` for any other."""
    _check_size(path)
    with open_regular(path) as stream:
        head = stream.read(len(_NPY))
    if head != _NPY:  # later versions let a header be as long as it says
        raise ValueError(f"{path.name} begins with {head!r}, not with {_NPY!r} (version 1 of the format)")
    try:
        with np.errstate(over="ignore"):  # a shape beyond 64 bits: the map is refused as too small for it
            mapped = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as fault:  # numpy's header parser lets through whatever Python's tokenizer raises
        raise ValueError(f"{path.name}: {fault}") from fault
    if mapped.dtype != np.dtype(kind) or mapped.ndim != dimensions:
        raise ValueError(f"{path.name} is {mapped.dtype} of {mapped.ndim} dimensions, expected {kind} of {dimensions}")
    with open_regular(path) as stream:  # the map told shape and place; to touch it is SIGBUS where the file is cut off
        stream.seek(mapped.offset)
        values = np.fromfile(stream, mapped.dtype, mapped.size)
    if len(values) < mapped.size:
        raise ValueError(f"{path.name} was changed while it was read")
    return np.array(values.reshape(mapped.shape, order="C" if mapped.flags.c_contiguous else "F"), order="C", copy=None)


def model_digest(path: Path) -> str:
    """Digest of a model's files, those that `load_model` reads alone; `InputError` where there is no model."""
    try:
        names = sorted(_files(path))
    except (OSError, ValueError, RecursionError):
        load_model(path)  # tells what is wrong
        raise
    return digest_of([[name, file_digest(path / name)] for name in names])


def load_same(path: Path, digest: str) -> Model:
    """The model in `path`, which has this digest before and after it is loaded; `InputError` for another."""
    check_same(path, model_digest(path), digest)
    model = load_model(path)
    check_same(path, model_digest(path), digest)
    return model


def check_same(path: Path, has: str, digest: str) -> None:
    """`InputError` where a model has another digest than the one that it was taken for."""
    if has != digest:
        raise InputError(
            "the model was changed while the run was under way", where=path, do="run the same again with one of them"
        )


def _files(directory: Path) -> Iterator[str]:
    """Names of the card and the arrays of a model, those of its layers too."""
    yield CARD
    cls = KINDS[_card(directory / CARD)["kind"]]
    for name in cls.layout:
        _check_size(directory / f"{name}.npy")
        yield f"{name}.npy"
    for layer in LAYERS if issubclass(cls, Layered) else ():
        of_layer = KINDS[_card(directory / layer / CARD)["kind"]]
        if not issubclass(of_layer, Layered):
            yield from (f"{layer}/{name}" for name in _files(directory / layer))


def _check_size(path: Path) -> None:
    if path.stat().st_size > _ARRAY_LIMIT:
        raise ValueError(f"{path.name} has {path.stat().st_size} bytes")
