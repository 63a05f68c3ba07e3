"""Checks of one sensor's feed: plots paired with looks by place, and held against claims."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from plotfeed.feeds.report.expected_plots import TIME_OF_SENDING, TrueEchoes, TruePlots, compared
from plotfeed.feeds.report.noise_laws import with_rounding
from plotfeed.feeds.score.claimed_feed import ClaimedLooks, SensorFeed
from plotfeed.models.frames import LocalFrame, aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.scoring.flight_paths import FlightPath
from plotfeed.models.scoring.plot_pairs import Candidates, plot_pairs
from plotfeed.models.scoring.residuals import (
    FalseInGates,
    LookOdds,
    MeasuredQuantity,
    ResidualCheck,
    Residuals,
    clutter_check,
    detection_check,
    error_checks,
    not_judged,
)
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.proto.measured_plots import NOT_TOLD, MeasuredPlots
from plotfeed.proto.utc import NS

QUANTITIES: Mapping[str, tuple[MeasuredQuantity, float]] = {
    "azimuth": (MeasuredQuantity("azimuth", "deg"), 8.0),
    "range": (MeasuredQuantity("range", "m"), 500.0),
    "bistatic range": (MeasuredQuantity("bistatic range", "m"), 1000.0),
    "elevation": (MeasuredQuantity("elevation", "deg"), 8.0),
}
"""What is checked, and how far off it is looked for at least; by what gates are displaced first."""
AT_ONCE = 500_000
"""Pairs of a plot and a look that are compared at once."""
STEP_S = 0.25
"""Either way, for the rates of what is measured."""
LONGEST_GAP = 5.0
"""Usual times between looks at a target after which its way between them is not known."""
ANYWHERE = LocalFrame(0.0, 0.0, 0.0)
"""In place of a sensor's site that nobody tells: only what is relative to it counts."""
COLUMNS = ("azimuth_deg", "range_m", "bistatic_range_m", "elevation_deg")
"""Of plots, that hold those."""


def feed_checks(feed: SensorFeed) -> list[ResidualCheck]:
    """All that a sensor's feed claims, checked; with why what cannot be checked is not."""
    pairs = _compared(feed)
    if not pairs.names:
        return _nothing_measured(feed)
    quantities = [QUANTITIES[name][0] for name in pairs.names]
    reach = np.array([QUANTITIES[name][1] for name in pairs.names])
    found = plot_pairs(pairs.candidates, reach, len(feed.looks))
    plot, look = pairs.candidates.plot[found.chosen], pairs.candidates.look[found.chosen]
    false_hits = found.false_per_look * float((1 - feed.looks.pd).sum())
    checks = error_checks(
        _residuals(feed, pairs, found.chosen),
        quantities,
        FalseInGates(false_hits, found.gate),
        "its times are those of sending" if _tells_sending(feed.plots) else "",
    )
    hit = np.zeros(len(feed.looks), np.bool_)
    hit[look] = True
    counts = feed.looks.counts & ~_near_an_end(feed)
    odds = LookOdds(
        target=feed.looks.target,
        t_s=feed.looks.t_utc_ns / NS,
        pd=feed.looks.pd,
        hit=hit,
    ).rows(counts)
    checks.append(detection_check(odds, found.false_per_look))
    checks.append(_clutter(feed, len(feed.plots) - len(plot), false_hits))
    return checks


def _nothing_measured(feed: SensorFeed) -> list[ResidualCheck]:
    why = "no plots near targets" if len(feed.plots) else "no plots came"
    if len(feed.plots) and not (
        np.isfinite(feed.plots.azimuth_deg).any() or np.isfinite(feed.plots.range_m).any()
    ):
        why = "it tells neither directions nor ranges"
    return [
        *(not_judged(q.name, q.unit, 0.0, why) for q, _ in QUANTITIES.values()),
        not_judged("time", "s", 0.0, why),
        _detections_without_plots(feed) if not len(feed.plots) else not_judged("Pd", "", 1.0, why),
        _clutter(feed, 0, 0.0) if not len(feed.plots) else not_judged("false alarms", "", 0.0, why),
    ]


