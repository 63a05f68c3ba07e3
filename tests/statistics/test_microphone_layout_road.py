"""Microphone layouts through the whole road: errors in the plots are those that the geometry gives.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.significance import assert_standard_normal, assert_sum

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.frames import wrap_180
from plotfeed.testing import START_NS, held, scene, staring

AZIMUTHS_DEG = np.arange(7.0, 360.0, 15.0)
SPACING_M, MICROPHONES, FREQUENCY_HZ = 0.5, 8, 200.0


def microphones(shape: str, **changes: Any) -> dict[str, Any]:
    usual = {
        "id": "mic", "type": "acoustic", "scan": staring(), "noise_db": 0.0,
        "sensitivity_db": 0.0, "microphones": MICROPHONES, "absorption_db_per_km": 1.0,
        "range_max_m": 1000.0, "azimuth_beamwidth_deg": 40.0, "azimuth_floor_deg": 0.0,
        "elevation_floor_deg": 0.0, "frequency_hz": FREQUENCY_HZ,
        "layout": {"shape": shape, "spacing_m": SPACING_M},
    }  # fmt: skip
    return usual | changes


def heard(sensor: dict[str, Any], elevation_deg: float, scans: int = 60) -> SimulatedSensor:
    drones = [
        held(f"d{i}", azimuth_deg, elevation_deg, 150.0, sound_power_db=90.0)
        for i, azimuth_deg in enumerate(AZIMUTHS_DEG)
    ]
    return simulate(scene([sensor], drones, seed=71), scans, start_utc_ns=START_NS)["mic"]


def test_a_circle_errs_alike_all_round_by_the_bound() -> None:
    """sigma is wavelength / (2 pi r cos(elevation) sqrt(S)) for a radius r."""
    plots = heard(microphones("circle", elevation_beamwidth_deg=30.0), 35.0).plots
    assert len(plots) > 1000
    radius_m = SPACING_M / (2 * np.sin(np.pi / MICROPHONES))
    speed_m_s = 331.3 * np.sqrt(1 + 20 / 273.15)
    w = speed_m_s / FREQUENCY_HZ / (2 * np.pi * radius_m * np.sqrt(plots.snr))
    sigma_deg = np.degrees(w) / np.cos(np.radians(35.0))
    errors_deg = wrap_180(plots.azimuth_deg - plots.true_azimuth_deg)
    assert_standard_normal(errors_deg / sigma_deg, "azimuths")
    np.testing.assert_allclose(plots.sigma_azimuth_deg, sigma_deg, rtol=0.06)
    lifted = (plots.elevation_deg - plots.true_elevation_deg) / np.degrees(w)
    assert np.std(lifted) * np.sin(np.radians(35.0)) == pytest.approx(1.0, abs=0.08)


def test_half_of_a_lines_plots_are_on_the_wrong_side() -> None:
    plots = heard(microphones("line"), 0.5).plots
    from_axis_deg = wrap_180(plots.true_azimuth_deg)
    off_ends = np.abs(np.abs(from_axis_deg) - 90) < 60
    plots = plots.rows(off_ends)
    right = np.sign(wrap_180(plots.azimuth_deg)) == np.sign(wrap_180(plots.true_azimuth_deg))
    assert_sum(float(right.sum()), len(right) / 2, len(right) / 4, "right sides")
    mirrored_deg = np.where(right, plots.azimuth_deg, -plots.azimuth_deg)
    errors = wrap_180(mirrored_deg - plots.true_azimuth_deg) / plots.sigma_azimuth_deg
    assert np.std(errors) == pytest.approx(1.0, abs=0.06)


def test_a_line_that_covers_one_side_is_right() -> None:
    one_side = {"azimuth_min_deg": 5.0, "azimuth_max_deg": 175.0}
    plots = heard(microphones("line", **one_side), 0.5).plots
    plots = plots.rows(np.abs(plots.true_azimuth_deg - 90) < 60)
    errors_deg = wrap_180(plots.azimuth_deg - plots.true_azimuth_deg)
    assert np.abs(errors_deg / plots.sigma_azimuth_deg).max() < 6


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"microphones": 2}, "sensor[0].microphones of 'mic': a layout has at least 3"),
        (
            {"layout": {"shape": "rectangle", "spacing_m": 0.5}, "microphones": 9},
            "sensor[0].microphones of 'mic': a rectangle has an even number",
        ),
        (
            {"elevation_beamwidth_deg": 20.0},
            "elevation_beamwidth_deg of 'mic': a line of microphones tells no elevations",
        ),
    ],
)
def test_a_layout_that_cannot_be_is_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene([microphones("line") | keys], seed=1)
    assert message in str(caught.value)


def test_check_warns_of_sides_and_of_short_waves() -> None:
    made = scene([microphones("line", frequency_hz=1000.0)], seed=1)
    found = " ".join(made.sensor[0].warnings(made.scene.site))
    assert "cannot tell its sides apart" in found
    assert "more than half a wavelength at 1000 Hz" in found
    covered = microphones("line", azimuth_min_deg=0.0, azimuth_max_deg=180.0)
    made = scene([covered], seed=1)
    assert "sides" not in " ".join(made.sensor[0].warnings(made.scene.site))
