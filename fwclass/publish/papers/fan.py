"""Fan 2013: what its page shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.publish.papers.plots import draw_curves, draw_distribution, draw_thesis
from fwclass.publish.papers.tables import difference, matrices, ours, rows_table, seconds_of, share
from fwclass.publish.report import data_uri
from fwclass.publish.sections import distribution, number
from fwclass.schema import base_of

SIGNS = {
    "zc": "Zc",
    "echo_number": "echo number",
    "amplitude": "amplitude",
    "echo_ratio": "echo ratio ER",
    "backscatter": "backscatter γ",
    "inclination": "inclination A",
    "width": "echo width",
}
MACHINES = {"rbf-svm": "RBF SVM", "linear-svm": "linear SVM"}


def fan_view(facts: Mapping[str, Any]) -> dict[str, Any]:
    """What the template shows besides what all papers have."""
    classes = [*facts["classes"], *facts["more_classes"]]
    split = next(iter(facts["splits"]))
    return {
        "facts": _facts(facts, facts["splits"][split]),
        "features": [sign(n) for n in facts["features"]],
        "rows": rows_table(facts["rows"]),
        "more": [c["name"] for c in facts["more_classes"]],
        "unscored": _unscored_rows(facts["unscored"]),
        "distribution": _distribution(facts, classes),
        "distribution_plot": data_uri(draw_distribution(facts["distribution"], facts["printed"]["distribution"])),
        "selection": _selection(facts),
        "selection_plot": data_uri(_curves(facts)),
        "splits": [_split(m, result, facts, classes) for m, result in facts["splits"].items()],
        "machines": _machines(facts),
        "machine_tables": [_machine_table(name, facts, classes) for name in facts["machines"]],
        "thesis": _thesis(facts),
        "every_class": matrices(facts["every_class"], classes, None)["ours"] if facts["every_class"] else None,
        "whole": facts["whole"] and {**ours(facts["whole"]), "area": facts["whole"]["area"]},
    }


def sign(name: str) -> str:
    """A feature in the paper's words."""
    base = base_of(name)
    return SIGNS.get(base, base.replace("_", " "))


def _facts(facts: Mapping[str, Any], result: Mapping[str, Any]) -> list[tuple[str, str]]:
    accuracy, printed = ours(result), facts["printed"]["splits"]["3"]
    rbf = facts["machines"]["rbf-svm"]
    rows = [
        ("overall, ours", f"{accuracy['overall_accuracy']} %"),
        ("overall, Fan 2013", f"{printed['overall']} %"),
        ("kappa, ours", accuracy["kappa"]),
        ("RBF SVM, ours", f"{ours(rbf)['overall_accuracy']} %"),
        ("SVM, Fan 2013", f"{facts['printed']['svm']['overall']} %"),
    ]
    if facts["thesis"]:
        gains = [facts["differences"][f"with-{s}/without-{s}"] for s in facts["thesis"]["seeds"]]
        mean = sum(g["overall_accuracy"]["value"] for g in gains) / len(gains)
        rows.append(("gain by waveforms", f"{100 * mean:+.1f} points"))
    return rows


def _unscored_rows(unscored: Mapping[str, Mapping[str, int]]) -> list[dict[str, Any]]:
    rows = []
    for name, counts in unscored.items():
        total = sum(counts.values())
        shares = ", ".join(f"{share(n / total) if total else '–'} % {c}" for c, n in counts.items())
        rows.append({"name": name, "total": number(total), "told": shares})
    return rows


def _distribution(facts: Mapping[str, Any], classes: list[Mapping[str, Any]]) -> list[dict[str, Any]]:
    features = distribution(facts["distribution"], classes) or []
    for one in features:
        base = base_of(one["feature"])
        words = facts["printed"]["distribution"].get(base, {})
        one["title"] = sign(one["feature"]) + one["title"][one["title"].find(",") :] * ("," in one["title"])
        for row in one["rows"]:
            row["paper"] = words.get(row["name"], {}).get("text", "–")
    return features


def _selection(facts: Mapping[str, Any]) -> dict[str, Any]:
    printed = dict(zip(facts["printed"]["selection"]["order"], facts["printed"]["selection"]["accuracy"], strict=True))
    curves = facts["selection"]
    rows = [
        {
            "name": sign(s["tried"][0]),
            "accuracy": share(s["accuracy"]),
            "std": share(s["accuracy_std"]),
            "kappa": f"{s['kappa']:.3f}",
            "kept": s["kept"],
            "paper": printed.get(base_of(s["tried"][0])),
        }
        for s in curves["paper"]["steps"]
    ]
    best = [
        {
            "name": sign(s["tried"][0]),
            "accuracy": share(s["accuracy"]),
            "std": share(s["accuracy_std"]),
            "kappa": f"{s['kappa']:.3f}",
            "chosen": s["features"] == curves["best"]["chosen"],
            "time": f"{s['microseconds']:.1f}",
        }
        for s in curves["best"]["steps"]
    ]
    chosen = [sign(n) for n in curves["best"]["chosen"]]
    sample, params = curves["paper"]["sample"], curves["paper"]["params"]
    return {
        "rows": rows,
        "best": best,
        "chosen": chosen,
        "echoes": number(sample["rows"]),
        "blocks": sample["blocks"],
        "folds": params["folds"],
        "edge": f"{params['block']:g}",
    }


