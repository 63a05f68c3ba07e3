"""Radars of several receivers through the whole road: places, covariances and ghosts.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.significance import assert_sum

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.state import FALSE_ALARM
from plotfeed.testing import START_NS, fly, held, scene, staring

MASTS = [(-8000.0, 15_000.0, 200.0), (17_000.0, 3000.0, 150.0), (2000.0, -17_500.0, 120.0)]


def place(east_m: float, north_m: float, above_site_m: float) -> dict[str, float]:
    return {"east_m": east_m, "north_m": north_m, "above_site_m": above_site_m}


def passive(masts: int = 3, receivers: int = 1, **changes: Any) -> dict[str, Any]:
    usual = {
        "id": "net", "type": "multistatic_passive", "scan": staring(), "gain_rx_dbi": 10.0,
        "transmitters": [
            {"id": f"m{i}", "preset": "dvb-t", "erp_w": 1e5, "place": place(*where)}
            for i, where in enumerate(MASTS[:masts])
        ],
        "receivers": [
            {"id": f"r{i}"} | place(2500.0 * i, 800.0 * i * i, 5.0) for i in range(1, receivers)
        ],
        "azimuth_beamwidth_deg": 10.0, "integration_s": 0.3, "external_noise_db": -4.45,
        "range_max_m": 9000.0, "bistatic_range_floor_m": 5.0, "report": ["plots"],
    }  # fmt: skip
    return usual | changes


def mimo(**changes: Any) -> dict[str, Any]:
    usual = {
        "id": "net", "type": "multistatic_mimo", "scan": staring(), "frequency_hz": 15e9,
        "gain_tx_dbi": 30.0, "gain_rx_dbi": 30.0, "integration_s": 0.06,
        "range_resolution_m": 20.0, "range_max_m": 9000.0, "azimuth_beamwidth_deg": 3.0,
        "elevation_beamwidth_deg": 10.0, "elevation_min_deg": -5.0, "elevation_max_deg": 60.0,
        "transmitters": [{"power_w": 2000.0} | place(900.0 * k, 0.0, 3.0) for k in range(2)],
        "receivers": [{"id": "r1"} | place(2500.0, 800.0, 5.0)], "report": ["plots"],
    }  # fmt: skip
    return usual | changes


def watched(sensor: dict[str, Any], drones: list[dict[str, Any]], scans: int) -> SimulatedSensor:
    return simulate(scene([sensor], drones, seed=101), scans, start_utc_ns=START_NS)["net"]


@cache
def one_drone(kind: str, receivers: int) -> SimulatedSensor:
    drone = held("d", 35.0, 1.4, 3000.0, rcs_m2=1.0)
    sensor = mimo() if kind == "mimo" else passive(receivers=receivers)
    return watched(sensor, [drone], 100)


def squares(plots: Any) -> Any:
    """Normalised squares of errors over the ground; 2 on average."""
    found = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    true = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
    east, north = (found - true).T[:2]
    ee, nn, en = (
        plots.covariance_east_m2,
        plots.covariance_north_m2,
        plots.covariance_east_north_m2,
    )
    return (nn * east**2 + ee * north**2 - 2 * en * east * north) / (ee * nn - en**2)


@pytest.mark.parametrize(("kind", "receivers"), [("passive", 1), ("passive", 2), ("mimo", 2)])
def test_places_scatter_by_the_stated_covariance(kind: str, receivers: int) -> None:
    """The mean square is 2, or a little less: a height here is as expected, not drawn."""
    plots = one_drone(kind, receivers).plots
    n = len(plots)
    assert n > 90
    assert 1.2 < squares(plots).mean() < 2.6
    assert (plots.drone == 0).mean() > 0.98


def test_more_receivers_know_places_better() -> None:
    one, two = (one_drone("passive", n).plots for n in (1, 2))
    for name in ("covariance_east_m2", "covariance_north_m2"):
        assert np.median(getattr(two, name)) < np.median(getattr(one, name))


def test_each_pair_looks_and_detects_by_itself() -> None:
    weak = held("d", 35.0, 1.4, 3000.0, rcs_m2=0.0003)
    seen = watched(passive(), [weak], 200)
    looks = seen.looks
    assert sorted(set(looks.channel.tolist())) == [0, 1, 2]
    assert 0.2 < looks.pd.mean() < 0.95
    spread = (looks.pd * (1 - looks.pd)).sum()
    assert_sum(float(looks.detected.sum()), float(looks.pd.sum()), float(spread))
    all_three = looks.detected.reshape(-1, 3).all(axis=1).sum()
    fitting = 1 - 0.0027
    assert_sum(float(len(seen.plots)), all_three * fitting, all_three * 0.003 + 1, "places")


def test_detections_of_several_drones_make_ghosts_where_beams_do_not_tell() -> None:
    """Four drones, three masts, one receiver that tells no directions: 60 wrong sets, of which one
    in ten fits by chance; with a beam of 10 degrees hardly any.
    """
    drones = [
        held(f"d{i}", azimuth_deg, 1.0, range_m, rcs_m2=1.0)
        for i, (azimuth_deg, range_m) in enumerate(
            ((20.0, 2500.0), (50.0, 3200.0), (75.0, 2700.0), (40.0, 4100.0))
        )
    ]
    deaf = passive(azimuth_beamwidth_deg=360.0, azimuth_floor_deg=60.0, bistatic_range_floor_m=20.0)
    found = watched(deaf, drones, 25).plots
    ghosts = float((found.drone == FALSE_ALARM).sum()) / 25
    assert 0.5 < ghosts < 20
    sharp = watched(passive(), drones, 25).plots
    assert float((sharp.drone == FALSE_ALARM).sum()) / 25 < ghosts / 4
    assert np.isnan(found.true_range_m[found.drone == FALSE_ALARM]).all()


def test_a_place_takes_as_many_pairs_as_stated() -> None:
    drone = held("d", 35.0, 1.4, 3000.0, rcs_m2=0.0004)
    few = watched(passive(receivers=2, fewest_pairs=3), [drone], 40)
    many = watched(passive(receivers=2, fewest_pairs=6), [drone], 40)
    hits = many.looks.detected.reshape(-1, 6).sum(axis=1)
    assert len(many.plots) <= (hits == 6).sum()
    assert len(few.plots) > len(many.plots)


def test_what_is_told_in_category_015_and_protobuf() -> None:
    sensor = passive(report=["asterix-015", "plots", "sapient"])
    road = fly(scene([sensor], [held("d", 35.0, 1.4, 3000.0, rcs_m2=1.0)], seed=102), 6)
    plots, records = road.plots("net"), road.records("net", 15)
    assert len(plots) == len(records) > 3
    ranges_m = [float(record.get("I015/625/R")) for record in records]
    np.testing.assert_allclose(ranges_m, plots.range_m, atol=0.06)
    assert np.abs(plots.height_m - plots.height_m.mean()).max() < 300
    assert not road.payloads("net/asterix/016")


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        (passive(masts=2), "with 2 transmitters they make 2 pairs; a place takes 3"),
        (passive(doppler={}), "doppler: not modelled of several receivers"),
        (passive(bias={"tilt_deg": 1.0}), "bias.tilt_deg: not modelled of several receivers"),
        (mimo(bias={"range_scale": 0.01}), "range_scale: not modelled of several"),
        (passive(masts=3, receivers=1, fewest_pairs=4), "a place takes 4"),
        (mimo(receivers=[]), "with 2 transmitters they make 2 pairs; a place takes 3"),
    ],
)
def test_stations_that_make_no_places_and_keys_that_change_none_are_refused(
    sensor: dict[str, Any], message: str
) -> None:
    with pytest.raises(SceneError) as caught:
        scene([sensor], seed=1)
    assert message.partition(": ")[2] in str(caught.value) or message in str(caught.value)


def test_a_clock_that_is_ahead_is_taken() -> None:
    scene([mimo(bias={"time_offset_s": 1.5, "range_offset_m": 0.0})], seed=1)
