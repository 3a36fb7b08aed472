"""Why a part has to be made again: what its receipt says it was made from, beside what it would be made from now."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fwclass.run.part import Name, Task
from fwclass.store.libraries import stale_by
from fwclass.store.receipts import Receipt
from fwclass.store.row_digests import digest_within
from fwclass.store.run_store import Store

SOME = 3
"""Files that are named of those that are no longer read."""

SHOWN = 48
"""Characters of a parameter's value that are shown."""


@dataclass(frozen=True)
class Reason:
    """One reason in words; `kind` is the same for parts that have it alike (no part is named in it).

    `waits`: it is one of what the part needs, not of the part itself.
    """

    text: str
    kind: str
    waits: bool = False


def same_reason(text: str) -> Reason:
    """A reason that reads the same for one part and for many."""
    return Reason(text, text)


def reasons(task: Task, receipt: Receipt, store: Store, waits: Mapping[Name, str]) -> list[Reason]:
    """Why `receipt` does not do for `task`; `waits` are parts that are not done now, with their status."""
    why = _of_version(task, receipt)
    why += [] if task.any_libraries else [same_reason(text) for text in stale_by(store.provenance.libraries(receipt))]
    why += _of_params(task, receipt, store)
    why += _of_files(task, receipt)
    why += _of_parts(task, receipt, store, waits)
    if not why:
        why = _of_outputs(receipt, store)
    if not why and receipt.version is None:
        why = [same_reason("made by an earlier version of fwclass, whose receipts do not tell parameters")]
    return why or [same_reason("its key is another one")]


def new_files(task: Task) -> list[Reason]:
    """What a part that was never made reads from outside."""
    return [
        Reason(f"nothing of input {file.name} is there", "nothing of its input is there") for file in task.external[:1]
    ]


def waiting(waits: Mapping[Name, str]) -> list[Reason]:
    """One reason for every (stage, status) among parts that are needed and not done."""
    groups: dict[tuple[str, str], list[str]] = {}
    for (stage, part), status in sorted(waits.items()):
        groups.setdefault((stage, status), []).append(part)
    return [_about(stage, parts, f"needs {{}}, {status}", waits=True) for (stage, status), parts in groups.items()]


def _about(stage: str, parts: list[str], text: str, waits: bool = False) -> Reason:
    """`text` with the first part's name put in, and how many more there are."""
    more = f" and {len(parts) - 1} more of {stage}" if len(parts) > 1 else ""
    return Reason(text.format(f"{stage}/{parts[0]}{more}"), text.format(stage), waits)


def _of_version(task: Task, receipt: Receipt) -> list[Reason]:
    if receipt.version is None or receipt.version == task.version:
        return []
    return [same_reason(f"the code of {task.stage} changed: version {receipt.version} to {task.version}")]


def _of_params(task: Task, receipt: Receipt, store: Store) -> list[Reason]:
    if receipt.version is None:
        return []
    then = store.provenance.params(receipt)
    if then is None:
        return [] if task.params is None else [same_reason("its parameters are not recorded any more")]
    now = json.loads(json.dumps(task.params))  # tuples and keys as they become in a file
    return [same_reason(f"parameter {text}") for text in differences(then, now)]


def differences(then: Any, now: Any, name: str = "") -> list[str]:
    """Where two pieces of plain data, as read from JSON, differ, in words: ``cell: 0.5 to 1.0``."""
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        sentences = []
        for key in sorted({*then, *now}):
            inner = f"{name}.{key}" if name else str(key)
            if key not in now:
                sentences.append(f"{inner}: {_shown(then[key])} is gone")
            elif key not in then:
                sentences.append(f"{inner}: {_shown(now[key])} is new")
            else:
                sentences += differences(then[key], now[key], inner)
        return sentences
    if isinstance(then, list) and isinstance(now, list):
        return _of_lists(then, now, name)
    return [] if then == now else [f"{name}: {_shown(then)} to {_shown(now)}"]


