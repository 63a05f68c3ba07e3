"""Gains over the cover and cells, as the ledger and detections have them, by equations anew."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.every_kind import MIMO, PASSIVE
from support.radar_equations import LIGHT_M_S, mean_snr, pd
from support.road import flown, fly, held, radar, rotating, scene, waypoint
from support.significance import Array, assert_sum

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180

SHAPED = {"kind": "cosecant-squared", "from_deg": 4.0, "to_deg": 30.0, "beamwidth_deg": 3.0}
NARROW = {"kind": "gaussian", "beamwidth_deg": 8.0, "boresight_deg": 10.0}
ACTIVE = radar(
    elevation_max_deg=60.0, antenna={"transmit": {"elevation": SHAPED, "sidelobe_db": 30.0},
                                     "receive": {"elevation": NARROW}},
)  # fmt: skip


def linear(db: Array | float) -> Array:
    return np.asarray(10 ** (np.asarray(db) / 10))


def gaussian(off_deg: Array, width_deg: float) -> Array:
    """A half is left half a width off."""
    return np.asarray(0.5 ** ((2 * off_deg / width_deg) ** 2))


def shaped(elevation_deg: Array) -> Array:
    within = np.clip(elevation_deg, 4.0, 30.0)
    falls = gaussian(elevation_deg - within, 3.0)
    lit = np.sin(np.radians(4.0)) ** 2 / np.sin(np.radians(within)) ** 2
    return np.maximum(lit * falls, linear(-30.0))


def active_gain(elevation_deg: Array) -> Array:
    received = np.maximum(gaussian(elevation_deg - 10.0, 8.0), linear(-22.0))
    return shaped(elevation_deg) * received


def climbing(n: int = 24) -> list[dict[str, Any]]:
    """Drones at elevations all over the cover."""
    return [held(f"d{i}", 15.0 * i, 0.5 + 2.2 * i, 3000.0, rcs_m2=0.05) for i in range(n)]


@pytest.mark.parametrize("scan", [{}, {"scan": rotating(1.0, 8)}], ids=["staring", "rotating"])
def test_echoes_have_the_gain_of_their_elevation_and_pd_follows(scan: dict[str, Any]) -> None:
    sensor = ACTIVE | scan
    looks = fly(scene([sensor], climbing(), seed=31), 60).looks()
    snr = mean_snr(sensor, looks.range_m, 0.05) * active_gain(looks.elevation_deg)
    np.testing.assert_allclose(linear(looks.snr_db), snr, rtol=1e-9)
    rcs_m2 = 0.05 * active_gain(looks.elevation_deg)
    np.testing.assert_allclose(looks.pd, pd(sensor, looks.range_m, rcs_m2), rtol=1e-9)
    assert np.ptp(looks.pd) > 0.9
    for low, high in ((0, 10), (10, 20), (20, 60)):
        rows = (looks.elevation_deg >= low) & (looks.elevation_deg < high)
        p = looks.pd[rows]
        assert_sum(looks.detected[rows].sum(), p.sum(), (p * (1 - p)).sum(), f"{low} to {high}")


def test_the_pattern_leans_with_the_sensor() -> None:
    tilt = {"bias": {"tilt_deg": 5.0, "tilt_azimuth_deg": 0.0}}
    drones = [held("ahead", 0.0, 10.0, 3000.0), held("behind", 180.0, 10.0, 3000.0)]
    looks = fly(scene([ACTIVE | tilt], drones, seed=32), 4).looks()
    for name, own_deg in (("ahead", 15.0), ("behind", 5.0)):
        of = looks.rows(looks.drone == name)
        snr = mean_snr(ACTIVE, of.range_m) * active_gain(np.full(len(of), own_deg))
        np.testing.assert_allclose(linear(of.snr_db), snr, rtol=1e-3)


def test_each_transmitter_of_a_mimo_radar_has_the_pattern_where_it_stands() -> None:
    beam = {"kind": "gaussian", "beamwidth_deg": 20.0, "boresight_deg": 90.0}
    antenna = {"receive": {"azimuth": {"kind": "beams", "spacing_deg": 3.0}, "sidelobe_db": 40.0},
               "transmit": {"azimuth": beam, "sidelobe_db": 25.0}}  # fmt: skip
    drones = [held(f"d{i}", 70.0 + 3.3 * i, 5.0, 900.0) for i in range(12)]
    plain, found = (
        fly(scene([MIMO | more], drones, seed=33), 3).looks() for more in ({}, {"antenna": antenna})
    )
    places = aer_to_enu(plain.azimuth_deg, plain.elevation_deg, plain.range_m)
    shares = []
    for k in range(2):
        there = places - [100.0 * k, 0.0, 0.0]
        azimuth_deg, _, range_tx_m = enu_to_aer(there)
        out = np.maximum(gaussian(azimuth_deg - 90.0, 20.0), linear(-25.0))
        shares.append((out / range_tx_m**2, 1 / range_tx_m**2))
    lit = sum(a for a, _ in shares) / sum(b for _, b in shares)
    off_deg = (plain.azimuth_deg - (-180 + 1.5) + 1.5) % 3.0 - 1.5  # 120 beams, the first at -178.5
    expected = lit * np.maximum(gaussian(off_deg, 3.0), linear(-40.0))
    np.testing.assert_allclose(linear(found.snr_db - plain.snr_db), expected, rtol=1e-6)
    assert np.ptp(expected) > 0.3


def test_a_passive_radar_hears_by_its_own_pattern() -> None:
    table = {"kind": "table", "angle_deg": [-40.0, 0.0, 40.0], "gain_db": [-12.0, 0.0, -4.0],
             "boresight_deg": 30.0}  # fmt: skip
    drones = [held(f"d{i}", 5.0 * i, 5.0, 3000.0, rcs_m2=0.001) for i in range(14)]
    plain, found = (
        fly(scene([PASSIVE | more], drones, seed=34), 3).looks()
        for more in ({}, {"antenna": {"receive": {"azimuth": table, "sidelobe_db": 100.0}}})
    )
    before, after = (linear(each.snr_db) for each in (plain, found))
    most = 0.3 * 7.61e6  # behind the correlator an echo disturbs itself
    power = [each / (most - each) for each in (before, after)]
    off_deg = wrap_180(plain.azimuth_deg - 30.0)
    gain_db = np.interp(off_deg, [-40.0, 0.0, 40.0], [-12.0, 0.0, -4.0])
    np.testing.assert_allclose(power[1] / power[0], linear(gain_db), rtol=1e-6)


def test_between_the_middles_of_cells_echoes_are_weaker() -> None:
    """A drone that comes in crosses cells of 10 m, and of half a centimetre a second and more."""
    path = (waypoint(30.0, 4.0, 3000.0), waypoint(30.0, 4.0, 2000.0))
    drone = flown("d", *path, speed_m_s=9.37, repeat=False)
    sensor = radar(straddling={"range": "sinc", "doppler": "hann"}, doppler={})
    flight = fly(scene([sensor], [drone], seed=35), 100)
    looks, plots = flight.looks(), flight.plots()
    cells = looks.range_m / 10.0
    in_range = np.sinc(cells - np.rint(cells)) ** 2
    cell_m_s = LIGHT_M_S / 10e9 / (2 * 0.06)
    off = plots.true_range_rate_m_s[0] / cell_m_s
    off -= np.rint(off)
    expected = mean_snr(sensor, looks.range_m) * in_range * (np.sinc(off) / (1 - off**2)) ** 2
    np.testing.assert_allclose(linear(looks.snr_db), expected, rtol=1e-3)
    assert in_range.min() < 0.45
    assert in_range.max() > 0.99


def test_check_predicts_the_gain_and_names_it() -> None:
    named, plain = (
        report(scene([sensor], seed=36))["sensors"][0]
        for sensor in (ACTIVE, radar(elevation_max_deg=60.0))
    )
    range_m = np.array([row["range_m"] for row in plain["table"]])
    elevation_deg = np.degrees(np.arcsin(50.0 / range_m))
    gained_db = [
        a["snr_db"] - b["snr_db"] for a, b in zip(named["table"], plain["table"], strict=True)
    ]
    np.testing.assert_allclose(linear(gained_db), active_gain(elevation_deg), rtol=1e-6)
    assert named["effects"].keys() == {"antenna"}


def test_a_shaped_beam_of_no_stated_gain_spreads_what_it_has() -> None:
    sensor = {key: value for key, value in ACTIVE.items() if key != "gain_rx_dbi"}
    antennas = ({}, {"antenna": {"receive": {"elevation": SHAPED}}})
    gains = []
    for antenna in antennas:
        made = scene([sensor | {"antenna": antenna.get("antenna", {})}], seed=37)
        model: Any = made.sensor[0].model(made.scene.site)
        gains.append(model.gain_rx_dbi)
    e1, e2 = np.radians(4.0), np.radians(30.0)
    assert gains[0] - gains[1] == pytest.approx(10 * np.log10(2 - e1 / np.tan(e2)), rel=1e-12)


TABLE = {"kind": "table", "gain_db": [0.0, 0.0]}


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"scan": rotating(), "antenna": {"receive": {"azimuth": NARROW}}}, "meets every drone"),
        ({"antenna": {"receive": {"elevation": SHAPED | {"to_deg": 3.0}}}}, "above from_deg"),
        ({"antenna": {"receive": {"azimuth": TABLE | {"angle_deg": [0, 0]}}}}, "must rise"),
        ({"antenna": {"receive": {"azimuth": TABLE | {"angle_deg": [0, 1, 2]}}}}, "as many as"),
        ({"straddling": {"doppler": "hann"}}, "needs doppler"),
    ],
)  # fmt: skip
def test_what_no_antenna_can_be_is_refused_in_a_line(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scene([radar(**keys)], seed=38)
    with pytest.raises(SceneError, match="transmits nothing"):
        scene([PASSIVE | {"antenna": {"transmit": {}}}], seed=38)
