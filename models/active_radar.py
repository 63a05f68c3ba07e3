"""The quasi-monostatic active radar: section 3.1.1 of the paper, equations 1 to 15 in right form.

Thermal noise alone; a target that fluctuates from scan to scan (Swerling 1); a cell-averaging CFAR
detector; measurement errors that follow the signal-to-noise ratio of the very detection.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plotfeed.models import accuracy, detection, false_alarms, propagation
from plotfeed.models.constants import C_M_S
from plotfeed.models.frames import wrap_360
from plotfeed.models.scan import Sector, beam_times_ns
from plotfeed.models.state import FALSE_ALARM, Bools, Floats, Ints, Looks, Plots


@dataclass(frozen=True, kw_only=True)
class ActiveRadar:
    """What the equations need. Beamwidths are those of the receive beam, at 3 dB."""

    power_w: float
    frequency_hz: float
    gain_tx_dbi: float
    gain_rx_dbi: float
    integration_s: float
    loss_db: float
    noise_figure_db: float
    pfa: float
    n_reference: int
    range_resolution_m: float
    range_min_m: float
    range_max_m: float
    azimuth_beamwidth_deg: float
    elevation_beamwidth_deg: float
    azimuth_min_deg: float
    azimuth_max_deg: float
    elevation_min_deg: float
    elevation_max_deg: float
    doppler_cells: int
    range_floor_m: float
    azimuth_floor_deg: float
    elevation_floor_deg: float
    measures_elevation: bool

    @property
    def azimuth_span_deg(self) -> float:
        """Width of the azimuth cover, at most the full circle."""
        return min(self.azimuth_max_deg - self.azimuth_min_deg, 360.0)

    @cached_property
    def resolution_cells(self) -> int:
        """Range cells x azimuth beams x elevation beams x Doppler cells (eq 9, right form)."""
        range_cells = round((self.range_max_m - self.range_min_m) / self.range_resolution_m)
        azimuth_beams = round(self.azimuth_span_deg / self.azimuth_beamwidth_deg)
        elevation_span_deg = self.elevation_max_deg - self.elevation_min_deg
        elevation_beams = round(elevation_span_deg / self.elevation_beamwidth_deg)
        return (
            max(range_cells, 1) * max(azimuth_beams, 1) * max(elevation_beams, 1)
        ) * self.doppler_cells

    @cached_property
    def noise_dbm(self) -> float:
        """Noise power in the matched filter's bandwidth, 1/integration time (eq 5)."""
        density_w_hz = propagation.noise_density_w_hz(self.noise_figure_db)
        return float(10 * np.log10(density_w_hz / self.integration_s) + 30)


def mean_snr(radar: ActiveRadar, range_m: Floats, rcs_m2: Floats) -> Floats:
    """Signal-to-noise ratio before fluctuation, linear (eq 1, with one range for both ways)."""
    return propagation.radar_snr(
        radar.power_w,
        radar.gain_tx_dbi,
        radar.gain_rx_dbi,
        C_M_S / radar.frequency_hz,
        rcs_m2,
        radar.integration_s,
        range_m,
        range_m,
        radar.loss_db,
        radar.noise_figure_db,
    )


def in_cover(
    radar: ActiveRadar, range_m: Floats, azimuth_deg: Floats, elevation_deg: Floats
) -> Bools:
    """Beyond the blind range and within cover; a target with an undefined angle is not."""
    return (
        (range_m >= radar.range_min_m)
        & (range_m > 0)
        & (range_m <= radar.range_max_m)
        & (wrap_360(azimuth_deg - radar.azimuth_min_deg) <= radar.azimuth_span_deg)
        & (elevation_deg >= radar.elevation_min_deg)
        & (elevation_deg <= radar.elevation_max_deg)
    )


def observe(
    radar: ActiveRadar,
    *,
    drone: Ints,
    t_utc_ns: Ints,
    range_m: Floats,
    azimuth_deg: Floats,
    elevation_deg: Floats,
    rcs_m2: Floats,
    rng: np.random.Generator,
) -> tuple[Looks, Plots]:
    """One look at each target, given its true geometry at the time its beam is there; all (n,).

    Returns the looks, of the targets within cover, and the plots of those detected. Heights are
    left NaN: they take the sensor's place on Earth.
    """
    covered = in_cover(radar, range_m, azimuth_deg, elevation_deg)
    snr = mean_snr(radar, range_m[covered], rcs_m2[covered])
    pd = detection.pd_cfar_swerling1(snr, radar.pfa, radar.n_reference)  # eqs 6, 7
    looks = Looks(
        drone=drone[covered],
        t_utc_ns=t_utc_ns[covered],
        range_m=range_m[covered],
        azimuth_deg=azimuth_deg[covered],
        elevation_deg=elevation_deg[covered],
        snr=snr,
        pd=pd,
        detected=detection.draw_hits(pd, rng),  # eq 8
    )
    return looks, _measure(radar, looks.rows(looks.detected), rng)


