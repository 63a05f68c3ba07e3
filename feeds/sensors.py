"""From the scene's sensors to the models' parameters."""

from __future__ import annotations

from plotfeed.feeds.scene import ActiveRadarSensor
from plotfeed.models.active_radar import ActiveRadar
from plotfeed.models.cover import AzimuthCover
from plotfeed.models.propagation import beam_gain_dbi


def active_radar(sensor: ActiveRadarSensor) -> ActiveRadar:
    """The model's parameters; a receive gain that is not given follows from the beamwidths."""
    gain_rx_dbi = sensor.gain_rx_dbi
    if gain_rx_dbi is None:
        gain_rx_dbi = float(
            beam_gain_dbi(
                sensor.azimuth_beamwidth_deg,
                sensor.elevation_beamwidth_deg,
                sensor.antenna_efficiency,
            )
        )
    return ActiveRadar(
        power_w=sensor.power_w,
        frequency_hz=sensor.frequency_hz,
        gain_tx_dbi=sensor.gain_tx_dbi,
        gain_rx_dbi=gain_rx_dbi,
        integration_s=sensor.integration_s,
        loss_db=sensor.loss_db,
        noise_figure_db=sensor.noise_figure_db,
        pfa=sensor.pfa,
        n_reference=sensor.n_reference,
        range_resolution_m=sensor.range_resolution_m,
        range_min_m=sensor.range_min_m,
        range_max_m=sensor.range_max_m,
        azimuth_beamwidth_deg=sensor.azimuth_beamwidth_deg,
        elevation_beamwidth_deg=sensor.elevation_beamwidth_deg,
        azimuth_cover=AzimuthCover(sensor.azimuth_min_deg, sensor.azimuth_max_deg),
        elevation_min_deg=sensor.elevation_min_deg,
        elevation_max_deg=sensor.elevation_max_deg,
        doppler_cells=sensor.doppler_cells,
        range_floor_m=sensor.range_floor_m,
        azimuth_floor_deg=sensor.azimuth_floor_deg,
        elevation_floor_deg=sensor.elevation_floor_deg,
        measures_elevation=sensor.measures_elevation,
    )
