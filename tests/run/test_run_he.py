"""`--workflow he2023` on two small labelled samples: figures that belong together, a page, and nothing made twice."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from browser import seen
from commandline import fwclass

from fwclass.conf import load
from fwclass.conf.papers import paper
from fwclass.errors import InputError
from fwclass.graph.stage import Plan
from fwclass.store.external_file import digest_file
from fwclass.store.run_store import Store
from fwclass.study.papers.claims import FAILS, HOLDS, OPEN, UNSURE
from fwclass.study.papers.he import STAGES, with_samples
from fwclass.study.papers.he_claims import CLAIMS, COMBINED, _spread
from fwclass.survey import file_digests

SMALL = ("ground_search.coarse=2", "ground_search.rounds=1", "terrain.block=64", "terrain.block_halo=48")


def sample(path: Path, seed: int, slope: float) -> Path:
    """A slope of 60 m x 60 m with shrubs and crowns, as text with labels."""
    r = np.random.default_rng(seed)
    x, y = r.uniform(0, 60, (2, 2500))
    plant = r.random(2500) < 0.4
    z = 100 + slope * x + np.sin(y / 8) + r.normal(0, 0.03, 2500) + plant * r.uniform(0.3, 9, 2500)
    np.savetxt(path, np.c_[x, y, z, plant], fmt="%.3f")
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("he")
    sample(place / "flat.txt", 1, 0.02)
    sample(place / "steep.txt", 2, 0.6)
    (place / "s.yaml").write_text('survey: {name: woods, sources: ["*.txt"]}\n')
    return place


def walked(place: Path, *more: str):
    words = ("run", place / "s.yaml", "--workflow", "he2023", "--out", place / "out", "--workers", "0")
    return fwclass(*words, *(w for s in (*SMALL, *more) for w in ("--set", s)))


@pytest.mark.slow
def test_the_run_and_its_page(run: Path) -> None:
    ended = walked(run)
    assert ended.returncode == 0, ended.stderr
    facts = json.loads((run / "out" / "he2023.json").read_text())
    assert list(facts["samples"]) == ["flat", "steep"] and facts["steep"] == ["steep"]
    assert facts["samples"]["steep"]["slope"] == pytest.approx(0.6, abs=0.1)
    assert set(facts["by_sample"]["flat"]) == set(facts["methods"]) and facts["methods"][-1] == COMBINED
    for results in facts["by_sample"].values():
        for one in results.values():
            for kind in ("start", "best", "held_out"):
                (a, b), (c, d) = one[kind]["confusion"]
                assert a + b + c + d == 2500
                assert one[kind]["type_i"] == pytest.approx(b / (a + b))
                assert one[kind]["type_ii"] == pytest.approx(c / (c + d))
                assert one[kind]["total_error"] == pytest.approx((b + c) / 2500)
            assert one["best"]["kappa"] >= max(one["start"]["kappa"], one["held_out"]["kappa"]) - 1e-12
    mean = np.mean([r["csf"]["held_out"]["kappa"] for r in facts["by_sample"].values()])
    assert facts["means"]["csf"]["held_out"]["kappa"] == pytest.approx(mean)
    assert [c["name"] for c in facts["claims"]] == list(CLAIMS)
    assert {c["verdict"] for c in facts["claims"]} <= {HOLDS, FAILS, OPEN, UNSURE}
    page = (run / "out" / "he2023.html").read_text(encoding="utf-8")
    assert all(c["claim"] in page for c in facts["claims"]) and "<script" not in page
    for width in (1280, 390):
        assert seen((run / "out" / "he2023.html").resolve(), width).width <= width
    again = walked(run)
    assert again.returncode == 0 and "computed" not in again.stderr, again.stderr
    sample(run / "flat.txt", 3, 0.02)
    changed = walked(run)
    assert changed.returncode == 0 and "6 computed, 6 skipped" in changed.stderr, changed.stderr


@pytest.mark.parametrize(
    ("text", "words", "told"),
    [
        ('survey: {name: w, sources: ["none*.txt"]}\n', (), "no file matches"),
        ('survey: {name: w, sources: ["a.txt"]}\n', ("--tiles", "1_1"), "no tiles"),
        ('survey: {name: w, sources: ["a.txt"]}\n', (), "no labels to judge a filter by"),
        ("survey: {name: w, simulated: true, sources: [a.las]}\n", (), "judged on labelled files"),
    ],
)
def test_what_cannot_be_judged_is_told(tmp_path: Path, text: str, words: tuple[str, ...], told: str) -> None:
    np.savetxt(tmp_path / "a.txt", np.c_[np.random.default_rng(0).uniform(0, 20, (50, 3)), np.zeros(50)], fmt="%.3f")
    (tmp_path / "s.yaml").write_text(text)
    line = ("run", tmp_path / "s.yaml", "--workflow", "he2023", "--out", tmp_path / "out", "--workers", "0", *words)
    ended = fwclass(*line)
    assert ended.returncode != 0 and told in ended.stderr, ended.stderr


def test_a_sample_is_digested_once_and_held_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of the two stages read all samples for their digests, and one that changed later went unnoticed."""
    path = sample(tmp_path / "flat.txt", 1, 0.02)
    (tmp_path / "s.yaml").write_text('survey: {name: woods, sources: ["*.txt"]}\n')
    asked: list[Path] = []
    monkeypatch.setattr(file_digests, "digest_file", lambda path: asked.append(path) or digest_file(path))
    plan = with_samples(Plan(load(tmp_path / "s.yaml", classifies=False)), Store(tmp_path / "run"))
    tasks = [task for stage in STAGES for task in stage.tasks(plan)]
    assert asked == [path] and len(tasks) == 7
    sample(path, 2, 0.6)
    for task in tasks:
        with pytest.raises(InputError, match="changed while the run was under way"):
            task.external[0].check()


def test_an_interval_is_that_of_student() -> None:
    from scipy.stats import t

    values = np.random.default_rng(4).normal(0.3, 1.0, 10)
    one = _spread(values.tolist())
    half = t.ppf(0.975, 9) * values.std(ddof=1) / np.sqrt(10)
    assert one["low"] == pytest.approx(values.mean() - half, abs=0.01)
    assert one["high"] == pytest.approx(values.mean() + half, abs=0.01)
    assert _spread([1.0])["high"] == np.inf


def test_every_claim_has_a_test() -> None:
    assert list(paper("he2023")["claims"]) == list(CLAIMS)
