"""The forest beside scikit-learn, scikit-learn-intelex and ONNX Runtime: ``python tests/bench/bench_forest.py``.

Every figure is CPU seconds of one run; ours and the peer's take turns, and ratios are medians of pairs. Peers that are
not installed are left out and told. ``--large`` adds 500 000 rows.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import yaml

from fwclass.classify.vote import count, walkable, winners
from fwclass.model import FORMAT, assemble
from fwclass.train.importance import drops
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import Grower

ROOT = Path(__file__).resolve().parents[2]
BASE = TrainParams(**yaml.safe_load((ROOT / "conf" / "base.yaml").read_text())["train"])
NAMES = tuple("abcdef")


def problem(n, seed):
    """Three overlapping classes and six features, one of them a small whole number."""
    r = np.random.default_rng(seed)
    y = r.integers(0, 3, n).astype(np.uint8)
    centre = np.array([[0, 0, 0, 0, 0, 0], [2.2, 1, 0.5, 1, 0.5, 0.3], [1, 2, -1, 0.5, 1.2, 0.4]])
    X = (r.normal(size=(n, 6)) + centre[y]).astype(np.float32)
    X[:, 3] = np.rint(X[:, 3])
    return X, y


def timed(work):
    """CPU seconds of this process, and what the work gave."""
    start = time.process_time()
    made = work()
    return time.process_time() - start, made


def ours(X, y, params):
    grower = Grower(X, y, ["0", "1", "2"], params)
    classes = [{"name": str(c), "code": c, "codes": [c]} for c in range(3)]
    card = {"format": FORMAT, "kind": "forest", "features": list(NAMES), "classes": classes}
    return assemble([grower.tree(t) for t in range(params.trees)], card)


def rule(**values):
    return BASE.model_copy(update=values)


def peer(params, **values):
    from sklearn.ensemble import RandomForestClassifier

    return RandomForestClassifier(
        params.trees, criterion=params.criterion, max_features=params.per_split(6), random_state=1, n_jobs=1, **values
    )


def row(title, mine, theirs, better="less", unit=""):
    ratio = theirs / mine if better == "less" else mine / theirs
    print(f"{title:44}{mine:11.3f}{theirs:11.3f}{ratio:8.1f}  {unit}", flush=True)


def training(X, y, fresh, truth):
    """Every split rule beside scikit-learn's exact trees of the same criterion."""
    ours(X[:500], y[:500], BASE)
    print(f"\n{len(y)} rows, 6 features, 3 classes, {BASE.trees} unpruned trees; CPU seconds of one thread")
    print(f"{'':44}{'fwclass':>11}{'sklearn':>11}{'ratio':>8}")
    kept = {}
    for criterion in ("entropy", "gini"):
        params = rule(criterion=criterion)
        theirs, fitted = timed(lambda p=params: peer(p).fit(X, y))
        judged = 100 * (fitted.predict(fresh) == truth).mean()
        nodes = float(np.mean([e.tree_.node_count for e in fitted.estimators_]))
        for split in ("equal-width", "exact", "histogram"):
            asked = rule(criterion=criterion, split=split)
            ours(X[:500], y[:500], asked)  # compile
            mine, forest = timed(lambda p=asked: ours(X, y, p))
            hit = 100 * (winners(fresh, walkable(forest)) == truth).mean()
            row(f"training, {split}, {criterion} [s]", mine, theirs)
            print(f"{'  accuracy [%]':44}{hit:11.2f}{judged:11.2f}{hit - judged:+8.2f}")
            print(f"{'  nodes per tree':44}{len(forest.feature) / forest.trees:11.0f}{nodes:11.0f}")
            kept.setdefault(criterion, (forest, fitted))
    return kept["entropy"]


