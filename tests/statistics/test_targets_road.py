"""How echoes fluctuate, and from which side they are strong, as detections and the ledger say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.fluctuating_echoes import joint_hit_gauss_markov
from support.radar_equations import mean_snr
from support.significance import Array, assert_standard_normal, assert_sum

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.proto.utc import NS
from plotfeed.testing import Feed, fly, held, radar, scene, staring


def ring(case: int | None, n: int = 30, **more: Any) -> list[dict[str, Any]]:
    stated = {} if case is None else {"swerling": case}
    return [held(f"{case}-{i}", 12.0 * i + 1, 5.0, 8000.0, **stated, **more) for i in range(n)]


def test_check_predicts_for_the_case_that_is_stated() -> None:
    tables = [
        report(scene([radar()], ring(case)[:1], seed=56))["sensors"][0]["table"]
        for case in (None, 1, 0)
    ]
    pd = [[row["pd"] for row in table] for table in tables]
    np.testing.assert_allclose(pd[0], pd[1], rtol=1e-9)
    assert np.max(np.array(pd[2]) - pd[1]) > 0.05


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ([{"swerling": 5}], "less than or equal to 4"),
        ([{"swerling": 1}, {"swerling": 3}], "twice"),
        ([{"aspect": {"kind": "table", "angle_deg": [0, 360], "gain_db": [0, 0]}}], "360 in all"),
    ],
)
def test_targets_that_cannot_be_are_refused(target: list[dict[str, Any]], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scene([radar()], seed=57, target=target)


STARING = {"scan": staring(0.1), "n_reference": 4096, "report": ["plots"]}


def by_scan(flight: Feed, column: str, n: int) -> Array:
    """A column of the looks, a row a drone."""
    looks = flight.looks()
    order = np.lexsort((looks.time_utc_ns, looks.drone))
    return np.asarray(getattr(looks, column)[order]).reshape(n, -1)


@pytest.mark.parametrize("tau_s", [0.15, 1.0])
def test_soon_after_a_hit_comes_another(tau_s: float) -> None:
    """Ten looks a second at 60 drones: hits in pairs, by the law of two correlated powers."""
    n, rcs_m2 = 60, 0.0005
    drones = [held(f"d{i:02}", 6.0 * i, 5.0, 8000.0, rcs_m2=rcs_m2) for i in range(n)]
    sensor = radar(decorrelation_s=tau_s, **STARING)
    flight = fly(scene([sensor], drones, seed=58), 30)
    hits, pd = by_scan(flight, "detected", n), by_scan(flight, "pd", n)
    assert_sum(hits.sum(), pd.sum(), (pd * (1 - pd)).sum(), "given the strengths")
    snr = float(mean_snr(sensor, 8000.0, rcs_m2))
    once = 1e-6 ** (1 / (1 + snr))
    both = float(joint_hit_gauss_markov(snr, 1e-6, np.exp(-0.1 / tau_s)))
    for seen, expected in (
        (hits.mean(axis=1), once),
        ((hits[:, 1:] & hits[:, :-1]).mean(axis=1), both),
    ):
        error = (seen.mean() - expected) / (seen.std(ddof=1) / np.sqrt(n))
        assert abs(error) < 4.5, (tau_s, error)
    assert both > 1.03 * once**2
    strength = 10 ** (by_scan(flight, "snr_db", n) / 10) / snr
    spread = strength.mean(axis=1).std(ddof=1) / np.sqrt(n)
    assert abs(strength.mean() - 1) < 4.5 * spread


def test_errors_of_lasting_strengths_are_as_stated_and_two_amplitudes_vary_less() -> None:
    drones = [held(f"{c}-{i:02}", 6.0 * i, 5.0, 8000.0, rcs_m2=0.01, swerling=c)
              for c in (1, 3) for i in range(30)]  # fmt: skip
    flight = fly(scene([radar(decorrelation_s=0.5, **STARING)], drones, seed=59), 20)
    plots = flight.plots()
    plots = plots.rows(plots.drone != "")
    assert_standard_normal((plots.range_m - plots.true_range_m) / plots.sigma_range_m)
    strength = 10 ** (by_scan(flight, "snr_db", 60) / 10)
    varies = [
        strength[rows].var() / strength[rows].mean() ** 2 for rows in (slice(30), slice(30, 60))
    ]
    assert varies == pytest.approx([1.0, 0.5], rel=0.15)


def test_strengths_are_the_same_whenever_a_drone_is_looked_for() -> None:
    """By the seed, the sensor and the scan alone: also in the company of others."""
    drones = [held(f"d{i:02}", 6.0 * i, 5.0, 8000.0) for i in range(60)]
    made = [scene([radar(decorrelation_s=1.0, **STARING)], some, seed=60)
            for some in (drones, drones[:3])]  # fmt: skip
    all_of, few = (fly(each, 3) for each in made)
    late = fly(made[0], 1, start_ns=1_700_000_000 * NS + 2 * NS)
    np.testing.assert_array_equal(by_scan(all_of, "snr_db", 60)[:3], by_scan(few, "snr_db", 3))
    looks = all_of.looks()
    for time_ns in np.unique(late.looks().time_utc_ns):
        then = late.looks().rows(late.looks().time_utc_ns == time_ns)
        before = looks.rows(looks.time_utc_ns == time_ns)
        np.testing.assert_allclose(then.snr_db, before.snr_db, atol=1e-3)