def _detections_without_plots(feed: SensorFeed) -> ResidualCheck:
    looks = feed.looks.rows(feed.looks.counts)
    missed = np.zeros(len(looks), np.bool_)
    odds = LookOdds(target=looks.target, t_s=looks.t_utc_ns / NS, pd=looks.pd, hit=missed)
    return detection_check(odds, 0.0)


def _clutter(feed: SensorFeed, left: int, false_hits: float) -> ResidualCheck:
    why, expected = feed.why_no_clutter, 0.0
    if not why:
        per_scan = [
            np.nan if each is None else each.false_alarms_per_scan for each in feed.believed
        ]
        sectors = max(len(feed.keys_of_sector), 1)
        expected = float(np.array(per_scan)[feed.keys_of_sector].sum()) * feed.scans / sectors
        if np.isnan(expected):
            why = "it is not known how many are claimed"
    if why:
        return not_judged("false alarms", "a scan", float("nan"), why, left)
    return clutter_check(left, expected, feed.scans, false_hits)


def _tells_sending(plots: MeasuredPlots) -> bool:
    return bool((plots.category == TIME_OF_SENDING).any())


class _Compared(NamedTuple):
    """Pairs of plots and looks of one sector, and how what was measured differs from the truth."""

    candidates: Candidates
    kurtosis: Floats
    names: Sequence[str]
    """Of the quantities that are measured."""


def _compared(feed: SensorFeed) -> _Compared:
    parts = [_compare(feed, plot, look) for plot, look in _pairs(feed)]
    plot, look, error, variance, kurtosis = (
        np.concatenate(columns) if parts else np.zeros((0, len(QUANTITIES)))
        for columns in (zip(*parts, strict=True) if parts else [()] * 5)
    )
    known = np.isfinite(error) & np.isfinite(variance)
    if isinstance(_a_model(feed), PassiveRadar):
        known[:, list(QUANTITIES).index("range")] = False  # it follows from the others
    measured: Bools = np.asarray(known.reshape(-1, len(QUANTITIES)).any(axis=0))
    is_known = known.any(axis=1)
    candidates = Candidates(
        plot=plot[is_known].astype(np.int64),
        look=look[is_known].astype(np.int64),
        error=np.where(known, error, np.nan)[is_known][:, measured],
        sigma=np.sqrt(np.maximum(variance, 1e-12))[is_known][:, measured],
    )
    return _Compared(
        candidates,
        np.where(np.isfinite(kurtosis), kurtosis, 3.0)[is_known][:, measured],
        [name for name, there in zip(QUANTITIES, measured.tolist(), strict=True) if there],
    )


def _a_model(feed: SensorFeed) -> SensorModel | None:
    known = next((each for each in feed.believed if each is not None), None)
    return None if known is None else known.model


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
        kept = _is_near(plots.azimuth_deg[plot] - looks.azimuth_deg[look], 90.0, fold=True)
        kept &= (plots.channel[plot] == NOT_TOLD) | (plots.channel[plot] == looks.channel[look])
        yield plot[kept], look[kept]
        start = end


def _is_near(difference: Floats, most: float, *, fold: bool) -> Bools:
    """Whether it is at most that, or not known."""
    found: Bools = ~(np.abs(wrap_180(difference) if fold else difference) > most)
    return found


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
        )
        for k, name in enumerate(names):
            if name in found.errors:
                error[rows, k] = found.errors[name]
                variance[rows, k] = found.expected[name].variance
                kurtosis[rows, k] = found.expected[name].kurtosis
    return plot, look, error, variance, kurtosis


def _near_an_end(feed: SensorFeed) -> Bools:
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
        values = _values(believed.model, [*QUANTITIES], place_m, looks.channel)
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