def _measure(radar: ActiveRadar, hits: Looks, rng: np.random.Generator) -> Plots:
    """Plots of the targets that were detected: true geometry plus the errors of eqs 13 to 15."""
    snr, threshold = detection.draw_detected_snr_swerling1(
        hits.snr, radar.pfa, radar.n_reference, rng
    )
    sigma_range_m, sigma_azimuth_deg, sigma_elevation_deg = sigmas(radar, snr)
    errors = rng.standard_normal((3, len(hits)))
    azimuth_deg, elevation_deg = accuracy.fold_over_zenith(
        hits.azimuth_deg + errors[1] * sigma_azimuth_deg,
        hits.elevation_deg + errors[2] * sigma_elevation_deg,
    )
    plots = _plots(
        radar,
        t_utc_ns=hits.t_utc_ns,
        range_m=hits.range_m + errors[0] * sigma_range_m,
        azimuth_deg=azimuth_deg,
        elevation_deg=elevation_deg,
        snr=snr,
        threshold=threshold,
        drone=hits.drone,
        true_range_m=hits.range_m,
        true_azimuth_deg=hits.azimuth_deg,
        true_elevation_deg=hits.elevation_deg,
    )
    inside = (plots.range_m >= radar.range_min_m) & (plots.range_m <= radar.range_max_m)
    return plots.rows(inside & (plots.range_m > 0))


def draw_false_alarms(radar: ActiveRadar, sector: Sector, rng: np.random.Generator) -> Plots:
    """The false alarms of one sector: binomial over its resolution cells, uniform in them.

    Uniform in range, azimuth and elevation (eqs 9 to 12; elevation is drawn, not height).
    """
    pieces = _covered_pieces(radar, sector)
    counts = [
        false_alarms.draw_count(
            false_alarms.cells_between(radar.resolution_cells, *piece), radar.pfa, rng
        )
        for piece in pieces
    ]
    n = sum(counts)
    share_of_cover = np.concatenate(
        [false_alarms.draw_uniform(*piece, k, rng) for piece, k in zip(pieces, counts, strict=True)]
        or [np.zeros(0)]
    )
    azimuth_deg = wrap_360(radar.azimuth_min_deg + share_of_cover * radar.azimuth_span_deg)
    snr, threshold = detection.draw_detected_snr_swerling1(
        np.zeros(n), radar.pfa, radar.n_reference, rng
    )
    undefined = np.full(n, np.nan)
    return _plots(
        radar,
        t_utc_ns=beam_times_ns(sector, azimuth_deg),
        range_m=false_alarms.draw_uniform(radar.range_min_m, radar.range_max_m, n, rng),
        azimuth_deg=azimuth_deg,
        elevation_deg=false_alarms.draw_uniform(
            radar.elevation_min_deg, radar.elevation_max_deg, n, rng
        ),
        snr=snr,
        threshold=threshold,
        drone=np.full(n, FALSE_ALARM, np.int64),
        true_range_m=undefined,
        true_azimuth_deg=undefined,
        true_elevation_deg=undefined,
    )


def sigmas(radar: ActiveRadar, snr: Floats) -> tuple[Floats, Floats, Floats]:
    """Standard deviations of range, azimuth and elevation at that signal-to-noise ratio."""
    return (
        accuracy.with_floor(
            accuracy.sigma_range_m(snr, radar.range_resolution_m), radar.range_floor_m
        ),
        accuracy.with_floor(
            accuracy.sigma_angle_deg(snr, radar.azimuth_beamwidth_deg), radar.azimuth_floor_deg
        ),
        accuracy.with_floor(
            accuracy.sigma_angle_deg(snr, radar.elevation_beamwidth_deg), radar.elevation_floor_deg
        ),
    )


def _covered_pieces(radar: ActiveRadar, sector: Sector) -> list[tuple[float, float]]:
    """The parts of the azimuth cover that lie in a sector, as shares of the cover: 0, 1 or 2."""
    start_deg = float(wrap_360(sector.start_deg - radar.azimuth_min_deg))
    end_deg = start_deg + sector.end_deg - sector.start_deg
    span_deg = radar.azimuth_span_deg
    pieces = []
    for turn_deg in (0.0, 360.0):
        low_deg, high_deg = max(start_deg - turn_deg, 0.0), min(end_deg - turn_deg, span_deg)
        if low_deg < high_deg:
            pieces.append((low_deg / span_deg, high_deg / span_deg))
    return pieces


def _plots(
    radar: ActiveRadar,
    *,
    t_utc_ns: Ints,
    range_m: Floats,
    azimuth_deg: Floats,
    elevation_deg: Floats,
    snr: Floats,
    threshold: Floats,
    drone: Ints,
    true_range_m: Floats,
    true_azimuth_deg: Floats,
    true_elevation_deg: Floats,
) -> Plots:
    """What follows from a detection's power alone: amplitude, run length and the stated sigmas.

    The run length is the width over which a Gaussian receive beam keeps the echo above the
    threshold: the transmit beam is taken as the wider one.
    """
    sigma_range_m, sigma_azimuth_deg, sigma_elevation_deg = sigmas(radar, snr)
    unmeasured = np.full(len(snr), np.nan)
    return Plots(
        t_utc_ns=t_utc_ns,
        range_m=range_m,
        azimuth_deg=azimuth_deg,
        elevation_deg=elevation_deg if radar.measures_elevation else unmeasured,
        height_m=unmeasured,
        snr=snr,
        amplitude_dbm=radar.noise_dbm + 10 * np.log10(snr),
        run_length_deg=radar.azimuth_beamwidth_deg * np.sqrt(np.log2(snr / threshold)),
        sigma_range_m=sigma_range_m,
        sigma_azimuth_deg=sigma_azimuth_deg,
        sigma_elevation_deg=sigma_elevation_deg if radar.measures_elevation else unmeasured,
        drone=drone,
        true_range_m=true_range_m,
        true_azimuth_deg=true_azimuth_deg,
        true_elevation_deg=true_elevation_deg,
    )
