"""A ridge and a block of houses in the way, by looks and plots, in every kind of sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.every_kind import FAR_SENSORS
from support.hills import footprint, write_buildings, write_ridge
from support.radar_equations import LIGHT_M_S

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.models.effects.line_of_sight import knife_edge_loss_db
from plotfeed.models.frames import aer_to_enu
from plotfeed.testing import START_NS, held, radar, scene, staring

EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
WAYS = {"radar": 2, "mimo": 2, "passive": 1, "rf": 1, "array": 1}
WAVES_M = {"radar": LIGHT_M_S / 10e9, "mimo": LIGHT_M_S / 15e9, "passive": LIGHT_M_S / 600e6,
           "rf": LIGHT_M_S / 2.44e9, "array": 0.343}  # fmt: skip


def drone(name: str, azimuth_deg: float, elevation_deg: float, range_m: float) -> dict[str, Any]:
    return held(name, azimuth_deg, elevation_deg, range_m, emitters=[EMITTER], sound_power_db=130.0,
                rcs_m2=0.03)  # fmt: skip


def flown(sensor: dict[str, Any], drones: Any, folder: Path, **terrain: Any) -> SimulatedSensor:
    named = {"terrain": terrain} if terrain else {}
    made = scene([sensor], drones, seed=77, folder=folder, **named)
    return simulate(made, 30, start_utc_ns=START_NS)[sensor["id"]]


@pytest.mark.parametrize("kind", FAR_SENSORS)
def test_behind_a_ridge_nothing_is_seen_and_above_it_all_is_as_it_was(
    kind: str, tmp_path: Path
) -> None:
    """Looks at whom nothing hides are the same to the bit."""
    ridge = write_ridge(tmp_path, height_m=800)
    seen = [drone("above", 5, 10.0, 4000.0), drone("south", 175, 2.0, 2000.0)]
    drones = [drone("behind", 5, 1.0, 4000.0), *seen]
    free = flown(FAR_SENSORS[kind], drones, tmp_path)
    hidden = flown(FAR_SENSORS[kind], drones, tmp_path, elevation=[ridge])
    assert (free.looks.pd[free.looks.drone == 0] > 0.9).all()
    assert (hidden.looks.pd[hidden.looks.drone == 0] < 1e-5).all()
    looked_at = set(hidden.looks.drone.tolist())
    assert looked_at == ({0, 1, 2} if kind in WAYS else {1, 2})
    assert not (hidden.plots.drone == 0).any()
    before, after = (each.looks.rows(each.looks.drone > 0) for each in (free, hidden))
    assert len(after) > 20
    for column in ("range_m", "azimuth_deg", "snr", "pd"):
        np.testing.assert_array_equal(getattr(before, column), getattr(after, column))


@pytest.mark.parametrize("kind", WAYS)
def test_over_the_edge_signals_bend_each_way(kind: str, tmp_path: Path) -> None:
    block = footprint(0.0, 2000.0, 200.0)
    city = write_buildings(tmp_path, [(block, 60.0)])
    drones = [drone(f"d{i}", 0.0, up, 4000.0) for i, up in enumerate(np.linspace(0.7, 2.5, 12))]
    free = flown(FAR_SENSORS[kind], drones, tmp_path).looks
    bent = flown(FAR_SENSORS[kind], drones, tmp_path, buildings=[city], diffraction=True).looks
    place = aer_to_enu(free.azimuth_deg, free.elevation_deg, free.range_m)
    ground_m = np.hypot(place[:, 0], place[:, 1])
    edge_m = 1900.0
    bend = ground_m / (8 * 6_371_000.0)  # slope by which air of 4/3 raises the far end
    over_m = 60.0 - edge_m * (place[:, 2] / ground_m + bend) + edge_m**2 / (8 * 6_371_000.0)
    over_m -= edge_m**2 / (2 * 6_371_000.0)  # the Earth falls away below the block
    nu = over_m * np.sqrt(2 * ground_m / (edge_m * (ground_m - edge_m) * WAVES_M[kind]))
    lost_db = WAYS[kind] * knife_edge_loss_db(nu)
    assert lost_db.max() > 12 * WAYS[kind] * (kind != "array")
    assert lost_db.min() < lost_db.max() / 2
    ratio_db = 10 * np.log10(free.snr / bent.snr)
    np.testing.assert_allclose(ratio_db, lost_db, atol=0.3)


def apart(east_m: float, north_m: float, up_m: float) -> dict[str, float]:
    return {"east_m": east_m, "north_m": north_m, "above_site_m": up_m}


def test_the_second_array_of_a_pair_hears_by_where_it_stands(tmp_path: Path) -> None:
    """A block stands between it and the drone, and not between that and the first."""
    city = write_buildings(tmp_path, [(footprint(45.0, 280.0, 40.0), 80.0)])
    pair = {
        "id": "pair", "type": "acoustic_pair", "scan": staring(), "noise_db": 0.0,
        "sensitivity_db": -20.0, "range_max_m": 1000.0, "azimuth_beamwidth_deg": 20.0,
        "second_array": apart(400.0, 0.0, 1.5), "report": ["plots"],
    }  # fmt: skip
    drones = [drone("d", 0.0, 4.0, 400.0)]
    free, hidden = (flown(pair, drones, tmp_path, **named) for named in ({}, {"buildings": [city]}))
    assert len(free.plots)
    assert not len(hidden.plots)
    alone = {k: v for k, v in pair.items() if k != "second_array"} | {"type": "acoustic"}
    first = flown(alone, drones, tmp_path,
                  buildings=[city])  # fmt: skip
    assert (first.looks.pd > 0.9).all()


def test_a_beam_that_is_steered_sees_nothing_behind_a_ridge(tmp_path: Path) -> None:
    ridge = write_ridge(tmp_path, height_m=800)
    scan = {"kind": "electronic", "period_s": 1.0, "dwell_s": 0.001, "revisit_s": 1.0}
    sensor = radar(
        scan=scan, integration_s=0.001, power_w=5e5, azimuth_min_deg=-60.0, azimuth_max_deg=60.0,
        elevation_min_deg=-5.0, elevation_max_deg=40.0,
    )  # fmt: skip
    drones = [drone("behind", 5, 1.0, 4000.0), drone("above", 5, 10.0, 4000.0)]
    free, hidden = (
        flown(sensor, drones, tmp_path, **named) for named in ({}, {"elevation": [ridge]})
    )
    assert set(free.plots.drone.tolist()) >= {0, 1}
    assert set(hidden.plots.drone.tolist()) - {-1} == {1}
