"""Clutter that stays in its place: a map of how often cells have plots, and the plots of a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.accuracy import fold_over_zenith
from plotfeed.models.beam import Sector, beam_times_ns
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.sensor_model import NO_PLOTS
from plotfeed.models.state import Bools, Floats, Plots

CLUTTER = "clutter"
"""What its regions are called before their names, among drones and movers."""


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

    def plots(self, model: PolarRadar, sector: Sector, rng: np.random.Generator) -> Plots:
        """The plots of a scan: in each cell a Poisson number, anywhere in it, with their errors.

        Whose they are is all that is true of them. Their strength is that of noise over the
        threshold: what is left of filtered clutter.
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
