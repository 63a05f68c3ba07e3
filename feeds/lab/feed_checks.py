"""Whether feeds are as their sensors claim, as a tracker sees them: checks, named and judged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from plotfeed.feeds.console.printed import finite
from plotfeed.feeds.engine.simulation import SimulatedSensor
from plotfeed.feeds.lab.asked import (
    AskedByTime,
    AskedSensor,
    BelievedSensor,
    ClaimedLooks,
    SensorFeed,
    left_of_pd,
)
from plotfeed.feeds.lab.evidence import (
    AS_DELIVERED,
    NO_PLOTS,
    Evidence,
    SectorKey,
    SectorPlots,
    names_of,
)
from plotfeed.feeds.lab.laws import TIME_OF_SENDING, TrueEchoes, TruePlots, compared, with_rounding
from plotfeed.feeds.lab.tables import Table, TextColumn
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.chance import Chance
from plotfeed.models.clutter import CLUTTER
from plotfeed.models.effects.merging import Merging
from plotfeed.models.frames import LocalFrame, aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.residuals import (
    Candidates,
    FalseInGates,
    LookOdds,
    MeasuredQuantity,
    ResidualCheck,
    Residuals,
    clutter_check,
    detection_check,
    error_checks,
    judged_wrong,
    look_groups,
    not_judged,
    plot_pairs,
)
from plotfeed.models.sensors.electronic_radar import SEARCH, ElectronicRadar
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.models.state import OTHER, Bools, Floats, Ints
from plotfeed.models.track_metrics import FlightPath
from plotfeed.proto.ledger import LedgerTables, tables_of
from plotfeed.proto.measured_plots import NOT_TOLD, MeasuredPlots
from plotfeed.proto.utc import NS
from plotfeed.replay.recorded import Stage

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


class FeedGathering:
    """What came of one sensor, part by part, until it is all there."""

    def __init__(self, asked: AskedByTime | None, plots_topic: str) -> None:
        self.lost = 0
        """Sectors of which a message with plots did not arrive whole."""
        self._asked = asked
        self._topic = plots_topic
        self._believed: dict[int, BelievedSensor | None] = {}
        """By the identity of what was asked, which is kept so that none is used twice."""
        self._kept: list[AskedSensor | None] = []
        self._targets: dict[str, int] = {}
        self._looks: list[ClaimedLooks] = []
        self._sectors: dict[SectorKey, int] = {}
        self._keys: list[int] = []
        self._plots: dict[tuple[SectorKey, int], MeasuredPlots] = {}
        self._has_clutter = False

    def take_plots(self, found: SectorPlots) -> None:
        """Take the plots of a message; copies of it are passed over."""
        if len(found.plots):
            self._plots.setdefault(found[:2], found.plots)

    def take(self, told: LedgerTables, keys: Sequence[SectorKey]) -> None:
        """Take what the ledger says of sectors."""
        sent = told.messages
        failed = (~sent.delivered | (sent.flipped_bit >= 0)) & (sent.copy == 0)
        failed &= sent.topic == self._topic
        arrived = np.setdiff1d(np.arange(len(told)), sent.entry[failed])
        self.lost += len(told) - len(arrived)
        told, first = told.of(arrived), len(self._keys)
        left = np.ones(len(told))
        for row, entry in enumerate(arrived.tolist()):
            key = keys[entry]
            asked = None if self._asked is None else self._asked.in_sector(key.scan, key.sector)
            self._sectors[key] = len(self._keys)
            self._keys.append(self._number(asked))
            left[row] = left_of_pd(asked)
        looks, numbers = told.looks, self._targets
        names = names_of(looks).tolist()
        share = left[looks.entry]
        pd = np.divide(looks.pd, share, out=np.zeros(len(looks)), where=share > 0)
        found = ClaimedLooks(
            sector=first + looks.entry,
            channel=looks.channel,
            target=np.array([numbers.setdefault(n, len(numbers)) for n in names], np.int64),
            t_utc_ns=looks.t_utc_ns,
            range_m=looks.range_m,
            azimuth_deg=looks.azimuth_deg,
            elevation_deg=looks.elevation_deg,
            pd=np.minimum(pd, 1.0),
            counts=share > 0,
        )
        self._looks.append(found)
        self._has_clutter |= any(o.startswith(CLUTTER + OTHER) for o in set(told.plots.other))

    def feed(self) -> SensorFeed:
        """All of it."""
        if not self._looks:
            self.take(tables_of(()), ())
        found = [
            (self._sectors[key], number, plots)
            for (key, number), plots in self._plots.items()
            if key in self._sectors
        ]
        rows = sorted(found, key=lambda each: each[:2])
        lengths = [len(plots) for *_, plots in rows]
        why = "clutter that the scene has beside is not claimed" if self._has_clutter else ""
        return SensorFeed(
            ClaimedLooks.joined(self._looks),
            MeasuredPlots.joined([NO_PLOTS, *(plots for *_, plots in rows)]),
            np.repeat(np.array([sector for sector, *_ in rows], np.int64), lengths),
            np.array(self._keys, np.int64),
            list(self._believed.values()),
            len(self._keys) / (1 if self._asked is None else self._asked.sectors),
            why,
        )

    def _number(self, asked: AskedSensor | None) -> int:
        """The number of what is claimed in a sector."""
        if id(asked) not in self._believed:
            self._kept.append(asked)
            self._believed[id(asked)] = None if asked is None else BelievedSensor.by(asked)
        return list(self._believed).index(id(asked))


class RecordedFeeds(NamedTuple):
    """What a recording holds of feeds."""

    sensors: Mapping[str, SensorFeed]
    carriers: Mapping[str, str]
    """The end of the topic from which each sensor's plots are, and the stage."""
    lost: Mapping[str, int]
    """Sectors whose plots did not arrive, by sensor."""
    notes: Sequence[str]


