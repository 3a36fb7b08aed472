"""One file as the strip that it is in a run: the run's own stages, on a store of its own in a scratch directory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from fwclass.decompose.plausible import UNKNOWN, add_counts
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.graph.sources import (
    DECOMPOSE_RETURNS,
    DECOMPOSE_WAVES,
    INDEX,
    MEASURE_PLACES,
    MEASURE_PULSE,
    READ_SPAN,
    StripSpan,
    pulse_of,
    spans_of,
    waveforms_of,
)
from fwclass.graph.stage import Plan, Stage
from fwclass.read.source import Source
from fwclass.report.plausibility import receiver_facts
from fwclass.report.returns import returns_facts
from fwclass.run.inputs import Declared, PartInputs
from fwclass.run.part import Task
from fwclass.schema import Table
from fwclass.single_file.tiles import FileConfig, Tell, quiet
from fwclass.store.receipts import Receipt, content_key
from fwclass.store.run_store import Store
from fwclass.survey.layout import Strip, Survey
from fwclass.survey.numbering import assign_numbers
from fwclass.temporary import temporary_directory
from fwclass.waveforms import Waveforms


@dataclass
class FileStrip:
    """A file whose parts are made when they are asked for; all of them as a run makes them, number and bytes alike."""

    source: Source
    config: FileConfig
    store: Store
    tell: Tell
    _plan: Plan = field(init=False)
    _strip: Strip = field(init=False)
    _measured: Receipt | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        path = self.source.path
        self._strip = Strip(assign_numbers([path.stem])[path.stem], path, (), self.source.point_format)
        files = Survey((self._strip,), (), None, False)
        self._plan = Plan(self.config.whole, files=files)
        index = self._make(INDEX, self._strip)
        self._plan = replace(self._plan, indexed={(INDEX.name, self._strip.key): index})

    @property
    def number(self) -> int:
        """The strip's number, which follows from the file's name."""
        return self._strip.number

    @property
    def spans(self) -> list[StripSpan]:
        """The parts that the file is read in."""
        return spans_of(self._plan, self._strip)

    @property
    def pulses(self) -> int:
        """Pulses, those without a waveform too."""
        return sum(s.span.n_pulses for s in self.spans)

    def pulse(self) -> SystemPulse:
        """The system's pulse as the file's own waveforms show it; the fallback where it has none."""
        if not self.source.has_waves:
            return SystemPulse.gaussian(self.config.pulse.fallback_width)
        self._measure()
        return pulse_of(self.number, self._inputs())

    def noise(self) -> Mapping[str, Any]:
        """What its noise is like, see `receiver_facts`."""
        if not self.source.has_waves:
            return UNKNOWN.noise.facts
        return receiver_facts(self._measure().meta)

    def places(self) -> Mapping[str, Any] | None:
        """How its echoes are placed (`placement.describe_placement`); None without waveforms."""
        if not self.source.has_waves:
            return None
        self._measure()
        places: Mapping[str, Any] = self._make(MEASURE_PLACES, self._strip).meta["places"]
        return places

    def waves(self, span: StripSpan) -> Waveforms:
        """The waveforms and returns of a span."""
        self._make(READ_SPAN, span)
        return waveforms_of(span.key, self._inputs())

    def echoes(self, columns: Iterable[str] | None = None) -> Iterator[Table]:
        """The echoes of every span, in order; `columns` of them that there are, None for all."""
        spans = self.spans
        if self.source.has_waves:
            self.tell("system pulse")
            self._measure()
        for k, span in enumerate(spans, 1):
            self.tell(f"echoes: part {k} of {len(spans)}")
            self._decomposed(span)
            table = self._inputs().table("decompose", span.key)
            yield table if columns is None else table.select(dict.fromkeys(n for n in columns if n in table))

    def links(self) -> Table:
        """Pulse and echo number of the echo of every return, in the file's order."""
        inputs = self._inputs()
        columns = ("pulse", "echo_number")
        return Table.concat([inputs.table("decompose", s.key, columns, "links.parquet") for s in self.spans])

    def counts(self) -> dict[str, int]:
        """What the plausibility of all echoes was found to be."""
        return add_counts([self._decomposed(span).meta["plausibility"] for span in self.spans])

    def faults(self) -> dict[str, int]:
        """Faults of packets, by name."""
        faults: dict[str, int] = {}
        for span in self.spans:
            receipt = self._make(READ_SPAN, span) if span.waves else self._decomposed(span)
            for name, count in receipt.meta["faults"].items():
                faults[name] = faults.get(name, 0) + int(count)
        return faults

    def returns(self) -> dict[str, Any] | None:
        """What the returns say of themselves (`report.returns`)."""
        receipts = [self._make(READ_SPAN, s) if s.waves else self._decomposed(s) for s in self.spans]
        return returns_facts(receipts, (self._strip,), (), self.config.plausibility)

    def _decomposed(self, span: StripSpan) -> Receipt:
        if not span.waves:
            return self._make(DECOMPOSE_RETURNS, span)
        self._measure()
        self._make(MEASURE_PLACES, self._strip)
        return self._make(DECOMPOSE_WAVES, span)

    def _measure(self) -> Receipt:
        if self._measured is None:
            for span in self.spans:
                self._make(READ_SPAN, span)
            self._measured = self._make(MEASURE_PULSE, self._strip)
        return self._measured

    def _inputs(self) -> PartInputs:
        return PartInputs(self.store)

    def _make(self, stage: Stage, part: Any) -> Receipt:
        """The receipt of a part, which is made if it is not there; its faults are raised as they are."""
        task = stage.task(self._plan, part)
        return self.store.receipt(*task.name) or self._commit(task)

    def _commit(self, task: Task) -> Receipt:
        inputs = PartInputs(self.store, declared=Declared(task.name, frozenset(task.needs), task.within))
        key = content_key(task.stage, task.version, task.params, {})
        return self.store.commit(*task.name, key, {}, task.place, lambda directory: task.work(inputs, directory))


@contextmanager
def strip_of(source: Source, settings: tuple[str, ...], tell: Tell = quiet) -> Iterator[FileStrip]:
    """The strip that a file is; its parts lie in a scratch directory (``TMPDIR``) for as long as the block lasts."""
    with temporary_directory("strip") as directory:
        yield FileStrip(source, FileConfig(settings), Store(directory, lasting=False), tell)
