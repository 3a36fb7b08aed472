"""Receipts: what was made, from what, and where it is. The only truth about what is done."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from fwclass.errors import DamagedError, StoreError
from fwclass.paths import name_fault, relative_fault
from fwclass.store.atomic import digest_of
from fwclass.store.metas import is_told, misfit_of
from fwclass.store.seal import seal, unseal
from fwclass.store.shapes import COUNT, FLAG, NUMBER, TEXT, Maybe, misfit, pattern

FORMAT = 1

_DIGEST = pattern("a digest", r"[0-9A-Za-z_]{1,64}")
_SHAPE = {
    "key": _DIGEST,
    "digest": _DIGEST,
    "params": pattern("a digest, or nothing", r"[0-9A-Za-z_]{0,64}"),
    "libraries": pattern("a digest, or nothing", r"[0-9A-Za-z_]{0,64}"),
    "place": pattern("store, deliver or run", r"store|deliver|run"),
    "inputs": {TEXT: TEXT},
    "outputs": {TEXT: {"bytes": COUNT, "digest": _DIGEST}},
    "meta": {},
    "cost": {TEXT: NUMBER},
    "version": Maybe(COUNT),
    "emptied": FLAG,
    **dict.fromkeys(("seconds", "peak_mib", "keeping"), NUMBER),
}
_LINE = json.JSONEncoder(sort_keys=True, allow_nan=False)


@dataclass(frozen=True)
class Receipt:
    """One part, done.

    Attributes
    ----------
    stage, part : which part.
    key : digest of (stage, its version, params, digests of inputs): the part is done if its key still holds.
    inputs : digest of everything that was read, by name.
    outputs : bytes and digest of every file written, by path relative to `Store.base(receipt)`.
    digest : digest of all outputs and of `meta`: what enters the keys of the parts that read this one.
    place : "store"; "deliver" for files of the store that a generation links to; "run" for files below the run
        directory.
    meta : plain data that later parts or the report need (rows, counts, faults).
    seconds, peak_mib : cost of making it; `keeping` of the seconds went into flushing, digests and renames.
    cost : what else it took (`fwclass.cost`); nothing in receipts of before that.
    version : of the stage's code; None in receipts of before it was recorded.
    params : digest of the parameters, which lie in ``store/params/<digest>.json``; empty in receipts of before that.
    libraries : digest of what it was made with, in ``store/libraries/<digest>.json``; empty in receipts of before that.
    emptied : its files were removed to save room: what it says of them holds, and they are made anew to be read.
    """

    stage: str
    part: str
    key: str
    inputs: Mapping[str, str]
    outputs: Mapping[str, Mapping[str, Any]]
    digest: str
    place: str
    meta: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    peak_mib: float = 0.0
    keeping: float = 0.0
    cost: Mapping[str, float] = field(default_factory=dict)
    version: int | None = None
    params: str = ""
    libraries: str = ""
    emptied: bool = False
    format: int = FORMAT

    def files(self, name: str) -> Mapping[str, Mapping[str, Any]]:
        """Facts of the output `name`, under "", or of those in the directory `name`, by what follows its name."""
        one = self.outputs.get(name)
        if one is not None:
            return {"": one}
        return {n[len(name) :]: f for n, f in self.outputs.items() if n.startswith(f"{name}/")}

    def to_text(self) -> str:
        """JSON, a field a line, with a digest of itself."""
        plain = {f.name: getattr(self, f.name) for f in fields(self)} | {"meta": dict(self.meta)}
        if not self.emptied:  # the others are as they were before any could be
            del plain["emptied"]
        lines = seal(plain)
        return "{\n" + ",\n".join(f'"{name}": {_LINE.encode(lines[name])}' for name in sorted(lines)) + "\n}\n"

    @classmethod
    def from_json(cls, value: Any, where: object) -> Receipt:
        """A receipt as a file holds it; whoever can write there may have changed it, so every name is checked.

        `DamagedError` for what is no receipt, or not the one that was written.
        """
        try:
            receipt = cls(**unseal(value))
        except (TypeError, ValueError) as fault:
            raise DamagedError("not a receipt", where=where, got=fault, do="remove the file") from fault
        if receipt.format != FORMAT:
            raise StoreError(
                "a receipt of another version of the store",
                where=where,
                expected=FORMAT,
                got=receipt.format,
                do="use another run directory, or remove its `store`",
            )
        wrong = receipt._fault()
        if wrong:
            raise StoreError("not a receipt", where=where, got=wrong, do="remove the file; the part is made anew")
        return replace(receipt, meta=Meta(receipt.meta, receipt.stage, where))

    @classmethod
    def written(cls, value: Any, where: object) -> Receipt:
        """As `from_json`, of what this process has just written: it is not looked at again."""
        receipt = cls(**unseal(value))
        return replace(receipt, meta=Meta(receipt.meta, receipt.stage, where, checked=True))

    def _fault(self) -> str:
        """What in it no writer of receipts wrote; "" if nothing."""
        for what, name in (("stage", self.stage), ("part", self.part)):
            if name_fault(name):
                return f"{what} {str(name)[:80]!r}: {name_fault(name)}"
        wrong = misfit(vars(self), _SHAPE)
        if wrong:
            return f"{wrong.at.removeprefix('.')}: {wrong.got}, expected {wrong.expected}"
        outside = next((name for name in self.outputs if relative_fault(name)), None)
        return "" if outside is None else f"output {outside[:80]!r}: {relative_fault(outside)}"


class Meta(Mapping[str, Any]):
    """What a receipt tells, held to what its stage tells (`metas`) when it is first asked; `DamagedError` where it is
    something else, as who makes digests fit can write anything. `looked_at`: names that whoever reads them has held to
    a shape of their own, and need not again."""

    def __init__(self, values: Mapping[str, Any], stage: str, where: object, checked: bool = False) -> None:
        self._values, self._stage, self._where, self._checked = dict(values), stage, str(where), checked
        self.looked_at = set[str]()

    def _sound(self) -> dict[str, Any]:
        if not self._checked:
            wrong = misfit_of(self._stage, self._values)
            if wrong:
                raise DamagedError(
                    "a receipt tells something else than its stage does",
                    where=self._where,
                    expected=f"{wrong.at}: {wrong.expected}",
                    got=wrong.got,
                    do="remove the file; the part is made anew",
                )
            self._checked = True
        return self._values

    def __getitem__(self, name: str) -> Any:
        values = self._sound()
        if name not in values and is_told(self._stage, name):
            raise DamagedError(
                "a receipt lacks what its stage tells",
                where=self._where,
                expected=f"meta.{name}",
                got=", ".join(values)[:200] or "nothing",
                do="remove the file; the part is made anew",
            )
        return values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._sound()

    def get(self, name: str, default: Any = None) -> Any:
        """What is told under `name`, `default` where nothing is."""
        return self._sound().get(name, default)

    def __iter__(self) -> Iterator[str]:
        return iter(self._sound())

    def __len__(self) -> int:
        return len(self._values)


def checked_meta(stage: str, meta: Mapping[str, Any]) -> dict[str, Any]:
    """What a stage tells, to be written; `TypeError` where that is not of the shape that `metas` has for it: names that
    stand there are held to it, others are not looked at."""
    wrong = misfit_of(stage, meta)
    if wrong:
        raise TypeError(f"stage {stage} tells {wrong.at} = {wrong.got}, expected {wrong.expected}: see store/metas.py")
    return dict(meta)


def content_key(stage: str, version: int, params: Any, inputs: Mapping[str, str]) -> str:
    """The key of a part, by what it is made from; 24 hex digits, also the name of its directory."""
    return digest_of({"stage": stage, "version": version, "params": params, "inputs": dict(inputs)})[:24]


def digest_of_outputs(outputs: Mapping[str, Mapping[str, Any]], meta: Mapping[str, Any]) -> str:
    """Digest of a part: of the digests of its files and of its `meta`."""
    return digest_of({"outputs": {n: o["digest"] for n, o in outputs.items()}, "meta": dict(meta)})
