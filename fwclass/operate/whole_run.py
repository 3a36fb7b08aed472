"""One run of a survey by a workflow: parts are made, the delivery is shown, and what came of it is put into words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fwclass.conf import Config
from fwclass.errors import FwclassError
from fwclass.operate.history import Entry
from fwclass.operate.request import Request, replaced
from fwclass.operate.status import verify as verifying
from fwclass.report.summary import summary
from fwclass.report.write import REPORT
from fwclass.run.part import Outcome
from fwclass.run.runner import Runner
from fwclass.store.generations import Generation
from fwclass.store.url import Url
from fwclass.survey.file_digests import keep_delivered
from fwclass.workflows import workflow_of


@dataclass(frozen=True)
class RunResult:
    """What came of a run.

    Attributes
    ----------
    report : as `report.json` has it.
    generation : what it delivered.
    shown : the generation that readers see now, `before` the one that they saw; None for none.
    earlier : name of the workflow that `before` is of, None where nothing tells.
    failures : its failed parts.
    loss : a sentence where it lost accuracy against its predecessor, else empty.
    """

    report: Any
    generation: Generation
    shown: Generation | None
    before: Generation | None
    earlier: str | None
    failures: list[Outcome]
    loss: str

    @property
    def superseded(self) -> Generation | None:
        """The generation that readers saw before, where they see another now."""
        before, shown = self.before, self.shown
        return before if before is not None and shown is not None and before.number != shown.number else None

    def sentences(self, request: Request, root: Path | Url, keep: int) -> Iterator[str]:
        """What to say of it. `root`: the run directory as the user named it; `keep`: generations that are kept
        (`run.keep_generations`)."""
        own, shown = self.generation, self.shown
        aside = shown is not None and shown.number != own.number
        yield summary(self.report, own.where if aside or isinstance(own.where, Url) else root)
        if self.loss:
            yield self.loss
        if aside and shown is not None:
            yield f"generation  {own.name} is not whole and lies aside; {root} still shows {shown.name}"
        elif not own.whole and self.failures:
            yield f"generation  {own.name} is not whole: parts failed; it is shown, as no whole one is there"
        if self.superseded is not None:
            for words in replaced(self.earlier, request.workflow, self.superseded, keep):
                yield f"note        {root} {words}"


def run_survey(
    config: Config, runner: Runner, request: Request, entry: Entry, fail_fast: bool = False, verify: bool = False
) -> RunResult:
    """Make all parts of the workflow that are not there, write the report, and show what is delivered.

    `entry`: the run's place in the history. `fail_fast`: end at the first part that fails. `verify`: first read all
    that is there, and remove what is damaged with all that was made from it.

    `FwclassError`: the run did not come to its end. Where `report.json` is written, and a later step failed (its page,
    or one of a paper), what was made is delivered all the same.
    """
    runner.store.generations.check_links()
    before = runner.store.generations.current()
    earlier = request.workflow_of_shown(runner.store, before)
    request.keep(runner.store, before, earlier)
    runner.fail_fast = fail_fast
    entry.begin(runner)
    if verify:
        _remove_damaged(runner)
    report: Any = None
    try:
        report = workflow_of(request.workflow)(config, runner, request.wanted)
        generation = _publish(config, runner)
    except FwclassError:
        if report is None and (runner.pending / REPORT).exists():  # a later step failed, as a page of a paper
            entry.generation = _publish(config, runner).number
            _keep_shown(runner, request, before)
        raise
    entry.generation = generation.number
    shown = _keep_shown(runner, request, before)
    return RunResult(report, generation, shown, before, earlier, runner.failures, entry.judged(report))


def _publish(config: Config, runner: Runner) -> Generation:
    """Deliver what was made, and remember of what, where it is whole."""
    generation = runner.publish(config.run.keep_generations)
    if runner.whole:
        keep_delivered(runner.store, generation.name, runner.external)
    return generation


def _keep_shown(runner: Runner, request: Request, before: Generation | None) -> Generation | None:
    """The generation that readers see now; it is kept which workflow it is of, where it is another than `before`."""
    shown = runner.store.generations.current()
    if shown is not None and (before is None or shown.name != before.name):
        request.keep(runner.store, shown, request.workflow)
    return shown


def _remove_damaged(runner: Runner) -> None:
    say = runner.display.say
    say("verify           all files of the store and of all that was delivered are read")
    runner.verify = True
    verified = verifying.verify(runner.store)
    if verified.sound:
        say("verify           they have the bytes that were written")
        return
    for line in [*verifying.rows(verified), *verifying.earlier_advice(verified, str(runner.store.where))]:
        say(line)
    verifying.remove(verified, runner.store)
