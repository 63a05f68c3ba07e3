"""Gains over the cover and cells, as the ledger and detections have them, by equations anew."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.every_kind import PASSIVE

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.testing import flown, radar, rotating, scene, waypoint

SHAPED = {"kind": "cosecant-squared", "from_deg": 4.0, "to_deg": 30.0, "beamwidth_deg": 3.0}
NARROW = {"kind": "gaussian", "beamwidth_deg": 8.0, "boresight_deg": 10.0}
ACTIVE = radar(
    elevation_max_deg=60.0, antenna={"transmit": {"elevation": SHAPED, "sidelobe_db": 30.0},
                                     "receive": {"elevation": NARROW}},
)  # fmt: skip


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
    within_deg = np.clip(elevation_deg, 4.0, 30.0)
    falls_db = 12.0412 * ((elevation_deg - within_deg) / 3.0) ** 2
    rises_db = 20 * np.log10(np.sin(np.radians(within_deg)) / np.sin(np.radians(4.0)))
    received_db = np.minimum(12.0412 * ((elevation_deg - 10.0) / 8.0) ** 2, 22.0)
    lost_db = np.minimum(falls_db + rises_db, 30.0) + received_db
    np.testing.assert_allclose(gained_db, -lost_db, atol=1e-4)
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


# Two rays over flat ground, as `check` predicts them.


GROUND = {"reflection": -0.9, "antenna_height_m": 5.0}


def test_check_predicts_the_lobes() -> None:
    """Of one drone that flies from 3 km to 1 km, some 50 m up."""
    ends = (waypoint(33.0, 1.0, 3000.0), waypoint(33.0, 3.0, 1000.0))
    approach = [flown("d", *ends, speed_m_s=10.0, repeat=False)]
    free, over_ground = (
        report(scene([radar(elevation_max_deg=60.0, **named)], approach, seed=93))["sensors"][0]
        for named in ({}, {"multipath": GROUND})
    )
    assert over_ground["effects"] == {"multipath": GROUND}
    assert free["effects"] == {}
    gains_db = [
        a["snr_db"] - b["snr_db"] for a, b in zip(over_ground["table"], free["table"], strict=True)
    ]
    assert -40.1 < min(gains_db) < max(gains_db) < 11.2
    assert max(gains_db) - min(gains_db) > 3
