"""Plots that are of no drone: of clutter, which stays in its place, and of side lobes.

A map of clutter says how often its cells have plots. The power of K-distributed clutter is
exponential about a texture, which is gamma distributed of an order v and of mean 1 from place to
place: fixed for a map, or new in each scan.

Echoes by side lobes are plots at the range of a target, in the direction in which the beam looks:
while it points elsewhere a strong target comes by its side lobes, and the radar takes what it hears
for something in the beam. Every beam of a scan looks by itself, and echoes fluctuate from one to
the next.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models import special
from plotfeed.models.accuracy import fold_over_zenith
from plotfeed.models.beam import Sector, beam_times_ns
from plotfeed.models.detection import cells_across, whole_cells
from plotfeed.models.effects.doppler import range_rate_m_s
from plotfeed.models.fluctuation import mean_over_signals
from plotfeed.models.frames import enu_to_aer, wrap_180, wrap_360
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.sensors.polar_radar import Hits, PolarRadar
from plotfeed.models.sensors.sensor_model import NO_PLOTS, Targets
from plotfeed.models.state import Bools, Floats, Ints, Plots

CLUTTER = "clutter"  # What its regions are called before their names, among drones and movers


@nan_without_warnings
def k_exceedance(threshold: ArrayLike, order: ArrayLike) -> Floats:
    """Probability that K-distributed clutter exceeds so many times its mean power.

    2/Gamma(v) (vT)^(v/2) K_v(2 sqrt(vT)), by logarithms and the scaled Bessel function.
    """
    v = as_floats(order)
    vt = v * as_floats(threshold)
    q = 2 * np.sqrt(vt)
    log = np.log(2.0) - special.gammaln(v) + v / 2 * np.log(vt) + np.log(special.kve(v, q)) - q
    return np.where(vt > 0, np.exp(log), 1.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Spikes:
    """A fixed threshold over the mean power of K-distributed clutter, and its textures.

    These are by cell, (n,), or None where each scan has its own.
    """

    threshold: float
    order: float
    texture: Floats | None

    def chance(self, n: int) -> Floats:
        """Probability that a resolution cell within each of n squares crosses the threshold."""
        if self.texture is None:
            return np.full(n, float(k_exceedance(self.threshold, self.order)))
        return np.exp(-self.threshold / np.maximum(self.texture, 1e-300))

    def over_threshold(self, square: Ints, rng: np.random.Generator) -> Floats:
        """Powers over the threshold of what crosses it in those squares; (n,)."""
        if self.texture is None:  # that of what crosses: generalised inverse Gaussian
            from scipy.stats import geninvgauss  # half a second, which no other scene pays

            scale = np.sqrt(self.threshold / self.order)
            b = 2 * np.sqrt(self.order * self.threshold)
            law = geninvgauss(self.order, b, scale=scale)
            texture = law.rvs(len(square), random_state=rng)
        else:
            texture = self.texture[square]
        excess: Floats = 1 + texture * rng.standard_exponential(len(square)) / self.threshold
        return excess


def inside(east_m: Floats, north_m: Floats, corners_m: Floats) -> Bools:
    """Whether places lie in a polygon (k, 2), by how often a line to the east leaves it; (...)."""
    found = np.zeros(np.shape(east_m), np.bool_)
    for (x0, y0), (x1, y1) in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        crosses = (y0 > north_m) != (y1 > north_m)
        if y0 != y1:
            found ^= crosses & (east_m < x0 + (north_m - y0) / (y1 - y0) * (x1 - x0))
    return found


@dataclass(frozen=True, eq=False, kw_only=True)
class ClutterMap:
    """Cells, squares east and north of their corner, up of the sensor; (n,) each.

    `rates` are mean plots in a scan. `whose` is the row in which the region stands among drones.
    """

    east_m: Floats
    north_m: Floats
    up_m: Floats
    side_m: float
    rates: Floats
    rate_m_s: float
    whose: int
    spikes: Spikes | None = None

    def plots(self, model: PolarRadar, sector: Sector, rng: np.random.Generator) -> Plots:
        """The plots of a scan: in each cell a Poisson number, anywhere in it, with their errors.

        Whose they are is all that is true of them. Their strength is that of noise over the
        threshold, what is left of filtered clutter, or that of spikes.
        """
        n = int(rng.poisson(self.rates.sum())) if len(self.rates) else 0
        if not n:
            return NO_PLOTS
        cell = rng.choice(len(self.rates), n, p=self.rates / self.rates.sum())
        offset_m = rng.random((2, n)) * self.side_m
        place = [self.east_m[cell] + offset_m[0], self.north_m[cell] + offset_m[1], self.up_m[cell]]
        azimuth_deg, elevation_deg, range_m = enu_to_aer(np.stack(place, axis=-1))
        covered = model.in_cover(range_m, azimuth_deg, elevation_deg)
        azimuth_deg, elevation_deg, range_m = (
            column[covered] for column in (azimuth_deg, elevation_deg, range_m)
        )
        if not len(range_m):
            return NO_PLOTS
        plots = model.false_plots(beam_times_ns(sector, azimuth_deg), azimuth_deg, rng)
        if self.spikes is not None:
            plots = _as_strong(plots, model, self.spikes.over_threshold(cell[covered], rng), rng)
        errors = rng.standard_normal((4, len(plots)))
        read_deg, read_elevation_deg = fold_over_zenith(
            azimuth_deg + errors[1] * plots.sigma_azimuth_deg,
            elevation_deg + errors[2] * np.nan_to_num(plots.sigma_elevation_deg),
        )
        plots = plots.but(
            drone=np.full(len(plots), self.whose),
            range_m=range_m + errors[0] * plots.sigma_range_m,
            azimuth_deg=read_deg,
        )
        if model.measures_elevation:
            plots = plots.but(elevation_deg=read_elevation_deg)
        if model.doppler is not None:
            plots = plots.but(range_rate_m_s=self.rate_m_s * errors[3])
        return plots


def _as_strong(plots: Plots, model: PolarRadar, over: Floats, rng: np.random.Generator) -> Plots:
    """Plots of so many times the threshold, with all that follows from their strength."""
    n = len(plots)
    _, threshold = model.draw_detected(np.zeros((n, model.n_signals)), rng)
    snr = threshold * over
    sigmas = model.sigmas_at(snr, np.zeros(n, np.int64))
    changed = {name: sigma for name, sigma in sigmas.items() if plots.measures(name)}
    if model.measures_run_length:
        changed["run_length_deg"] = model.azimuth_beamwidth_deg * np.sqrt(np.log2(over))
    amplitude_dbm = model.noise_dbm + 10 * np.log10(snr)
    return plots.but(snr=snr, amplitude_dbm=amplitude_dbm, **changed)


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
    snrs, order = away.look_strengths(targets, near)
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