def recorded_feeds(path: Path) -> RecordedFeeds:
    """Read a recording; raises `PlotfeedError` without a ledger in it, and `OSError`."""
    with Evidence.of(path, AS_DELIVERED) as evidence:
        evidence.ask()
        gathered = {
            whose: FeedGathering(evidence.asked.get(whose[1]), topic)
            for (topic, _), whose in evidence.carriers.items()
        }
        for part in evidence.parts():
            for plots in part.plots:
                gathered[plots.key[:2]].take_plots(plots)
            for whose, told, keys in part.by_sensor():
                if whose in gathered:
                    gathered[whose].take(told, keys)
        notes = []
        if evidence.problem:
            why = (
                f"its scene cannot be used, so plots alone say what is claimed: {evidence.problem}"
            )
            notes.append(why)
        if evidence.log.damage:
            notes.append(f"damaged places that are left out: {len(evidence.log.damage)}")
        several = len({prefix for prefix, _ in gathered}) > 1
        names = {whose: "/".join(whose) if several else whose[1] for whose in gathered}
        carriers = evidence.carrier_of(WHEN)
    return RecordedFeeds(
        {names[whose]: each.feed() for whose, each in gathered.items()},
        {names[whose]: carriers[whose] for whose in gathered},
        {names[whose]: each.lost for whose, each in gathered.items()},
        notes,
    )


