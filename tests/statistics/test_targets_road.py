"""How echoes fluctuate, and from which side they are strong, as detections and the ledger say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import i0
from support.every_kind import MIMO, PASSIVE
from support.fluctuating_echoes import joint_hit_gauss_markov
from support.radar_equations import mean_snr
from support.significance import Array, assert_standard_normal, assert_sum

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.detection import threshold_noncoherent_cfar
from plotfeed.models.frames import aer_to_enu, wrap_180
from plotfeed.proto.utc import NS
from plotfeed.testing import Feed, flown, fly, held, radar, rotating, scene, staring, waypoint

STEADY, ONE, STRONG_PART = 0, 1, 3


def pd_by_draws(sensor: dict[str, Any], snr: float, case: int) -> float:
    """Strength, echo and reference samples, drawn plainly and counted; one look."""
    rng = np.random.default_rng(case)
    n, m = 400_000, sensor["n_reference"]
    strength = snr * {0: np.ones(n), 1: rng.standard_exponential(n),
                      3: rng.standard_gamma(2, n) / 2}[case]  # fmt: skip
    noise = rng.standard_normal((2, n)) / np.sqrt(2)
    power = (np.sqrt(strength) + noise[0]) ** 2 + noise[1] ** 2
    alpha = sensor["pfa"] ** (-1 / m) - 1
    return float((power > alpha * rng.standard_gamma(m, n)).mean())


def ring(case: int | None, n: int = 30, **more: Any) -> list[dict[str, Any]]:
    stated = {} if case is None else {"swerling": case}
    return [held(f"{case}-{i}", 12.0 * i + 1, 5.0, 8000.0, **stated, **more) for i in range(n)]


@pytest.mark.parametrize("scan", [{}, {"scan": rotating(1.0, 8)}], ids=["staring", "rotating"])
def test_drones_are_detected_as_they_fluctuate_and_errors_are_as_stated(
    scan: dict[str, Any],
) -> None:
    sensor = radar(pfa=1e-4, **scan)
    rcs_m2 = 0.0008
    drones = [d for case in (STEADY, ONE, STRONG_PART) for d in ring(case, rcs_m2=rcs_m2)]
    flight = fly(scene([sensor], drones, seed=51), 60)
    looks, plots = flight.looks(), flight.plots()
    snr = float(mean_snr(sensor, looks.range_m, rcs_m2).mean())
    for case in (STEADY, ONE, STRONG_PART):
        of = looks.rows(np.char.startswith(looks.drone, f"{case}-"))
        assert np.ptp(of.pd) < 1e-4
        p = pd_by_draws(sensor, snr, case)
        assert of.pd.mean() == pytest.approx(p, abs=4e-3)
        assert_sum(of.detected.sum(), of.pd.sum(), (of.pd * (1 - of.pd)).sum(), f"case {case}")
        of_case = plots.rows(np.char.startswith(plots.drone, f"{case}-"))
        error = (of_case.range_m - of_case.true_range_m) / of_case.sigma_range_m
        assert_standard_normal(error, f"case {case}")
    seen = [looks.pd[np.char.startswith(looks.drone, f"{c}-")][0] for c in (0, 3, 1)]
    assert seen[0] > seen[1] > seen[2]


def test_a_class_says_it_for_its_drones_and_a_drone_for_itself() -> None:
    drones = [
        held("a", 1.0, 5.0, 8000.0), held("b", 50.0, 5.0, 8000.0, target_class="bird"),
        held("c", 90.0, 5.0, 8000.0, swerling=1), held("d", 140.0, 5.0, 8000.0, swerling=0),
    ]  # fmt: skip
    target = [{"swerling": 0}, {"target_class": "bird", "swerling": 3}]
    looks = fly(scene([radar()], drones, seed=52, target=target), 4).looks()
    plain = fly(scene([radar()], drones[:1], seed=52), 4).looks()
    pd = {name: looks.pd[looks.drone == name][0] for name in "abcd"}
    assert pd["a"] == pytest.approx(pd["d"], rel=1e-3)
    assert pd["c"] == pytest.approx(plain.pd[0], rel=1e-3)
    assert pd["a"] > pd["b"] > pd["c"]


def test_echoes_to_all_transmitters_alike_are_lost_together() -> None:
    """Swerling 1 in place of 2: one draw for all looks of a scan."""
    weak = {"rcs_m2": 0.002}
    drones = [held(f"{c}-{i}", 12.0 * i, 6.0, 9000.0, swerling=c, **weak)
              for c in (1, 2) for i in range(20)]  # fmt: skip
    looks = fly(scene([MIMO | {"pfa": 1e-4}], drones, seed=53), 40).looks()
    for case in (1, 2):
        of = looks.rows(np.char.startswith(looks.drone, f"{case}-"))
        assert_sum(of.detected.sum(), of.pd.sum(), (of.pd * (1 - of.pd)).sum(), f"case {case}")
    rng, n, m = np.random.default_rng(1), 400_000, 32
    snr = 10 ** (looks.snr_db[0] / 10)
    ratio = float(threshold_noncoherent_cfar(1e-4, 2, m))
    strength = snr * rng.standard_exponential(n)
    noise = rng.standard_normal((2, n, 2)) / np.sqrt(2)
    power = ((np.sqrt(strength)[:, None] + noise[0]) ** 2 + noise[1] ** 2).sum(axis=1)
    expected = (power > ratio * rng.standard_gamma(m, n)).mean()
    assert looks.pd[looks.drone == "1-0"].mean() == pytest.approx(expected, abs=4e-3)


def lobes_db(aspect_deg: Array, depth_db: float) -> Array:
    mean_db = 10 * np.log10(i0(depth_db * np.log(10) / 10))
    return np.asarray(depth_db * np.cos(np.radians(4 * aspect_deg)) - mean_db)


def circling() -> list[dict[str, Any]]:
    """Past the sensor on straight lines of all courses."""
    ways = []
    for i in range(12):
        a = waypoint(30.0 * i, 4.0, 2500.0)
        b = waypoint(30.0 * i + 100.0 - 18.0 * i, 4.0, 2500.0 + 200.0 * (-1) ** i * i)
        ways.append(flown(f"d{i}", a, b, speed_m_s=25.0, repeat=False))
    return ways


def seen_aspects(flight: Feed) -> Array:
    """Clockwise from where each drone flies to, by differences of its places; NaN at ends."""
    looks = flight.looks()
    found = np.full(len(looks), np.nan)
    for drone in np.unique(looks.drone):
        rows = np.flatnonzero(looks.drone == drone)
        place = aer_to_enu(looks.azimuth_deg[rows], looks.elevation_deg[rows], looks.range_m[rows])
        step = place[2:] - place[:-2]
        course_deg = np.degrees(np.arctan2(step[:, 0], step[:, 1]))
        found[rows[1:-1]] = looks.azimuth_deg[rows[1:-1]] + 180.0 - course_deg
    return found


@pytest.mark.parametrize("scan", [{}, {"scan": rotating(1.0, 8)}], ids=["staring", "rotating"])
def test_cross_sections_are_those_of_the_side_that_is_seen(scan: dict[str, Any]) -> None:
    table = {"kind": "table", "angle_deg": [0.0, 90.0, 180.0, 270.0], "gain_db": [0.0, 9, 3, -5]}
    for aspect, gain in (
        ({"kind": "lobes", "depth_db": 6.0}, lambda a: lobes_db(a, 6.0)),
        (table, lambda a: np.interp(a % 360, [0, 90, 180, 270, 360], [0, 9, 3, -5, 0])),
    ):
        sensor = radar(**scan)
        flight = fly(scene([sensor], circling(), seed=54, target=[{"aspect": aspect}]), 60)
        looks, aspect_deg = flight.looks(), seen_aspects(flight)
        inner = ~np.isnan(aspect_deg)
        found_db = looks.snr_db - 10 * np.log10(mean_snr(sensor, looks.range_m))
        np.testing.assert_allclose(found_db[inner], gain(aspect_deg[inner]), atol=0.05)
        assert np.ptp(found_db) > 7
        p = looks.pd
        assert_sum(looks.detected.sum(), p.sum(), (p * (1 - p)).sum(), "detections")


def test_a_passive_radar_sees_from_between_its_two_ends() -> None:
    named = {"target": [{"aspect": {"kind": "lobes", "depth_db": 6.0}}]}
    drone = flown("d", waypoint(0.0, 4.0, 3000.0), waypoint(90.0, 4.0, 3000.0), speed_m_s=20.0)
    looks, plain = (
        fly(scene([PASSIVE], [drone], seed=55, **more), 30).looks() for more in (named, {})
    )
    place = aer_to_enu(plain.azimuth_deg, plain.elevation_deg, plain.range_m)
    tower = aer_to_enu(300.0, 0.2, 20_000.0)
    step = place[2:] - place[:-2]
    middle = place[1:-1]
    back = -middle / np.linalg.norm(middle, axis=1, keepdims=True)
    away = (tower - middle) / np.linalg.norm(tower - middle, axis=1, keepdims=True)
    side = back + away
    aspect_deg = np.degrees(np.arctan2(side[:, 0], side[:, 1]) - np.arctan2(step[:, 0], step[:, 1]))
    most = 0.3 * 7.61e6
    ratios = [10 ** (each.snr_db[1:-1] / 10) for each in (looks, plain)]
    power = [ratio / (most - ratio) for ratio in ratios]
    np.testing.assert_allclose(
        10 * np.log10(power[0] / power[1]), lobes_db(wrap_180(aspect_deg), 6.0), atol=0.05
    )


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
