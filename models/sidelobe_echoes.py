"""Echoes by side lobes: plots at the range of a target, in the direction in which the beam looks.

While the beam points elsewhere a strong target comes by its side lobes, and the radar takes what it
hears for something in the beam. Every beam of a scan looks by itself, and echoes fluctuate from one
to the next.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plotfeed.models.beam import Sector, beam_times_ns
from plotfeed.models.detection import cells_across, whole_cells
from plotfeed.models.effects.doppler import range_rate_m_s
from plotfeed.models.frames import enu_to_aer, wrap_180, wrap_360
from plotfeed.models.sensors.polar_radar import Hits, PolarRadar, mean_over_signals
from plotfeed.models.sensors.sensor_model import NO_PLOTS, Targets
from plotfeed.models.state import Floats, Ints, Plots

# What such plots are of, before the name of their sensor, among drones and movers.
SIDELOBE = "sidelobe"


def sidelobe_plots(
    radar: PolarRadar, targets: Targets, sector: Sector, whose: int, rng: np.random.Generator
) -> Plots:
    """Plots of a sector of targets within range, as they are at its end, by side lobes.

    Of each a binomial number over the beams of the sector, anywhere in it in azimuth but within a
    beamwidth of the target, where the beam itself meets it; in elevation anywhere in cover.
    `whose` is the row in which they stand among drones: that is all that is true of them.
    """
    away = _turned_away(radar, sector)
    azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
    near = np.flatnonzero((range_m >= radar.range_min_m) & (range_m <= radar.range_max_m))
    snrs, order = away.look_snrs(targets, near), away.orders(targets, near)
    if targets.strengths is not None:
        of_looks = targets.drone[near], targets.t_utc_ns[near]
        snrs, order = targets.strengths.applied(snrs, order, *of_looks)
    pd, rate_m_s = np.nan_to_num(away.pd(snrs, order)) * away.pd_factor, None
    if away.doppler is not None and targets.velocity_enu_m_s is not None:
        place_enu_m = targets.true_position_enu_m[near]
        rate_m_s = range_rate_m_s(place_enu_m, targets.velocity_enu_m_s[near])
        pd = pd * away.doppler.share_passed(rate_m_s, np.zeros(len(near), np.int64))
    row, beam_deg = _detected(radar, sector, np.asarray(pd), rng)
    in_the_beam = np.abs(wrap_180(beam_deg - azimuth_deg[near[row]])) < radar.azimuth_beamwidth_deg
    row, beam_deg = row[~in_the_beam], beam_deg[~in_the_beam]
    if not len(row):
        return NO_PLOTS
    echoes = targets.looks(
        near[row],
        (azimuth_deg, elevation_deg, range_m),
        snr=mean_over_signals(snrs[row]),
        pd=pd[row],
        detected=np.ones(len(row), np.bool_),
    ).but(
        t_utc_ns=beam_times_ns(sector, beam_deg),
        azimuth_deg=beam_deg,
        elevation_deg=rng.uniform(radar.elevation_min_deg, radar.elevation_max_deg, len(row)),
    )
    columns = {} if rate_m_s is None else {"range_rate_m_s": rate_m_s[row]}
    of_rows = None if order is None else order[row]
    hits = Hits(echoes, snrs[row], columns, rng, of_rows)
    plots = away.measured(hits, targets)
    return plots.but(drone=np.full(len(plots), whose)).in_order_of_time()


def _turned_away(radar: PolarRadar, sector: Sector) -> PolarRadar:
    """The radar for targets that its beam does not point at; what stares sends everywhere."""
    effects, intervals = radar.echo_effects, radar.intervals
    if effects is None or effects.antenna is None:
        return radar
    antenna = effects.antenna.turned_away(transmitter_too=not sector.stares)
    if intervals is not None:
        intervals = replace(intervals, beam=None)
    return replace(radar, echo_effects=replace(effects, antenna=antenna), intervals=intervals)


def _detected(
    radar: PolarRadar, sector: Sector, pd: Floats, rng: np.random.Generator
) -> tuple[Ints, Floats]:
    """Rows of what is detected in the beams of a sector, and where the beam looks."""
    cover = radar.azimuth_cover
    beams = cells_across(cover.span_deg, radar.azimuth_beamwidth_deg)
    row, azimuth_deg = [np.zeros(0, np.int64)], [np.zeros(0)]
    for start, end in cover.shares_in(sector):
        whole, share = whole_cells(beams * (end - start), 1.0)
        n = rng.binomial(whole, pd * share)
        row.append(np.repeat(np.arange(len(pd)), n))
        azimuth_deg.append(cover.min_deg + rng.uniform(start, end, int(n.sum())) * cover.span_deg)
    return np.concatenate(row), wrap_360(np.concatenate(azimuth_deg))