def _curves(facts: Mapping[str, Any]) -> bytes:
    printed = facts["printed"]["selection"]
    paper = list(zip([SIGNS[n] for n in printed["order"]], printed["accuracy"], strict=True))
    steps = [
        [
            (sign(s["tried"][0]), 100 * s["accuracy"], 100 * s["accuracy_std"], s["kept"])
            for s in facts["selection"][order]["steps"]
        ]
        for order in ("paper", "best")
    ]
    return draw_curves(paper, *steps)


def _split(
    m: Any, result: Mapping[str, Any], facts: Mapping[str, Any], classes: list[Mapping[str, Any]]
) -> dict[str, Any]:
    printed = facts["printed"]["splits"]
    paper = printed.get(m) or {}
    fits = [c["name"] for c in facts["classes"]] == list(facts["printed"]["classes"].values())
    return {
        "m": m,
        **ours(result),
        "paper": paper.get("overall", "–"),
        "tables": matrices(result, classes, paper.get("confusion") if fits else None),
        "producers": [share(v) for v in result["producers_accuracy"]],
        "users": [share(v) for v in result["users_accuracy"]],
        "paper_producers": list(paper.get("producers", ())) if fits else [],
        "names": list(result["classes"]),
        "out_of_bag": share(result["out_of_bag"]),
    }


def _machines(facts: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The forest, the SVMs, and the forest on as many rows as the RBF SVM takes."""
    forest, printed = facts["forest"], facts["printed"]
    split = next(iter(facts["splits"]))
    results = {forest: facts["splits"][split], "forest-fewer": facts["forest_fewer"], **facts["machines"]}
    titles = {forest: f"random forest, m = {split}", "forest-fewer": "random forest, rows of the RBF SVM", **MACHINES}
    accuracy = {forest: printed["splits"]["3"]["overall"], "rbf-svm": printed["svm"]["overall"]}
    spent = {forest: printed["seconds"]["forest"], "rbf-svm": printed["seconds"]["svm"]}
    rows = []
    for name in (forest, "rbf-svm", "forest-fewer", "linear-svm"):
        less = facts["differences"].get(f"{forest}/{name}")
        train_rows = number(results[name].get("rows", facts["times"][name]["train_rows"]))
        rows.append(
            {
                "name": titles[name],
                **ours(results[name]),
                **_times(facts["times"][name]),
                "paper": accuracy.get(name, "–"),
                "paper_time": f"{spent[name]} s" if name in spent else "–",
                "rows": train_rows,
                "less": difference(less) if less else None,
            }
        )
    return rows


def _times(times: Mapping[str, Any]) -> dict[str, str]:
    return {
        "train": seconds_of(times["train"]),
        "test": seconds_of(times["test"]),
        "train_rows": number(times["train_rows"]),
        "test_rows": number(times["test_rows"]),
    }


def _machine_table(name: str, facts: Mapping[str, Any], classes: list[Mapping[str, Any]]) -> dict[str, Any]:
    result = facts["machines"][name]
    fits = [c["name"] for c in facts["classes"]] == list(facts["printed"]["classes"].values())
    paper = facts["printed"]["svm"]["confusion"] if fits and name == "rbf-svm" else None
    params = ", ".join(f"{k} = {v:g}" for k, v in result["params"].items() if v is not None)
    return {
        "name": MACHINES[name],
        "tables": matrices(result, classes, paper),
        "notes": result["notes"],
        "params": params,
    }


def _thesis(facts: Mapping[str, Any]) -> dict[str, Any] | None:
    thesis = facts["thesis"]
    if not thesis:
        return None
    rows = []
    for k, seed in enumerate(thesis["seeds"]):
        one = facts["differences"][f"with-{seed}/without-{seed}"]
        rows.append(
            {
                "seed": seed,
                "with": ours(thesis["with"][k]),
                "without": ours(thesis["without"][k]),
                "gain": difference(one),
                "blocks": one["blocks"],
                "caution": one.get("caution"),
            }
        )
    names = thesis["with"][0]["classes"]
    gains = [(str(s), facts["differences"][f"with-{s}/without-{s}"]) for s in thesis["seeds"]]
    per_class = [
        {
            "name": name,
            **{
                f"{side}_{key}": share(_mean([result[f"{key}_accuracy"][i] for result in thesis[side]]))
                for side in ("with", "without")
                for key in ("producers", "users")
            },
        }
        for i, name in enumerate(names)
    ]
    return {
        "rows": rows,
        "per_class": per_class,
        "with": [sign(n) for n in thesis["features"]["with"]],
        "without": [sign(n) for n in thesis["features"]["without"]],
        "plot": data_uri(draw_thesis(gains)),
    }


def _mean(values: list[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return sum(known) / len(known) if known else None