def _of_lists(then: list[Any], now: list[Any], name: str) -> list[str]:
    if then == now:
        return []
    if len(then) == len(now) and all(isinstance(v, Mapping) for v in (*then, *now)):
        pairs = enumerate(zip(then, now, strict=True))
        return [text for k, (a, b) in pairs for text in differences(a, b, f"{name}[{k}]")]
    gone, new = ([v for v in a if v not in b] for a, b in ((then, now), (now, then)))
    words = [f"without {', '.join(map(_shown, gone))}"] if gone else []
    words += [f"with {', '.join(map(_shown, new))}"] if new else []
    return [f"{name}: now {' and '.join(words)}" if words else f"{name}: in another order"]


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= SHOWN else text[: SHOWN - 1] + "…"


def _of_files(task: Task, receipt: Receipt) -> list[Reason]:
    """Files read from outside; their names, unlike those of parts, have no slash."""
    then = {n: d for n, d in receipt.inputs.items() if "/" not in n}
    now = {file.name: file.digest for file in task.external}
    why = [same_reason(f"input {n} changed") for n in now if n in then and then[n] != now[n]]
    why += [same_reason(f"input {n} is new") for n in now if n not in then]
    return why + [same_reason(f"input {n} is no longer read") for n in then if n not in now]


def _of_parts(task: Task, receipt: Receipt, store: Store, waits: Mapping[Name, str]) -> list[Reason]:
    then = {n: d for n, d in receipt.inputs.items() if "/" in n}
    anew: dict[str, list[str]] = {}
    new: dict[str, list[str]] = {}
    gone: dict[str, list[str]] = {}
    late = {n: waits[n] for n in task.needs if n in waits}
    read = set()
    for stage, part in task.needs:
        present = store.receipt(stage, part)
        now = digest_within(present, task.within) if present is not None else None
        if present is not None and now is None:
            continue  # nothing of it is read
        read.add(f"{stage}/{part}")
        if f"{stage}/{part}" not in then:
            new.setdefault(stage, []).append(part)
        elif (stage, part) not in waits and now is not None and now != then[f"{stage}/{part}"]:
            anew.setdefault(stage, []).append(part)
    for name in sorted(then.keys() - read):
        stage, part = name.split("/", 1)
        if (stage, part) in waits:  # it will be read again when it is there
            late[stage, part] = waits[stage, part]
        else:
            gone.setdefault(stage, []).append(part)
    why = waiting(late)
    for groups, text in ((anew, "{} was made anew"), (new, "{} is read now")):
        why += [_about(stage, parts, text) for stage, parts in groups.items()]
    for stage, parts in gone.items():
        files = sorted({f for part in parts for f in _files_below((stage, part), store)})
        because = f" ({', '.join(files[:SOME])}{', …' if len(files) > SOME else ''})" if files else ""
        about = _about(stage, parts, "{} is no longer read")
        why.append(Reason(about.text + because, about.kind + because))
    return why


def _files_below(name: Name, store: Store, steps: int = 4) -> set[str]:
    """Files from outside that a part which is no longer read was made of, as far as its receipts are still there."""
    receipt = store.receipt(*name)
    if receipt is None or not steps:
        return set()
    own = {n for n in receipt.inputs if "/" not in n}
    stages = {n.split("/", 1)[0] for n in receipt.inputs} - own
    if own or len(stages) > 2:  # a table of many parts: its own receipt says what it is
        return own
    below = [tuple(n.split("/", 1)) for n in receipt.inputs if "/" in n]
    return set().union(*(_files_below((s, p), store, steps - 1) for s, p in below[:SOME]))


def _of_outputs(receipt: Receipt, store: Store) -> list[Reason]:
    if receipt.emptied:
        return [same_reason("its files were removed to save room (run.keep_intermediate: lean)")]
    why = []
    for name, facts in receipt.outputs.items():
        size = store.size_of(receipt, name)
        if size is None:
            why.append(Reason(f"its file {name} is gone", "a file of it is gone"))
        elif size != facts["bytes"]:
            text = f"its file {name} has {size} bytes, not {facts['bytes']}"
            why.append(Reason(text, "a file of it has another size"))
    return why
