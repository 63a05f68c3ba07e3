"""Plots of a sensor's feed beside the truth, each with the looks that it may be of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from plotfeed.feeds.report.expected_plots import TrueEchoes, TruePlots, compared
from plotfeed.feeds.report.noise_laws import with_rounding
from plotfeed.feeds.score.claimed_feed import ClaimedLooks, SensorFeed
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.scoring.plot_pairs import Candidates
from plotfeed.models.scoring.residuals import MeasuredQuantity
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.proto.measured_plots import NOT_TOLD, MeasuredPlots

QUANTITIES: Mapping[str, tuple[MeasuredQuantity, float]] = {
    "azimuth": (MeasuredQuantity("azimuth", "deg"), 8.0),
    "range": (MeasuredQuantity("range", "m"), 500.0),
    "bistatic range": (MeasuredQuantity("bistatic range", "m"), 1000.0),
    "elevation": (MeasuredQuantity("elevation", "deg"), 8.0),
}
"""What is checked, and how far off it is looked for at least; by what gates are displaced first."""
AT_ONCE = 500_000
"""Pairs of a plot and a look that are compared at once."""
COLUMNS = ("azimuth_deg", "range_m", "bistatic_range_m", "elevation_deg")
"""Of plots, that hold those."""


class ComparedPlots(NamedTuple):
    """Pairs of plots and looks of one sector, and how what was measured differs from the truth."""

    candidates: Candidates
    kurtosis: Floats
    names: Sequence[str]
    """Of the quantities that are measured."""


def compared_plots(feed: SensorFeed) -> ComparedPlots:
    """All pairs of the feed's plots and looks that are not far from each other."""
    parts = [_compare(feed, plot, look) for plot, look in _pairs(feed)]
    plot, look, error, variance, kurtosis = (
        np.concatenate(columns) if parts else np.zeros((0, len(QUANTITIES)))
        for columns in (zip(*parts, strict=True) if parts else [()] * 5)
    )
    known = np.isfinite(error) & np.isfinite(variance)
    if isinstance(feed.model, PassiveRadar):
        known[:, list(QUANTITIES).index("range")] = False  # it follows from the others
    measured: Bools = np.asarray(known.reshape(-1, len(QUANTITIES)).any(axis=0))
    is_known = known.any(axis=1)
    candidates = Candidates(
        plot=plot[is_known].astype(np.int64),
        look=look[is_known].astype(np.int64),
        error=np.where(known, error, np.nan)[is_known][:, measured],
        sigma=np.sqrt(np.maximum(variance, 1e-12))[is_known][:, measured],
    )
    return ComparedPlots(
        candidates,
        np.where(np.isfinite(kurtosis), kurtosis, 3.0)[is_known][:, measured],
        [name for name, there in zip(QUANTITIES, measured.tolist(), strict=True) if there],
    )


def _pairs(feed: SensorFeed) -> Iterator[tuple[Ints, Ints]]:
    """Plots and looks of one sector that are not far from each other, some at a time."""
    looks, plots = feed.looks, feed.plots
    first = np.searchsorted(looks.sector, feed.plot_sector, side="left")
    count = np.searchsorted(looks.sector, feed.plot_sector, side="right") - first
    ends = np.cumsum(count)
    start = 0
    while start < len(count):
        before = int(ends[start - 1]) if start else 0
        end = max(int(np.searchsorted(ends, before + AT_ONCE, side="right")), start + 1)
        n = count[start:end]
        plot = np.repeat(np.arange(start, end), n)
        within = np.arange(len(plot)) - np.repeat(np.cumsum(n) - n, n)
        look = np.repeat(first[start:end], n) + within
        kept = ~(np.abs(wrap_180(plots.azimuth_deg[plot] - looks.azimuth_deg[look])) > 90.0)
        kept &= (plots.channel[plot] == NOT_TOLD) | (plots.channel[plot] == looks.channel[look])
        yield plot[kept], look[kept]
        start = end


_Columns = tuple[Ints, Ints, Floats, Floats, Floats]