def _residuals(feed: SensorFeed, pairs: _Compared, chosen: Ints) -> Residuals:
    """What was measured less what was true at the times that plots state."""
    plot, look = pairs.candidates.plot[chosen], pairs.candidates.look[chosen]
    looks = feed.looks.rows(look)
    stamped_ns = np.array(
        [
            true_ns if told_ns is None else told_ns
            for told_ns, true_ns in zip(
                feed.plots.t_utc_ns[plot].tolist(), looks.t_utc_ns.tolist(), strict=True
            )
        ],
        np.int64,
    )
    if _tells_sending(feed.plots):
        stamped_ns = looks.t_utc_ns
    place_m, velocity_m_s = _true_states(feed.looks, looks.target, stamped_ns)
    looked_m = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
    as_looked = stamped_ns == looks.t_utc_ns
    place_m[as_looked] = looked_m[as_looked]
    channel, model = np.maximum(feed.plots.channel[plot], 0), _a_model(feed)

    def values(place_enu_m: Floats) -> Floats:
        return _values(model, pairs.names, place_enu_m, channel)

    step_m = velocity_m_s * STEP_S
    rate = _difference(values(place_m + step_m), values(place_m - step_m), pairs.names)
    late = _difference(values(place_m), values(looked_m), pairs.names)
    return Residuals(
        target=looks.target,
        t_s=looks.t_utc_ns / NS,
        error=pairs.candidates.error[chosen] - late,
        sigma=pairs.candidates.sigma[chosen],
        rate=rate / (2 * STEP_S),
        kurtosis=pairs.kurtosis[chosen],
    )


def _true_states(looks: ClaimedLooks, target: Ints, t_utc_ns: Ints) -> tuple[Floats, Floats]:
    """Places of targets at times and their velocities, east, north and up; (n, 3), NaN if unknown.

    By where they were when they were looked at.
    """
    order = np.lexsort((looks.t_utc_ns, looks.target))
    looks = looks.rows(order)
    ecef_m = ANYWHERE.to_ecef(aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m))
    between_ns = np.diff(looks.t_utc_ns)
    between_ns = between_ns[(np.diff(looks.target) == 0) & (between_ns > 0)]
    gap_ns = round(LONGEST_GAP * float(np.median(between_ns))) if len(between_ns) else 0
    place_m, velocity_m_s = (np.full((len(target), 3), np.nan) for _ in range(2))
    for each in np.unique(target).tolist():
        first, end = np.searchsorted(looks.target, [each, each + 1])
        path = FlightPath.of(looks.t_utc_ns[first:end], ecef_m[first:end], gap_ns)
        rows = np.flatnonzero(target == each)
        place, velocity = path.states_at(t_utc_ns[rows])
        place_m[rows] = ANYWHERE.from_ecef(place)
        velocity_m_s[rows] = ANYWHERE.rotate_from_ecef(velocity)
    return place_m, velocity_m_s


def _values(
    model: SensorModel | None, names: Sequence[str], place_enu_m: Floats, channel: Ints
) -> Floats:
    """Quantities of places by the sensor, (n, k)."""
    azimuth_deg, elevation_deg, range_m = enu_to_aer(place_enu_m)
    found = {"azimuth": azimuth_deg, "elevation": elevation_deg, "range": range_m}
    if "bistatic range" in names and isinstance(model, PassiveRadar):
        found["bistatic range"] = bistatic_range(place_enu_m, model.positions_enu_m[channel])
    return np.stack([found.get(name, np.full(len(range_m), np.nan)) for name in names], axis=1)


def _difference(later: Floats, earlier: Floats, names: Sequence[str]) -> Floats:
    difference = later - earlier
    if "azimuth" in names:
        k = names.index("azimuth")
        difference[:, k] = wrap_180(difference[:, k])
    return difference
