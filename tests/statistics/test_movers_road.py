"""Birds, cars, wind turbines and clutter: seen as drones are, told apart in the ledger."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.radar_equations import pd
from support.significance import Array, assert_chance, assert_sum

from plotfeed.feeds.engine.simulation import Simulation, simulate
from plotfeed.models.frames import aer_to_enu
from plotfeed.testing import START_NS, Feed, fly, held, radar, rotating, scene


def place(azimuth_deg: float, range_m: float, up_m: float = 60.0) -> dict[str, float]:
    east_m, north_m, _ = (float(x) for x in aer_to_enu(azimuth_deg, 0.0, range_m))
    return {"east_m": east_m, "north_m": north_m, "above_site_m": up_m}


def flown(
    sensor: dict[str, Any], duration_s: float = 20, seed: int = 5, **world: Any
) -> Simulation:
    made = scene([sensor], [held("d", 10.0, 4.0, 3000.0, rcs_m2=0.01)], seed=seed, **world)
    return simulate(made, duration_s, start_utc_ns=START_NS)


FLOCK = {"id": "gulls", "count": 40, "rcs_m2": 0.003, "wander_m_s": 2.0, "wander_s": 4.0,
         "spread_m": 20.0, "path": [place(30, 3000), place(60, 3000)]}  # fmt: skip


def test_birds_are_detected_by_their_own_signal_and_named_as_birds() -> None:
    found = flown(radar(), birds=[FLOCK | {"rcs_m2": 0.00005}])
    looks, names = found["radar"].looks, np.array(found.drones)
    birds = looks.rows(np.char.startswith(names[looks.drone].astype(str), "bird/gulls-"))
    assert len(birds) == 40 * 20
    np.testing.assert_allclose(birds.pd, pd(radar(), birds.range_m, 0.00005), rtol=1e-9)
    p = birds.pd
    assert 0.05 < p.mean() < 0.95
    assert_sum(float(birds.detected.sum()), float(p.sum()), float((p * (1 - p)).sum()))


def test_a_flock_keeps_to_its_leader_at_its_speed() -> None:
    found = flown(radar(), 10, birds=[FLOCK | {"mass_kg": 1.0}])
    looks = found["radar"].looks
    birds = looks.rows(looks.drone > 0)
    enu = aer_to_enu(birds.azimuth_deg, birds.elevation_deg, birds.range_m)
    at_s = (birds.t_utc_ns - START_NS) / 1e9
    middle = np.array([enu[at_s == t].mean(axis=0) for t in np.unique(at_s)])
    step_m = np.linalg.norm(np.diff(middle, axis=0), axis=1)
    assert np.abs(step_m - 15.9).max() < 1.5
    spread_m = np.array([enu[at_s == t].std(axis=0) for t in np.unique(at_s)])
    assert 10 < spread_m.min() < spread_m.max() < 45


def test_cars_are_a_poisson_number_on_the_road_and_pass_at_their_speed() -> None:
    """1000 an hour at 25 m/s: 11 a kilometre and way, by many seeds."""
    road = {"id": "a6", "path": [place(20, 2000, 0.0), place(20, 5000, 0.0)], "cars_per_h": 1000.0,
            "speed_m_s": 25.0}  # fmt: skip
    counts, shares = [], []
    for seed in range(60):
        looks = flown(radar(power_w=1e4), 1, seed, road=[road])["radar"].looks
        cars = looks.rows(looks.drone > 0)
        counts.append(len(cars))
        shares += ((cars.range_m - 2000) / 3000).tolist()
    mean = 2 * 1000 / 3600 * 3000 / 25
    assert_sum(float(np.sum(counts)), 60 * mean, 60 * mean)
    dispersion = float(np.var(counts, ddof=1)) / mean * 59
    assert_chance(2 * min(stats.chi2.cdf(dispersion, 59), stats.chi2.sf(dispersion, 59)))
    assert_chance(float(stats.kstest(np.clip(shares, 0, 1), "uniform").pvalue))
    looks = flown(radar(), 30, 3, road=[road])["radar"].looks
    one = looks.rows(looks.drone == 5)
    steps_m = np.abs(np.diff(one.range_m))
    assert np.median(steps_m) == pytest.approx(25, abs=0.5)


TURBINE = {"id": "wt", "radius_m": 50.0, "tip_speed_m_s": 80.0, "axis_azimuth_deg": 90.0,
           **place(0.0, 3000.0, 100.0)}  # fmt: skip


def test_tips_alias_through_the_notch_and_the_tower_stays_in_it() -> None:
    """Seen from the side, rates are up to the tips' 80 m/s, folded into 15 GHz-like spans."""
    doppler = {"notch_m_s": 3.0, "prf_hz": 2000.0}
    found = flown(radar(doppler=doppler), 200, turbine=[TURBINE])["radar"]
    whose = found.looks.drone
    tower, tips = found.looks.rows(whose == 1), found.looks.rows(whose > 1)
    assert tower.pd.max() < 1e-3
    assert set(np.unique(whose)) == {0, 1, 2, 3, 4}
    assert tips.pd.min() < 0.2
    assert tips.pd.mean() > 0.7
    plots = found.plots.rows(found.plots.drone > 1)
    true = plots.true_range_rate_m_s
    assert 75 < np.abs(true).max() <= 80.5
    span = 2000.0 * 0.0299792458 / 2
    assert np.abs(plots.range_rate_m_s).max() <= span / 2 + 1
    folded = true - span * np.rint(true / span)
    assert np.median(np.abs(plots.range_rate_m_s - folded)) < 0.5


