"""Plots by side lobes: at a drone's range, in the direction in which the beam looks.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.every_kind import PASSIVE
from support.radar_equations import pd
from support.significance import Array, assert_law, assert_standard_normal, assert_sum

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.frames import wrap_180
from plotfeed.testing import START_NS, fly, held, radar, rotating, scene, staring

SCANS, BEAM_DEG, AZIMUTH_DEG, RANGE_M = 150, 2.0, 77.0, 1500.0
OUT_DB, BACK_DB = 25.0, 25.0
ANTENNA = {
    "receive": {"sidelobe_db": BACK_DB}, "transmit": {"sidelobe_db": OUT_DB},
    "sidelobe_plots": True,
}  # fmt: skip
DRONE = held("near", AZIMUTH_DEG, 5.0, RANGE_M, rcs_m2=0.03)
FAR = held("far", 200.0, 5.0, 9000.0, rcs_m2=0.03)


@cache
def seen(kind: str, **changes: Any) -> tuple[SimulatedSensor, Array]:
    """What a radar reports, and which of its plots are by side lobes."""
    scan = rotating(1.0, 8) if kind == "rotating" else staring()
    antenna = ANTENNA if kind != "plain" else {**ANTENNA, "sidelobe_plots": False}
    made = scene([radar(scan=scan, antenna=antenna, pfa=1e-9, **changes)], [DRONE, FAR], seed=121)
    found = simulate(made, SCANS, start_utc_ns=START_NS)
    names = np.array(found.drones)[found["radar"].plots.drone]
    return found["radar"], (names == "sidelobe/radar") & (found["radar"].plots.drone >= 0)


def expected(kind: str) -> float:
    """Mean number in a scan: beams but those about the drone, each with its Pd."""
    lost_db = BACK_DB + OUT_DB * (kind == "rotating")
    sensor = radar(pfa=1e-9)
    beams = 360.0 / BEAM_DEG * (1 - 2 * BEAM_DEG / 360.0)
    rcs_m2 = 0.03 * 10 ** (-lost_db / 10)
    return float(beams * pd(sensor, np.array([RANGE_M]), np.array([rcs_m2]))[0])


@pytest.mark.parametrize("kind", ["rotating", "staring"])
def test_they_are_as_many_as_beams_detect(kind: str) -> None:
    found, by_sidelobes = seen(kind)
    mean = expected(kind)
    assert mean * SCANS > 100
    scans = len(np.unique(found.looks.scan))
    spread = mean * (1 - mean * BEAM_DEG / 360.0)
    assert_sum(float(by_sidelobes.sum()), scans * mean, scans * spread, kind)


def test_they_stand_where_the_beam_looks_at_the_range_of_the_drone() -> None:
    found, by_sidelobes = seen("rotating")
    plots = found.plots.rows(by_sidelobes)
    errors = (plots.range_m - RANGE_M) / plots.sigma_range_m
    assert_standard_normal(errors, "ranges")
    off_deg = wrap_180(plots.azimuth_deg - AZIMUTH_DEG)
    assert np.abs(off_deg).min() > BEAM_DEG / 4  # a beam's width, and its errors
    within = np.abs(off_deg) > 2 * BEAM_DEG
    span = 180.0 - 2 * BEAM_DEG
    shares = (np.abs(off_deg[within]) - 2 * BEAM_DEG) / span
    assert_law(shares, "uniform", "directions")
    into_s = (plots.t_utc_ns - START_NS) / 1e9 % 1.0
    beam_deg = 360.0 * into_s
    assert np.abs(wrap_180(plots.azimuth_deg - beam_deg)).max() < 3 * BEAM_DEG


def test_looks_and_other_plots_are_as_they_were() -> None:
    plain, none = seen("plain")
    found, by_sidelobes = seen("staring")
    assert not none.any()
    for name in ("drone", "pd", "snr", "detected", "t_utc_ns"):
        np.testing.assert_array_equal(getattr(plain.looks, name), getattr(found.looks, name))
    np.testing.assert_array_equal(plain.plots.range_m, found.plots.range_m[~by_sidelobes])


def test_how_long_stretches_are_changes_nothing() -> None:
    """The draws of a sector are its own: another radar beside does not change them."""
    found, by_sidelobes = seen("rotating")
    sensors = [
        radar(id=name, scan=rotating(1.0, 8), antenna=ANTENNA, pfa=1e-9)
        for name in ("other", "radar")
    ]
    both = simulate(scene(sensors, [DRONE, FAR], seed=121), 20, start_utc_ns=START_NS)
    plots = both["radar"].plots
    mine = plots.drone == list(both.drones).index("sidelobe/radar")
    first = found.plots.range_m[by_sidelobes][: mine.sum()]
    assert mine.any()
    np.testing.assert_array_equal(plots.range_m[mine], first)


def test_the_ledger_says_what_they_are_and_the_report_takes_them_for_no_drones() -> None:
    sensor = radar(antenna=ANTENNA, pfa=1e-9)
    road = fly(scene([sensor], [DRONE], seed=122), 6)
    told = [plot for entry in road.ledgers for plot in entry.plots]
    others = [plot for plot in told if plot.other]
    assert {plot.other for plot in others} == {"sidelobe/radar"}
    assert not any(plot.drone or plot.HasField("range_m") for plot in others)
    assert {plot.drone for plot in told if not plot.other} <= {"near", ""}


@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        (radar(antenna={"sidelobe_plots": True}), "needs receive"),
        (PASSIVE | {"antenna": {"receive": {}, "sidelobe_plots": True}}, "not of a passive radar"),
        (radar(antenna=ANTENNA, mount={}), "nor of a beam that is steered"),
    ],
)
def test_where_they_are_not_modelled_a_line_says_so(sensor: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scene([sensor], seed=1)


def test_who_is_plotted_through_a_side_lobe_alone_gets_no_track_and_stops_none() -> None:
    strong = held("near", AZIMUTH_DEG, 5.0, RANGE_M, rcs_m2=30.0)
    sensor = radar(scan=rotating(1.0, 8), antenna=ANTENNA, report=["asterix-062"], pfa=1e-9)
    found = fly(scene([sensor], [strong], seed=122), 20.0)
    assert any(message.topic.endswith("asterix/062") for message in found.messages)
