"""Which workflow's delivery another one has replaced."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from fwclass.errors import InputError
from fwclass.operate import whole_run
from fwclass.operate.request import Request
from fwclass.store.generations import Generation


class Runs:
    """Runs of one directory, as `run_survey` sees them; nothing is computed."""

    def __init__(self, root: Path) -> None:
        self.kept: dict = {}
        self.generation: Generation | None = None
        self.pending, self.failures, self.root = root / "pending", [], root
        self.whole, self.external = True, ()
        generations = SimpleNamespace(check_links=lambda: None, current=lambda: self.generation)
        self.store = SimpleNamespace(
            generations=generations, keep=self.kept.__setitem__, recall=self.kept.get, where=root
        )

    def publish(self, keep: int) -> Generation:
        number = 1 if self.generation is None else self.generation.number + 1
        self.generation = Generation(number, self.root / f"{number:04d}", True, "", "", self.root)
        return self.generation

    def run(self, monkeypatch, workflow: str, fails: bool = False) -> whole_run.RunResult | None:
        def work(config, runner, wanted):
            if fails:
                raise InputError("a stage ended", where=workflow)
            return {}

        monkeypatch.setattr(whole_run, "workflow_of", lambda name: work)
        config = SimpleNamespace(run=SimpleNamespace(keep_generations=3))
        entry = SimpleNamespace(begin=lambda runner: None, judged=lambda report: "", generation=None)
        request = Request("demo", str(self.root), workflow=workflow)
        if not fails:
            return whole_run.run_survey(config, self, request, entry)
        with pytest.raises(InputError):
            whole_run.run_survey(config, self, request, entry)
        return None


def test_a_run_that_failed_has_delivered_nothing(tmp_path, monkeypatch):
    """The note said that the delivery was of exit.py, which had ended before it delivered anything."""
    runs = Runs(tmp_path)
    assert runs.run(monkeypatch, "classification").earlier is None
    runs.run(monkeypatch, "exit.py", fails=True)
    runs.run(monkeypatch, "exit.py", fails=True)
    made = runs.run(monkeypatch, "mutate.py")
    assert made.earlier == "classification" and made.superseded.number == 1
    assert runs.run(monkeypatch, "ground").earlier == "mutate.py"


def test_a_directory_of_before_it_was_kept(tmp_path, monkeypatch):
    runs = Runs(tmp_path)
    runs.run(monkeypatch, "classification")
    runs.kept["run.json"] = {n: v for n, v in runs.kept["run.json"].items() if n not in ("shown", "seal")}
    assert runs.run(monkeypatch, "ground").earlier == "classification"
