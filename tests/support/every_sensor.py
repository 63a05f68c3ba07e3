"""A sensor of each kind that stares, and sees a loud drone at a few kilometres."""

from __future__ import annotations

from typing import Any

from support.road import radar, staring, waypoint

POLAR = {
    "frequency_hz": 15e9, "gain_tx_dbi": 30.0, "gain_rx_dbi": 30.0, "integration_s": 0.06,
    "range_resolution_m": 20.0, "range_max_m": 10_000.0, "azimuth_beamwidth_deg": 3.0,
    "elevation_beamwidth_deg": 10.0, "elevation_min_deg": -10.0, "elevation_max_deg": 60.0,
}  # fmt: skip
PLACE = {"east_m": 9.0, "north_m": 0.0, "above_site_m": 0.0}
SENSORS: dict[str, dict[str, Any]] = {
    "radar": radar(power_w=5e4),
    "mimo": POLAR | {
        "id": "radar", "type": "mimo_radar", "scan": staring(),
        "transmitters": [{"power_w": 2e4, **PLACE}],
    },
    "passive": {
        "id": "radar", "type": "passive_radar", "scan": staring(), "gain_rx_dbi": 15.0,
        "transmitters": [{"id": "tv", "erp_w": 1e5, "frequency_hz": 600e6, "bandwidth_hz": 7.61e6,
                          "place": waypoint(90.0, 1.0, 9_000.0)}],
        "azimuth_beamwidth_deg": 2.0, "integration_s": 0.3, "external_noise_db": -4.45,
        "range_max_m": 10_000.0, "cancellation_db": -150.0,
    },
    "rf": {
        "id": "radar", "type": "rf", "scan": staring(), "frequency_min_hz": 2.4e9,
        "frequency_max_hz": 2.5e9, "channel_bandwidth_hz": 1e6, "integration_s": 1e-3,
        "range_max_m": 9000.0, "baseline_m": 0.2,
    },
    "array": {
        "id": "radar", "type": "acoustic", "scan": staring(), "range_max_m": 9000.0,
        "azimuth_beamwidth_deg": 20.0, "elevation_beamwidth_deg": 20.0, "sensitivity_db": 5.0,
        "noise_db": 0.0, "absorption_db_per_km": 1.0, "height_above_ground_m": 1.5,
    },
    "camera": {
        "id": "radar", "type": "camera", "scan": staring(0.1), "range_max_m": 9000.0,
        "horizontal_fov_deg": 360.0, "vertical_fov_deg": 40.0, "pixels_across": 400_000,
        "pixels_down": 40_000,
    },
    "gate": {"id": "radar", "type": "range_gate", "scan": staring(), "range_max_m": 9000.0,
             "sigma_m": 3.0},
}  # fmt: skip
