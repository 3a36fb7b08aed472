"""The delivered echoes against the simulator's true echoes of the same pulses."""

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest


@pytest.fixture(scope="module")
def matched(survey, finished):
    """True echoes, distance [m] to the nearest delivered one of the pulse, its values, and how many were made."""
    names = ["gps_time", "x", "y", "z", "amplitude", "width", "number_of_echoes"]
    tables = [pq.read_table(p, columns=names) for p in sorted((finished[0] / "parquet").glob("*.parquet"))]
    made = {n: np.concatenate([t.column(n).to_numpy() for t in tables]) for n in names}
    order = np.argsort(made["gps_time"], kind="stable")
    made = {n: v[order] for n, v in made.items()}
    files = [laspy.read(p) for p in sorted((survey / "reference").glob("*.las"))]
    true = {n: np.concatenate([np.asarray(f[n]) for f in files]) for n in (*names[:6], "number_of_returns")}
    first = np.searchsorted(made["gps_time"], true["gps_time"], "left")
    last = np.searchsorted(made["gps_time"], true["gps_time"], "right")
    nearest, distance = np.zeros(len(first), int), np.full(len(first), np.inf)
    for k in range(int((last - first).max())):
        row = np.minimum(first + k, len(made["x"]) - 1)
        d = np.sqrt(sum((made[n][row] - true[n]) ** 2 for n in "xyz"))
        closer = (first + k < last) & (d < distance)
        nearest[closer], distance[closer] = row[closer], d[closer]
    return true, distance, {n: v[nearest] for n, v in made.items()}, len(made["x"])


def test_true_echoes_are_found(matched):
    """A true echo of 10 DN stands at 8 standard deviations after the matched filter: it is missed by overlap only."""
    true, distance, _, _ = matched
    for least, most, share in ((10, 20, 0.97), (20, 1000, 0.995)):
        some = (true["amplitude"] >= least) & (true["amplitude"] < most)
        assert some.sum() > 1000
        assert (distance[some] < 0.5).mean() > share


def test_few_echoes_are_made_up(matched):
    true, _, _, made = matched
    assert made < 1.02 * len(true["x"])


def test_lone_echoes_lie_where_they_are(matched):
    """At 50 DN and noise of 1 DN the bound of the time is 0.02 ns, 3 mm."""
    true, distance, found, _ = matched
    alone = (true["number_of_returns"] == 1) & (true["amplitude"] > 50) & (found["number_of_echoes"] == 1)
    assert alone.sum() > 5000
    assert np.median(distance[alone]) < 0.005
    assert np.percentile(distance[alone], 95) < 0.02
    assert abs(np.median(found["width"][alone] - true["width"][alone])) < 0.01
    assert np.median(found["amplitude"][alone] / true["amplitude"][alone]) == pytest.approx(1.0, abs=0.01)
