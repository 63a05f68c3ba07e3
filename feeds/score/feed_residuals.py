"""Checks of one sensor's feed: plots paired with looks by place, and held against claims."""

from __future__ import annotations

import numpy as np

from plotfeed.feeds.report.expected_plots import TIME_OF_SENDING
from plotfeed.feeds.score.claimed_feed import ClaimedLooks, SensorFeed
from plotfeed.feeds.score.plot_comparison import (
    QUANTITIES,
    ComparedPlots,
    compared_plots,
    near_an_end,
    place_values,
    value_difference,
)
from plotfeed.models.effects.merging import Merging
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.scoring.flight_paths import FlightPath
from plotfeed.models.scoring.plot_pairs import look_groups, plot_pairs
from plotfeed.models.scoring.residuals import (
    FalseInGates,
    LookOdds,
    ResidualCheck,
    Residuals,
    clutter_check,
    detection_check,
    error_checks,
    not_judged,
)
from plotfeed.models.sensors.electronic_radar import SEARCH, ElectronicRadar
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.utc import NS

CONFUSED = 8.0
"""Standard deviations within which plots of two targets may be taken for each other's."""
MERGED = 4.0
"""Widths of resolution within which echoes may merge: further apart, one pair in 60,000."""
STEP_S = 0.25
"""Either way, for the rates of what is measured."""
LONGEST_GAP = 5.0
"""Usual times between looks at a target after which its way between them is not known."""
ANYWHERE = LocalFrame(0.0, 0.0, 0.0)
"""In place of a sensor's site that nobody tells: only what is relative to it counts."""


def feed_checks(feed: SensorFeed) -> list[ResidualCheck]:
    """All that a sensor's feed claims, checked; with why what cannot be checked is not."""
    if feed.model is not None and not feed.model.errs_as_stated:
        return _none_judged("its plots do not err by the spread that they state")
    feed = _plotted(feed)
    pairs = compared_plots(feed)
    if not pairs.names:
        return _nothing_measured(feed)
    quantities = [QUANTITIES[name][0] for name in pairs.names]
    reach = np.array([QUANTITIES[name][1] for name in pairs.names])
    group, blurred, plots_of_blurred = _told_apart(feed, pairs)
    sharp = np.flatnonzero(~blurred[pairs.candidates.look])
    found = plot_pairs(pairs.candidates.rows(sharp), reach, len(feed.looks))
    chosen = sharp[found.chosen]
    plot, look = pairs.candidates.plot[chosen], pairs.candidates.look[chosen]
    false_hits = found.false_per_look * float((1 - feed.looks.pd).sum())
    hit = np.zeros(len(feed.looks), np.bool_)
    hit[look] = True
    judged = ~_of_any(group, blurred | near_an_end(feed))
    whole = ~_of_any(group, ~(hit & judged))[look]
    checks = error_checks(
        _means(_residuals(feed, pairs, chosen[whole]), group[look[whole]]),
        quantities,
        FalseInGates(false_hits, found.gate),
        "its times are those of sending" if _tells_sending(feed.plots) else "",
    )
    odds = _odds(feed, hit).rows(judged & ~_of_any(group, ~feed.looks.counts))
    checks.append(detection_check(odds, found.false_per_look))
    left = np.setdiff1d(np.arange(len(feed.plots)), np.append(plot, plots_of_blurred))
    checks.append(_clutter(feed, len(left), false_hits))
    return checks


def _plotted(feed: SensorFeed) -> SensorFeed:
    """The feed with those looks alone of which there may be plots, by the channels of plots."""
    if not isinstance(feed.model, ElectronicRadar):
        return feed
    looks = feed.looks.rows(np.flatnonzero(feed.looks.channel != SEARCH))
    return feed._replace(looks=looks.but(channel=np.zeros(len(looks), np.int64)))


