"""Gains over the cover and cells, as the ledger and detections have them, by equations anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.every_kind import MIMO, PASSIVE
from support.oracle_beside import check, sensors_of
from support.significance import assert_sum

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.testing import flown, fly, held, radar, rotating, scene, waypoint

SHAPED = {"kind": "cosecant-squared", "from_deg": 4.0, "to_deg": 30.0, "beamwidth_deg": 3.0}
NARROW = {"kind": "gaussian", "beamwidth_deg": 8.0, "boresight_deg": 10.0}
ACTIVE = radar(
    elevation_max_deg=60.0, antenna={"transmit": {"elevation": SHAPED, "sidelobe_db": 30.0},
                                     "receive": {"elevation": NARROW}},
)  # fmt: skip


def climbing(n: int = 24) -> list[dict[str, Any]]:
    """Drones at elevations all over the cover."""
    return [held(f"d{i}", 15.0 * i, 0.5 + 2.2 * i, 3000.0, rcs_m2=0.05) for i in range(n)]


TABLE_CUT = {"kind": "table", "angle_deg": [-40.0, 0.0, 40.0], "gain_db": [-12.0, 0.0, -4.0],
             "boresight_deg": 30.0}  # fmt: skip
BEAM = {"kind": "gaussian", "beamwidth_deg": 20.0, "boresight_deg": 90.0}
BEAMS = {"azimuth": {"kind": "beams", "spacing_deg": 3.0}, "sidelobe_db": 40.0}
CASES = {
    "staring": ACTIVE,
    "rotating": ACTIVE | {"scan": rotating(1.0, 8)},
    "leaning": ACTIVE | {"bias": {"tilt_deg": 5.0, "tilt_azimuth_deg": 0.0}},
    "MIMO": MIMO | {"antenna": {"receive": BEAMS,
                                "transmit": {"azimuth": BEAM, "sidelobe_db": 25.0}}},
    "passive": PASSIVE | {"antenna": {"receive": {"azimuth": TABLE_CUT, "sidelobe_db": 100.0}}},
    "between cells": radar(straddling={"range": "sinc", "doppler": "hann"}, doppler={}),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_echoes_have_the_gain_of_where_they_are(case: str, tmp_path: Path) -> None:
    path = (waypoint(30.0, 4.0, 3000.0), waypoint(30.0, 4.0, 2000.0))
    drones = [*climbing(), flown("d", *path, speed_m_s=9.37, repeat=False)]
    plain = {k: v for k, v in CASES[case].items() if k not in {"antenna", "straddling"}}
    ratios = []
    for sensor in (CASES[case], plain):
        made = scene([sensor], drones, seed=31)
        check(made, tmp_path, 5)
        ratios.append(next(looks.snr for _, looks, _, _ in sensors_of(made, 5)))
    assert np.ptp(ratios[0] / ratios[1]) > 0.2


@pytest.mark.parametrize("scan", [{}, {"scan": rotating(1.0, 8)}], ids=["staring", "rotating"])
def test_detections_are_as_many_as_the_gain_leaves(scan: dict[str, Any]) -> None:
    looks = fly(scene([ACTIVE | scan], climbing(), seed=31), 60).looks()
    assert np.ptp(looks.pd) > 0.9
    for low, high in ((0, 10), (10, 20), (20, 60)):
        rows = (looks.elevation_deg >= low) & (looks.elevation_deg < high)
        p = looks.pd[rows]
        assert_sum(looks.detected[rows].sum(), p.sum(), (p * (1 - p)).sum(), f"{low} to {high}")


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
