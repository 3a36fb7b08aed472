"""Echoes that keep the class of their source: what stages read and are told of it, and the words for it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from fwclass.classes import NOISE_CODES, STANDARD, UNCLASSIFIED, ClassDef, standard_name
from fwclass.classify.exempt import Exempt
from fwclass.classify.kept import Kept
from fwclass.classify.params import ClassifyParams
from fwclass.errors import ConfigError, first_few
from fwclass.graph.stage import Plan
from fwclass.publish.strips import LEGACY_MAX

UNNAMED = frozenset({0, UNCLASSIFIED})
"""Codes that say nothing: never classified, unclassified."""

SHOWN = 6
"""Codes that are named."""

UNSURE_ECHOES = "unsure echoes (classify.leave)"


def kept_argument(plan: Plan) -> Mapping[str, Any]:
    """Which echoes stay as they are, for a stage that classifies; nothing where all are classified."""
    kept = Kept.of(plan.config.classify)
    return {"kept": kept} if kept else {}


def exempt_argument(plan: Plan) -> Mapping[str, Any]:
    """Which echoes do not get the class that the model says, for a stage that writes classes; nothing where all do."""
    exempt = Exempt.of(plan.config.classify)
    return {"exempt": exempt} if exempt else {}


def exempt_columns(plan: Plan) -> tuple[str, ...]:
    """The columns that tell which echoes do not get the class that the model says."""
    exempt = Exempt.of(plan.config.classify)
    return exempt.columns if exempt else ()


def check_left(code: int | None, classes: Iterable[ClassDef], where: str) -> None:
    """`ConfigError` where echoes without a class (`classify.leave`) would get the code of one."""
    taken = [c.name for c in classes if c.code == code]
    if taken:
        raise ConfigError(
            "unsure echoes would get the code of a class",
            where=where,
            got=f"{code}, which is {taken[0]}",
            do="--set classify.leave=1, or another code that no class is written as",
        )


def check_written(written: Mapping[str, int], leave: int | None, legacy: bool, where: object, way: str) -> None:
    """`ConfigError` where points cannot hold the codes that are written, or one would mean two things.

    Parameters
    ----------
    written : code of every class in the points, by its name.
    leave : code of echoes that are left without a class; None: all have one.
    legacy : the points have one of the formats 0 to 5.
    way : how another code is set for a class, for the message.
    """
    every = {**written, **({UNSURE_ECHOES: leave} if leave is not None else {})}
    beyond = [name for name, code in every.items() if legacy and code > LEGACY_MAX]
    if beyond:
        ways = ["--set classify.leave=1"] if UNSURE_ECHOES in beyond else []
        ways += [way] if len(beyond) > len(ways) else []
        raise ConfigError(
            "the points cannot hold all codes that are to be written",
            where=where,
            expected=f"codes up to {LEGACY_MAX} in point formats 0 to 5",
            got=", ".join(f"{name} {every[name]}" for name in beyond),
            do=f"{', and '.join(ways)}; or convert to LAS 1.4",
        )
    for code in sorted(set(every.values())):
        same = [name for name, other in every.items() if other == code]
        if len(same) > 1:
            raise ConfigError(
                f"{' and '.join(same)} would both be written as code {code}",
                where=where,
                expected="another code for each",
                got=", ".join(f"{n} {c}" for n, c in every.items()),
                do=f"{way}, or another classify.leave" if UNSURE_ECHOES in same else way,
            )


def kept_noise(plan: Plan) -> Mapping[str, Any]:
    """The noise classes of the sources that stay, for the stage that hides them from the ground filter."""
    kept = Kept.of(plan.config.classify)
    codes = tuple(code for code in NOISE_CODES if kept and kept.codes[code])
    return {"kept_noise": codes} if codes else {}


def deciding_column(plan: Plan) -> tuple[str, ...]:
    """The column that tells which echoes stay."""
    return ("source_class",) if Kept.of(plan.config.classify) else ()


def kept_codes(by_code: Mapping[int, int], kept: Kept | None) -> dict[int, int]:
    """Of the echoes by the class of their source those that stay."""
    return {code: by_code[code] for code in sorted(by_code) if kept and kept.codes[code]}


def other_names(by_code: Mapping[int, int], params: ClassifyParams, own: Iterable[int]) -> dict[int, str]:
    """What the standard calls the codes that stay, those of noise, and that of echoes left without a class, but for
    those of a class (`own`)."""
    left = [] if params.leave is None else [params.leave]
    codes = [*kept_codes(by_code, Kept.of(params)), *left, *(NOISE_CODES if params.noise else ())]
    return {code: standard_name(code) for code in dict.fromkeys(codes) if code not in frozenset(own)}


def known_codes(classes: Iterable[ClassDef]) -> frozenset[int]:
    """Codes that a class is written as, or counts."""
    return frozenset(code for c in classes for code in (c.code, *c.codes))


def class_remarks(
    by_code: Mapping[int, int], known: frozenset[int], kept: Kept | None, what: str = "echoes"
) -> list[str]:
    """What is to be said of the classes that the sources have.

    `by_code`: echoes, or `what` is counted, by the class of their source. `known`: codes that the classifier's classes
    are written as, or count.
    """
    stay = kept_codes(by_code, kept)
    lost = {c: by_code[c] for c in sorted(by_code) if c not in known | UNNAMED | stay.keys()}
    sentences = []
    if stay and len(stay) == len(by_code):
        sentences.append(f"no {what} were classified: all have a class that is kept (classify.only, classify.keep)")
    elif stay:
        sentences.append(
            f"{sum(stay.values()):,} {what} keep the class of their source ({_listing(stay)}): they are not classified"
            ", have no confidence, and no accuracy counts them"
        )
    elif kept:
        sentences.append(f"none of the {what} has a class that is to be kept (classify.only, classify.keep)")
    noise = {c: by_code[c] for c in NOISE_CODES if by_code.get(c) and c not in stay}
    if noise:
        codes = ",".join(map(str, noise))
        sentences.append(
            f"the sources call {sum(noise.values()):,} {what} noise ({_listing(noise)}): they are classified like all "
            f"others, and may be ground; --keep {codes} (classify.keep=[{codes}]) leaves them noise, and out of the "
            "terrain"
        )
        lost = {c: n for c, n in lost.items() if c not in noise}
    if lost:
        codes = ",".join(map(str, lost))
        sentences.append(
            f"the sources have {sum(lost.values()):,} {what} of classes that are not told apart here "
            f"({_listing(lost)}): they get others; --keep {codes} (classify.keep=[{codes}]) leaves them as they are, "
            "--only 0,1 (classify.only=[0,1]) classifies only what has no class"
        )
    return sentences


def _listing(by_code: Mapping[int, int]) -> str:
    most = sorted(by_code, key=lambda c: (-by_code[c], c))
    words = [f"{f'{c} {STANDARD[c]}' if c in STANDARD else standard_name(c)}: {by_code[c]:,}" for c in most]
    return first_few(words, SHOWN)
