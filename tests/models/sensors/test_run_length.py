"""The width over which an echo is above its threshold as the beam goes over it."""

from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.sensors.active_radar import ActiveRadar


@pytest.mark.parametrize("beamwidth_deg", [0.8, 3.0])
@pytest.mark.parametrize("over_db", [0.1, 3.0, 12.0, 30.0])
def test_a_run_is_as_long_as_a_swept_gaussian_beam_keeps_the_echo(
    beamwidth_deg: float, over_db: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against the beam moved over a target step by step: at half its width off, it has half."""
    threshold, snr = 20.0, 20.0 * 10 ** (over_db / 10)
    drawn = np.array([snr]), np.array([threshold])
    monkeypatch.setattr(ActiveRadar, "draw_detected", lambda *_: drawn)
    (plotted,) = (
        radar(beamwidth_deg)
        .false_plots(np.zeros(1, np.int64), np.zeros(1), np.random.default_rng(1))
        .run_length_deg
    )
    off_deg, step_deg = np.linspace(-6 * beamwidth_deg, 6 * beamwidth_deg, 400_001, retstep=True)
    kept = snr * 0.5 ** ((off_deg / (beamwidth_deg / 2)) ** 2) >= threshold
    assert plotted == pytest.approx(kept.sum() * step_deg, abs=2 * step_deg)


def radar(beamwidth_deg: float) -> ActiveRadar:
    return ActiveRadar(
        power_w=500.0,
        gain_tx_dbi=20.0,
        gain_rx_dbi=35.4,
        frequency_hz=10e9,
        integration_s=0.06,
        loss_db=4.0,
        noise_figure_db=5.0,
        pfa=1e-6,
        n_reference=16,
        range_resolution_m=10.0,
        azimuth_beamwidth_deg=beamwidth_deg,
        elevation_beamwidth_deg=6.0,
        doppler_cells=1,
        range_floor_m=0.0,
        azimuth_floor_deg=0.0,
        elevation_floor_deg=0.0,
        measures_elevation=True,
        range_min_m=50.0,
        range_max_m=10_000.0,
        azimuth_cover=AzimuthCover(-180.0, 180.0),
        elevation_min_deg=0.0,
        elevation_max_deg=30.0,
    )