def _compare(feed: SensorFeed, plot: Ints, look: Ints) -> _Columns:
    """Errors and their claimed variances and kurtoses, by what was claimed in each sector."""
    n, names = len(plot), list(QUANTITIES)
    error, variance, kurtosis = (np.full((n, len(names)), np.nan) for _ in range(3))
    keys = feed.keys_of_sector[feed.plot_sector[plot]]
    categories = feed.plots.category[plot]
    for which, category in {*zip(keys.tolist(), categories.tolist(), strict=True)}:
        rows = np.flatnonzero((keys == which) & (categories == category))
        looks = feed.looks.rows(look[rows])
        found = compared(
            feed.believed[which],
            *_truth_of(looks),
            # One plot may be in many pairs, which is more rows than there are.
            MeasuredPlots.holding({n: c[plot[rows]] for n, c in vars(feed.plots).items()}),
            with_rounding,
            keeps_ends=True,
        )
        for k, name in enumerate(names):
            if name in found.errors:
                error[rows, k] = found.errors[name]
                variance[rows, k] = found.expected[name].variance
                kurtosis[rows, k] = found.expected[name].kurtosis
    return plot, look, error, variance, kurtosis


def near_an_end(feed: SensorFeed) -> Bools:
    """Looks of which noise decides whether there is a plot: near the ends of range, or a baseline.

    By what a plot without noise would be, with the errors that plots usually state.
    """
    near = np.zeros(len(feed.looks), np.bool_)
    keys = feed.keys_of_sector[feed.looks.sector]
    usual = {
        name: float(np.nanmedian(column))
        for name, column in vars(feed.plots).items()
        if name.startswith("sigma_") and np.isfinite(column).any()
    }
    for which in np.unique(keys).tolist():
        believed = feed.believed[which]
        if believed is None:
            continue
        rows = np.flatnonzero(keys == which)
        looks = feed.looks.rows(rows)
        place_m = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
        values = place_values(believed.model, [*QUANTITIES], place_m, looks.channel)
        exact = MeasuredPlots.of([{**usual, "channel": 0}] * len(rows)).but(
            channel=looks.channel,
            **dict(zip(COLUMNS, values.T, strict=True)),
        )
        found = compared(believed, *_truth_of(looks), exact)
        errors = np.stack([np.full(len(rows), np.nan), *found.errors.values()])
        near[rows] = ~np.isfinite(errors).any(axis=0)
        if isinstance(believed.model, PassiveRadar):  # along a baseline nothing can be placed
            near[rows] |= ~np.isfinite(found.expected["range"].variance)
    return near


def _truth_of(looks: ClaimedLooks) -> tuple[TrueEchoes, TruePlots]:
    """What was true of plots of those looks, one each."""
    n = len(looks)
    return (
        TrueEchoes(
            plot=np.arange(n),
            channel=np.full(n, -1),
            azimuth_deg=looks.azimuth_deg,
            elevation_deg=looks.elevation_deg,
            range_m=looks.range_m,
            weight=np.ones(n),
        ),
        TruePlots(
            t_utc_ns=looks.t_utc_ns,
            drones=np.ones(n, np.int64),
            range_rate_m_s=np.full(n, np.nan),
        ),
    )


def place_values(
    model: SensorModel | None, names: Sequence[str], place_enu_m: Floats, channel: Ints
) -> Floats:
    """Quantities of places by the sensor, (n, k)."""
    azimuth_deg, elevation_deg, range_m = enu_to_aer(place_enu_m)
    found = {"azimuth": azimuth_deg, "elevation": elevation_deg, "range": range_m}
    if "bistatic range" in names and isinstance(model, PassiveRadar):
        found["bistatic range"] = bistatic_range(place_enu_m, model.positions_enu_m[channel])
    return np.stack([found.get(name, np.full(len(range_m), np.nan)) for name in names], axis=1)


def value_difference(later: Floats, earlier: Floats, names: Sequence[str]) -> Floats:
    """Values less others, (n, k), azimuths within half a turn."""
    difference = later - earlier
    if "azimuth" in names:
        k = names.index("azimuth")
        difference[:, k] = wrap_180(difference[:, k])
    return difference