def _told_apart(feed: SensorFeed, pairs: ComparedPlots) -> tuple[Ints, Bools, Ints]:
    """Groups of looks that plots may not tell apart; of which echoes merge; and plots there.

    What is measured of a group is its sum, whichever plot is whose; of echoes that merge, nothing.
    """
    looks, candidates, merging = feed.looks, pairs.candidates, _merging(feed)
    width = CONFUSED * np.nanquantile(candidates.sigma, 0.9, axis=0)
    if merging is not None:
        cells = {
            "azimuth": merging.azimuth_deg,
            "elevation": merging.elevation_deg,
            "range": max(merging.range_m),
            "bistatic range": max(merging.range_m),
        }
        width = np.fmax(width, [MERGED * (cells[name] or 0.0) for name in pairs.names])
    place_m = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
    values = place_values(feed.model, pairs.names, place_m, looks.channel) / width
    since_ns = looks.t_utc_ns - looks.t_utc_ns.min(initial=0)
    scan = looks.sector if feed.known is None else since_ns / (feed.known.keys.scan.period_ns / 2)
    axes = [(scan.astype(np.float64), 0.0), (looks.channel.astype(np.float64), 0.0)]
    for name, value, each in zip(pairs.names, values.T, width.tolist(), strict=True):
        axes.append((value, 360.0 / each if name == "azimuth" else 0.0))
    group = look_groups(axes)
    if merging is None:
        return group, np.zeros(len(looks), np.bool_), np.zeros(0, np.int64)
    blurred = (np.bincount(group) > 1)[group]
    beside = blurred[candidates.look] & ~(np.abs(candidates.error) > width).any(axis=1)
    return group, blurred, candidates.plot[beside]


def _of_any(group: Ints, of: Bools) -> Bools:
    """Whether a look's group has any of those."""
    return np.asarray(np.bincount(group, of, minlength=1)[group] > 0)


def _means(rows: Residuals, group: Ints) -> Residuals:
    """Means of whole groups, (m,): they do not depend on which plot is taken for whose."""
    rows, group = rows.rows(np.argsort(group, kind="stable")), np.sort(group)
    first = np.flatnonzero(np.diff(group, prepend=-1))
    if len(first) == len(group):
        return rows
    n = np.diff(first, append=len(group))[:, None]
    variance = np.add.reduceat(rows.sigma**2, first)
    excess = np.add.reduceat((rows.kurtosis - 3) * rows.sigma**4, first)
    return rows.rows(first).but(
        error=np.add.reduceat(rows.error, first) / n,
        sigma=np.sqrt(variance) / n,
        rate=np.add.reduceat(rows.rate, first) / n,
        kurtosis=3 + excess / variance**2,
    )


def _nothing_measured(feed: SensorFeed) -> list[ResidualCheck]:
    if not len(feed.plots):
        odds = _odds(feed, np.zeros(len(feed.looks), np.bool_)).rows(feed.looks.counts)
        *errors, pd, _ = _none_judged("no plots came")
        if _merging(feed) is None:  # else several looks have one outcome
            pd = detection_check(odds, 0.0)
        return [*errors, pd, _clutter(feed, 0, 0.0)]
    is_told = np.isfinite(feed.plots.azimuth_deg).any() or np.isfinite(feed.plots.range_m).any()
    return _none_judged(
        "no plots near targets" if is_told else "it tells neither directions nor ranges"
    )


def _odds(feed: SensorFeed, hit: Bools) -> LookOdds:
    looks = feed.looks
    return LookOdds(target=looks.target, t_s=looks.t_utc_ns / NS, pd=looks.pd, hit=hit)


def _merging(feed: SensorFeed) -> Merging | None:
    return getattr(getattr(feed.model, "radar", feed.model), "merging", None)


def _none_judged(why: str) -> list[ResidualCheck]:
    return [
        *(not_judged(q.name, q.unit, 0.0, why) for q, _ in QUANTITIES.values()),
        not_judged("time", "s", 0.0, why),
        not_judged("Pd", "", 1.0, why),
        not_judged("false alarms", "", 0.0, why),
    ]


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


def _residuals(feed: SensorFeed, pairs: ComparedPlots, chosen: Ints) -> Residuals:
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
    channel, model = np.maximum(feed.plots.channel[plot], 0), feed.model

    def values(place_enu_m: Floats) -> Floats:
        return place_values(model, pairs.names, place_enu_m, channel)

    step_m = velocity_m_s * STEP_S
    rate = value_difference(values(place_m + step_m), values(place_m - step_m), pairs.names)
    late = value_difference(values(place_m), values(looked_m), pairs.names)
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