WHEN = {
    Stage.BEFORE: "before the link",
    Stage.AFTER: "as delivered",
    Stage.RECEIVED: "as received",
}
FALSE_RATE = 0.01
"""Share of right feeds, all sensors of a recording together, of which anything is called wrong."""
CARRIED = (
    "channel", "range_m", "bistatic_range_m", "azimuth_deg", "elevation_deg", "sigma_range_m",
    "sigma_bistatic_range_m", "sigma_azimuth_deg", "sigma_elevation_deg",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedCheck:
    """A check of one sensor's feed, and whether it fails."""

    sensor: str
    check: ResidualCheck
    wrong: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedVerdict:
    """What of feeds is not as it is claimed."""

    checks: Sequence[JudgedCheck]
    carriers: Mapping[str, str]
    """From which messages each sensor's plots are."""
    lost: Mapping[str, int]
    """Sectors of each sensor whose plots did not arrive, which are left out."""
    notes: Sequence[str]
    false_rate: float = FALSE_RATE

    @property
    def wrong(self) -> list[JudgedCheck]:
        """The checks that fail."""
        return [each for each in self.checks if each.wrong]


def check_feed(path: Path) -> FeedVerdict:
    """Check the feeds of a recording; raises `PlotfeedError` without a ledger, and `OSError`."""
    found = recorded_feeds(path)
    return FeedVerdict(
        checks=judged(found.sensors),
        carriers=found.carriers,
        lost=found.lost,
        notes=found.notes,
    )


def judged(feeds: Mapping[str, SensorFeed], false_rate: float = FALSE_RATE) -> list[JudgedCheck]:
    """All checks of all sensors, judged together."""
    rows = [(sensor, check) for sensor, feed in feeds.items() for check in feed_checks(feed)]
    wrong = judged_wrong([check for _, check in rows], false_rate)
    return [
        JudgedCheck(sensor=sensor, check=check, wrong=is_wrong)
        for (sensor, check), is_wrong in zip(rows, wrong, strict=True)
    ]


def simulated_feed(scene: Scene, seen: SimulatedSensor, sectors: int = 0) -> SensorFeed:
    """The feed of a simulated sensor, stamped by its own clock; links and formats are left out.

    `sectors` is of how many it is, empty ones too, where the simulation does not tell.
    """
    keys, plots, looks = seen.sensor, seen.plots, seen.looks
    asked = AskedSensor(keys, scene.scene.site, Chance(scene.scene.seed, keys.id), None)
    per_scan = keys.scan.sectors
    numbers = np.unique(
        np.concatenate([each.scan * per_scan + each.sector for each in (plots, looks)])
    )
    order = np.argsort(looks.scan * per_scan + looks.sector, kind="stable")
    looks = looks.rows(order)
    plots = plots.rows(np.argsort(plots.scan * per_scan + plots.sector, kind="stable"))
    measured = MeasuredPlots.of([{}] * len(plots)).but(
        t_utc_ns=(plots.t_utc_ns + keys.clock_ahead_ns).astype(np.object_),
        category=np.zeros(len(plots), np.int64),
        **{name: np.ascontiguousarray(getattr(plots, name)) for name in CARRIED},
    )
    left = left_of_pd(asked)
    pd = np.minimum(looks.pd / left, 1.0) if left > 0 else np.zeros(len(looks))
    return SensorFeed(
        ClaimedLooks(
            sector=np.searchsorted(numbers, looks.scan * per_scan + looks.sector),
            channel=looks.channel,
            target=looks.drone,
            t_utc_ns=looks.t_utc_ns,
            range_m=looks.range_m,
            azimuth_deg=looks.azimuth_deg,
            elevation_deg=looks.elevation_deg,
            pd=pd,
            counts=np.full(len(looks), left > 0),
        ),
        measured,
        np.searchsorted(numbers, plots.scan * per_scan + plots.sector),
        np.zeros(max(len(numbers), 1), np.int64),
        [BelievedSensor.by(asked)],
        (sectors or len(seen.sectors)) / per_scan,
    )


def _if_judged(of: Callable[[ResidualCheck], Any]) -> Callable[[tuple[str, JudgedCheck]], Any]:
    """What stands in a column of checks that are judged; nothing of others."""
    return lambda row: "" if np.isnan(row[1].check.p) else of(row[1].check)


def _verdict(row: tuple[str, JudgedCheck]) -> str:
    check = row[1].check
    if np.isnan(check.p):
        return f"not judged: {check.why_not}"
    return "WRONG" if row[1].wrong else "ok"


CHECKS = (
    TextColumn("sensor", lambda row: row[0]),
    TextColumn("check", lambda row: row[1].check.name),
    TextColumn("claimed", _if_judged(lambda check: check.claimed), ".4g"),
    TextColumn("found", _if_judged(lambda check: check.found), ".4g"),
    TextColumn("+-", _if_judged(lambda check: check.sigma), ".2g"),
    TextColumn("", _if_judged(lambda check: check.unit)),
    TextColumn("z", _if_judged(lambda check: check.z), "+.1f"),
    TextColumn("of", _if_judged(lambda check: check.of), "d"),
    TextColumn("verdict", _verdict),
)


def as_text(verdict: FeedVerdict) -> list[str]:
    """The verdict in lines."""
    rows, before = [], ""
    for each in verdict.checks:
        rows.append(("" if each.sensor == before else each.sensor, each))
        before = each.sensor
    lines = list(Table("The feed beside its claims, as a tracker sees it", CHECKS, rows).lines())
    if not rows:
        lines.append("  no sensor's plots can be read")
    for sensor, carrier in verdict.carriers.items():
        lost = verdict.lost.get(sensor, 0)
        left_out = f"; {lost} sectors that did not arrive are left out" if lost else ""
        lines.append(f"  {sensor}: by {carrier}{left_out}")
    lines += [f"  {note}" for note in verdict.notes]
    number = sum(not np.isnan(each.check.p) for each in verdict.checks)
    wrong = verdict.wrong
    what = f"{len(wrong)} not as claimed" if wrong else "all as claimed"
    lines.append(
        f"{number} checks: {what}. "
        f"Of right feeds {100 * verdict.false_rate:g} % are called wrong somewhere."
    )
    return lines


def as_json(verdict: FeedVerdict) -> dict[str, Any]:
    """The verdict for JSON."""
    found: dict[str, Any] = finite(
        {
            "false_rate": verdict.false_rate,
            "wrong": [f"{each.sensor}: {each.check.name}" for each in verdict.wrong],
            "checks": [
                {
                    "sensor": each.sensor,
                    **asdict(each.check),
                    "z": each.check.z,
                    "wrong": each.wrong,
                }
                for each in verdict.checks
            ],
            "carriers": dict(verdict.carriers),
            "lost_sectors": dict(verdict.lost),
            "notes": list(verdict.notes),
        }
    )
    return found
