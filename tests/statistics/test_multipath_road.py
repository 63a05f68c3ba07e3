"""Two rays over flat ground, as `check` predicts them."""

from __future__ import annotations

from plotfeed.feeds.cli.check import report
from plotfeed.testing import flown, radar, scene, waypoint

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