def test_behind_the_tower_echoes_are_weaker_as_two_edges_make_them() -> None:
    """4 m wide at 3 km, X band, on the axis: -23.1, -9.9 and -7.2 dB 0.1, 1 and 3 km behind."""
    drones = [held(f"d{behind}", 0.0, 1.0, 3000.0 + behind) for behind in (100, 1000, 3000)]
    drones.append(held("beside", 2.0, 1.0, 4000.0))
    drones.append(held("above", 0.0, 5.0, 4000.0))
    still = TURBINE | {"blades": 0}
    ratios = []
    for world in ({}, {"turbine": [still]}):
        made = scene([radar(frequency_hz=299_792_458 / 0.03)], drones, seed=1, **world)
        looks = simulate(made, 1, start_utc_ns=START_NS)["radar"].looks
        ratios.append(np.array([looks.snr[looks.drone == row][0] for row in range(5)]))
    lost_db = 10 * np.log10(ratios[1] / ratios[0])
    np.testing.assert_allclose(lost_db[:3], [-23.1, -9.9, -7.2], atol=0.1)
    assert abs(lost_db[3]) < 0.5
    assert lost_db[4] == 0


WOODS = {"id": "woods", "plots_per_km2": 20.0, "cell_m": 100.0,
         "area": [place(20, 2000, 0.0), place(60, 2000, 0.0), place(60, 4000, 0.0),
                  place(20, 4000, 0.0)]}  # fmt: skip


def test_the_map_of_clutter_is_that_of_the_seed_and_can_be_learnt() -> None:
    sensor = radar(scan=rotating(), range_floor_m=0.1)
    edges = np.arange(0, 4001, 100)

    def learnt(seed: int, start_s: int) -> Array:
        """How many plots are in each square."""
        made = scene([sensor], seed=seed, clutter=[WOODS])
        plots = simulate(made, 150, start_utc_ns=START_NS + start_s * 10**9)["radar"].plots
        plots = plots.rows(plots.drone == 0)
        east, north, _ = aer_to_enu(plots.azimuth_deg, 0.0, plots.range_m).T
        return np.histogram2d(east, north, bins=(edges, edges))[0].ravel()

    first, second, another = learnt(5, 0), learnt(5, 300), learnt(6, 0)
    there = first + second > 0
    assert np.corrcoef(first[there], second[there])[0, 1] > 0.9
    assert np.corrcoef(first[there], another[there])[0, 1] < 0.5


SEA = {key: value for key, value in WOODS.items() if key != "plots_per_km2"} | {
    "id": "sea", "threshold_db": 10.0, "shape": 0.5, "cell_m": 50.0,
}  # fmt: skip


@pytest.mark.parametrize("stays", [True, False])
def test_spiky_clutter_crosses_a_fixed_threshold_as_often_as_the_k_distribution_says(
    stays: bool,
) -> None:
    """Ten times the mean, of order 0.5: 0.0114 of all cells, where noise would have 4.5e-5."""
    sensor = radar(pfa=1e-12, range_resolution_m=40.0, azimuth_beamwidth_deg=4.0)
    made = scene([sensor], seed=8, clutter=[SEA | {"texture_stays": stays}])
    plots = simulate(made, 200, start_utc_ns=START_NS)["radar"].plots
    # Cells in a sector of 40 degrees from 2 to 4 km: as many in every ring.
    mean = 200 * (4000 - 2000) / 40.0 * 40 / 4.0 * 0.0114228909934669
    assert mean > 800
    assert 0.8 < len(plots) / mean < 1.25  # corners of squares, and of this seed's map
    counts = np.bincount(plots.scan - plots.scan.min(), minlength=200)[:200]
    assert counts.var() / counts.mean() < 2.0
    twice = 2 ** ((plots.run_length_deg / 4.0) ** 2) > 2  # power over the threshold
    if stays:
        assert 0.1 < twice.mean() < 0.25
    else:  # the tail of this order is exp(-sqrt(2T))
        n, p = len(plots), np.exp(np.sqrt(20.0) - np.sqrt(40.0))
        assert_sum(float(twice.sum()), n * p, n * p * (1 - p), "spikes")


def told(**world: Any) -> Feed:
    return fly(scene([radar(scan=rotating(), pfa=1e-7)], [held("d", 10, 4.0, 2000.0, rcs_m2=0.1)],
                     seed=9, **world), 12)  # fmt: skip


def test_the_ledger_says_what_each_plot_is_of() -> None:
    road = told(birds=[FLOCK | {"rcs_m2": 0.02}], clutter=[WOODS])
    looks = [look for entry in road.ledgers for look in entry.looks]
    plots = [plot for entry in road.ledgers for plot in entry.plots]
    assert {look.other.partition("/")[0] for look in looks} == {"", "bird"}
    assert all(bool(look.drone) != bool(look.other) for look in looks)
    assert {plot.other.partition("/")[0] for plot in plots} == {"", "bird", "clutter"}
    for plot in plots:
        assert not (plot.drone and plot.other)
        assert plot.HasField("range_m") == (bool(plot.drone) or plot.other.startswith("bird/"))
    detected = sum(look.detected for look in looks if look.other)
    assert detected == sum(plot.other.startswith("bird/") for plot in plots)
    assert {plot.drone for plot in plots} == {"", "d"}


def test_without_them_the_ledger_and_the_plots_are_the_octets_that_they_were() -> None:
    """What others do changes nothing of the drone's looks, nor of false alarms."""
    plain, crowded = told(), told(birds=[FLOCK], clutter=[WOODS])
    before = [[look.SerializeToString() for look in e.looks] for e in plain.ledgers]
    after = [[x.SerializeToString() for x in e.looks if not x.other] for e in crowded.ledgers]
    assert before == after
    alarms = [
        [plot.time_utc_ns for e in road.ledgers for plot in e.plots if not plot.drone + plot.other]
        for road in (plain, crowded)
    ]
    assert alarms[0] == alarms[1]