def prediction(fresh, forest, fitted, runs):
    laid = walkable(forest)
    winners(fresh[:100], laid), count(fresh[:100], laid)
    small = fresh[: len(fresh) // 4]
    print(f"\nprediction of {len(fresh)} rows [M rows/s], median of {runs} pairs")
    for title, mine, theirs in (
        ("classes (a settled row is left alone)", winners, fitted.predict),
        ("votes / probabilities, whole", count, fitted.predict_proba),
    ):
        pairs = []
        for _ in range(runs):
            a, _ = timed(lambda f=mine: f(fresh, laid))
            b, _ = timed(lambda f=theirs: f(small))
            pairs.append((len(fresh) / a / 1e6, len(small) / b / 1e6))
        mid = np.median(pairs, axis=0)
        ratio = float(np.median([a / b for a, b in pairs]))
        print(f"{title:44}{mid[0]:11.3f}{mid[1]:11.3f}{ratio:8.1f}", flush=True)
    size = sum(a.nbytes for a in (forest.feature, forest.threshold, forest.child, forest.offsets))
    row("model [MB] (arrays / pickle)", size / 1e6, len(pickle.dumps(fitted)) / 1e6)


def runtime(fresh, forest, runs):
    if not (importlib.util.find_spec("onnx") and importlib.util.find_spec("onnxruntime")):
        print("ONNX Runtime: not installed, left out")
        return
    import onnxruntime

    from fwclass.publish.onnx_forest import onnx_forest

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(onnx_forest(forest), options, providers=["CPUExecutionProvider"])
    laid, small, pairs = walkable(forest), fresh[: len(fresh) // 4], []
    expected = winners(small, laid)
    for _ in range(runs):
        a, _ = timed(lambda: count(fresh, laid))
        b, made = timed(lambda: session.run(["label"], {"X": small}))
        pairs.append((len(fresh) / a / 1e6, len(small) / b / 1e6))
    mid = np.median(pairs, axis=0)
    row("ONNX Runtime on the exported model, votes", mid[0], mid[1], "more")
    print(f"{'  rows of another class':44}{int((made[0] != expected).sum()):11d}")


INTELEX = """
import json, sys, time
import numpy as np
data = np.load(sys.argv[1]); threads = int(sys.argv[2])
import daal4py
daal4py.daalinit(threads)
from sklearnex.ensemble import RandomForestClassifier
made = RandomForestClassifier(int(data["trees"]), criterion="gini", max_features=3, random_state=1, n_jobs=threads)
made.fit(data["X"][:500], data["y"][:500]); made.predict(data["fresh"][:100])
w, c = time.perf_counter(), time.process_time(); made.fit(data["X"], data["y"])
fit = time.perf_counter() - w, time.process_time() - c
asked = []
for _ in range(int(data["runs"])):
    w, c = time.perf_counter(), time.process_time(); said = made.predict(data["fresh"])
    asked.append((time.perf_counter() - w, time.process_time() - c))
asked = np.median(asked, axis=0).tolist()
print(json.dumps({"fit": fit, "predict": asked, "accuracy": float((said == data["truth"]).mean())}))
"""


def intelex(X, y, fresh, truth, forest, runs, threads, tmp):
    """In a process of its own, so that plain scikit-learn stays plain. It has Gini trees only."""
    if importlib.util.find_spec("sklearnex") is None:
        print("scikit-learn-intelex: not installed, left out")
        return
    path = Path(tmp) / "problem.npz"
    laid = walkable(forest)
    np.savez(path, X=X, y=y.astype(np.int64), fresh=fresh, truth=truth, trees=BASE.trees, runs=runs)
    for n in threads:
        env = {**os.environ, "OMP_NUM_THREADS": str(n), "MKL_NUM_THREADS": str(n)}
        made = subprocess.run(
            [sys.executable, "-c", INTELEX, str(path), str(n)], capture_output=True, text=True, env=env, check=False
        )
        if made.returncode:
            print(f"scikit-learn-intelex: failed ({made.stderr.strip().splitlines()[-1]})")
            return
        told = json.loads(made.stdout.strip().splitlines()[-1])
        mine = timed(lambda: ours(X, y, BASE))[0]
        asked = float(np.median([timed(lambda w=laid: winners(fresh, w))[0] for _ in range(runs)]))
        print(f"\nscikit-learn-intelex, {n} thread{'s'[: n > 1]} (its CPU seconds; wall seconds beside them)")
        row("training [CPU s]", mine, told["fit"][1], unit=f"wall {told['fit'][0]:.2f} s")
        row("prediction of classes [CPU s]", asked, told["predict"][1], unit=f"wall {told['predict'][0]:.2f} s")
        print(f"{'  its accuracy [%]':44}{'':11}{100 * told['accuracy']:11.2f}")


def weighing(X, y, forest):
    key = np.arange(len(y), dtype=np.uint64)
    sample = Sample(NAMES, X, y, key, key, np.bincount(y))
    o = forest.offsets
    trees = [tuple(getattr(forest, n)[o[t] : o[t + 1]] for n in ("feature", "threshold", "child")) for t in range(20)]
    drops(sample, trees[:1], 0, BASE.drawing, 1)
    took, _ = timed(lambda: drops(sample, trees, 0, BASE.drawing, 10))
    print(f"\nimportance, 10 repeats, per 100 trees: {took * 5:.1f} CPU s (no peer: scikit-learn has none out of bag)")


def main() -> None:
    import tempfile

    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--rows", type=int, default=60_000)
    asked.add_argument("--predict", type=int, default=200_000)
    asked.add_argument("--runs", type=int, default=5)
    asked.add_argument("--large", action="store_true", help="500 000 rows besides")
    asked.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="of scikit-learn-intelex")
    given = asked.parse_args()
    if importlib.util.find_spec("sklearn") is None:
        sys.exit("scikit-learn is not installed: nothing to compare with")
    fresh, truth = problem(given.predict, 2)
    for rows in [given.rows, 500_000][: 1 + given.large]:
        X, y = problem(rows, 1)
        forest, fitted = training(X, y, fresh, truth)
        prediction(fresh, forest, fitted, given.runs)
        runtime(fresh, forest, given.runs)
        with tempfile.TemporaryDirectory() as tmp:
            intelex(X, y, fresh, truth, forest, given.runs, given.threads, tmp)
        weighing(X, y, forest)


if __name__ == "__main__":
    main()
