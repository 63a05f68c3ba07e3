"""The judge of feeds: what came of sensors beside what is expected of them, named and with a risk.

Against what was *asked* a sensor is to be as the scene has it, biases, drifts and degradations
among that, and the ledger says whose plot is whose. Against what it *claims* it is to be as it
takes itself to be, and plots are paired with looks by place alone, as a tracker sees them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from plotfeed.feeds.console.printed import finite
from plotfeed.feeds.engine.simulation import SimulatedSensor
from plotfeed.feeds.lab import laws, oracle
from plotfeed.feeds.lab.evidence import RADARS, AskedSensor
from plotfeed.feeds.lab.laws import QUANTITIES, TrueEchoes, TruePlots
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models import residuals
from plotfeed.models.effects.merging import Merging
from plotfeed.models.frames import LocalFrame, aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.residuals import CELL_M, Check, Residuals
from plotfeed.models.sensors.electronic_radar import SEARCH, ElectronicRadar
from plotfeed.models.state import Bools, Columns, Floats, Ints
from plotfeed.models.tail_chances import p_of_normal, p_of_trials
from plotfeed.models.track_metrics import FlightPath
from plotfeed.proto.measured_plots import NOT_TOLD, MeasuredPlots
from plotfeed.proto.utc import NS

Against = Literal["asked", "claimed"]
# Share of right recordings, all their sensors together, in which anything is called wrong.
FALSE_RATES: Mapping[Against, float] = {"asked": 1e-3, "claimed": 1e-2}
NAMES = [*QUANTITIES]
# Heights are told by elevation and range, so that their noise is that of these.
MEASURED = [
    residuals.MeasuredQuantity(n, unit, n == "height") for n, (_, unit) in QUANTITIES.items()
]
# By what plots are paired with looks, the first of which displaces gates, and how far off they are
# looked for at least.
REACH = {"azimuth": 8.0, "range": 500.0, "bistatic range": 1000.0, "elevation": 8.0}
PAIRED = [NAMES.index(name) for name in REACH]
AT_ONCE = 500_000  # Pairs of a plot and a look that are compared at once
# Standard deviations within which plots of two targets may be taken for each other's.
CONFUSED = 8.0
# Widths of resolution within which echoes may merge: further apart, one pair in 60,000.
MERGED = 4.0
# Between plots that tell the same field of view, so that it has not changed meanwhile.
SAME_FIELD_NS = 10 * NS
STEP_S = 0.25  # Either way, for the rates of what is measured
# Usual times between looks at a target after which its way between them is not known.
LONGEST_GAP = 5.0
# In place of a sensor's site that nobody tells: only what is relative to it counts.
ANYWHERE = LocalFrame(0.0, 0.0, 0.0)
# Share of a format's step below which noise is lost in it, and variance that is but arithmetic's.
FINEST, ROUNDING = 0.05, 1e-12
# Of histograms of errors, in standard deviations; what is further counts with the last cells.
STEP, FURTHEST = 0.25, 6.0
EDGES = np.arange(-FURTHEST, FURTHEST + STEP, STEP)
MAX_BINS = 12
# Of looks, that ledgers, simulations and judges call the same.
OF_LOOKS = ("channel", "t_utc_ns", "range_m", "azimuth_deg", "elevation_deg", "pd", "detected")
# Plots from which on it is judged what they state of their errors, and by how much variances may
# differ from what is expected to be the same: their mean over few plots is not normal.
FEWEST_SIGMAS, SAME_SIGMA = 20, 0.2
# Stated variances over expected ones count as no more than this, however wild what is stated.
MOST_OFF = 1e12


@dataclass(frozen=True, kw_only=True)
class FeedLooks(Columns):
    """Looks at targets, (n,): where they truly were, seen from the sensor, and the expected Pd.

    `sector` and `target` are numbers; a look counts for Pd if it `counts`. `detected` is by the
    ledger, which a judge of claims does not look at.
    """

    sector: Ints
    channel: Ints
    target: Ints
    t_utc_ns: Ints
    emitted_utc_ns: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    pd: Floats
    counts: Bools
    detected: Bools
    pd_off: Floats | None = None

    def odds(self, hit: Bools) -> residuals.LookOdds:
        """The odds of those looks, of which those brought a plot."""
        t_s = self.t_utc_ns / NS
        return residuals.LookOdds(target=self.target, t_s=t_s, pd=self.pd, hit=hit, off=self.pd_off)


class ToldTruth(NamedTuple):
    """What the ledger says of plots, of each in its place: which are of targets, and of which."""

    is_target: Bools
    plots: TruePlots  # Of targets alone, and so are echoes
    echoes: TrueEchoes

    def rows(self, which: Bools) -> ToldTruth:
        """What is said of some plots, (n,)."""
        if which.all():
            return self
        kept = which[self.is_target]
        anew, echoes = np.cumsum(kept) - 1, self.echoes.rows(kept[self.echoes.plot])
        echoes = echoes.but(plot=anew[echoes.plot])
        return ToldTruth(self.is_target[which], self.plots.rows(kept), echoes)


class SensorFeed(NamedTuple):
    """What came of a sensor in some sectors, with numbers from 0, and what is expected of it."""

    looks: FeedLooks  # In the order of sectors
    plots: MeasuredPlots
    plot_sector: Ints  # The sector of each plot, ascending
    keys_of_sector: Ints  # Which of `expected` holds in each sector
    # None where no scene says what is expected, but the plots.
    expected: Sequence[AskedSensor | None]
    scans: float  # That were seen, parts of one counted as such
    names: Sequence[str]  # Of targets, by their numbers
    told: ToldTruth | None = None  # None where plots are paired by place
    false_alarms: int = 0  # By the ledger
    why_no_clutter: str = ""  # Why false alarms are not judged

    @property
    def known(self) -> AskedSensor | None:
        """The sensor as its scene first has it; None where none says."""
        return next((each for each in self.expected if each is not None), None)

    @property
    def is_bistatic(self) -> bool:
        """Whether it is known to measure bistatic ranges."""
        return self.known is not None and self.known.is_bistatic

    @property
    def merging(self) -> Merging | None:
        """How its echoes merge, None if they do not."""
        model: Any = None if self.known is None else self.known.model
        return getattr(getattr(model, "radar", model), "merging", None)


class FeedTally:
    """Takes what came of one sensor, part by part; `checks` says what is expected and was found."""

    def __init__(self, against: Against) -> None:
        self.errors = residuals.ErrorSums(MEASURED)
        self.looks = residuals.LookSums()
        # Plots with their truth; of these, those of which it is not known what they were to say,
        # and those at another time than expected.
        self.joined = self.left_out = self.times_off = 0
        self.off: Counter[str] = Counter()
        self.histograms = np.zeros((len(NAMES), len(EDGES) - 1), np.int64)
        self.left, self.alarms, self.false_hits, self.scans = 0, 0.0, 0.0, 0.0
        self.why_not = self.why_no_clutter = self._no_time = ""
        self._against: Against = against
        self._plots, self._is_compared = 0, False
        # Of which it is not known what Pd is expected, and why.
        self.unjudged, self.why_not_pd = 0, ""
        # Number, sum and sum of squares of stated variances over expected ones.
        self._sigmas = np.zeros((len(NAMES), 3))
        self._why_no_alarms = ""
        self._bins: list[PdFigures] | None = None  # As far as they are worked out already

    @np.errstate(all="ignore")  # whatever numbers others have recorded
    def take(self, feed: SensorFeed) -> None:
        """Take sectors."""
        self._bins = None
        self.scans += feed.scans
        self._plots += len(feed.plots)
        self.why_no_clutter = self.why_no_clutter or feed.why_no_clutter
        per_scan = [np.nan if e is None else e.false_alarms[0] for e in feed.expected]
        for each in feed.expected:
            if each is not None and each.false_alarms[1]:
                self._why_no_alarms = f"not known here: {each.false_alarms[1]}"
        feed, sigmas = self._with_pd(feed)
        sectors = max(len(feed.keys_of_sector), 1)
        self.alarms += float(np.array(per_scan)[feed.keys_of_sector].sum()) * feed.scans / sectors
        if self._against == "asked":
            self._take_told(feed, sigmas)
        elif feed.known is not None and not feed.known.model.errs_as_stated:
            self.why_not = "its plots do not err by the spread that they state"
        else:
            self._take_by_place(feed, sigmas)

    def _with_pd(self, feed: SensorFeed) -> tuple[SensorFeed, Floats]:
        """The feed with Pd as it is expected, and what plots of looks are to state, (k, n).

        Where nobody says what is expected, Pd is that of the ledger; where that is not known, looks
        do not count.
        """
        looks, n = feed.looks, len(feed.looks)
        pd, counts, sigmas = looks.pd.copy(), looks.counts.copy(), np.full((len(NAMES), n), np.nan)
        off = np.zeros(n)
        keys, names = feed.keys_of_sector[looks.sector], np.array([*feed.names, ""], np.object_)
        for which in np.unique(keys).tolist():
            expected, rows = feed.expected[which], np.flatnonzero(keys == which)
            if expected is None:
                continue
            of = looks.rows(rows)
            found = expected.of_looks(
                oracle.LooksGiven(
                    t_utc_ns=of.t_utc_ns,
                    azimuth_deg=of.azimuth_deg,
                    elevation_deg=of.elevation_deg,
                    range_m=of.range_m,
                    drone=names[of.target],
                    channel=of.channel,
                    emitted_utc_ns=of.emitted_utc_ns if of.emitted_utc_ns.any() else None,
                    field_deg=_fields_deg(feed, of.sector, expected.keys),
                )
            )
            pd[rows] = np.where(found.known, found.pd, pd[rows])
            counts[rows] &= found.known
            off[rows] = found.pd_off
            self.unjudged += int((~found.known).sum())
            self.why_not_pd = self.why_not_pd or found.why_not
            for name in ("range", "azimuth", "elevation"):
                sigma = getattr(found, f"sigma_{QUANTITIES[name][0]}") / expected.error_factor
                sigmas[NAMES.index(name), rows] = np.where(found.known, sigma, np.nan)
        return feed._replace(looks=looks.but(pd=pd, counts=counts, pd_off=off)), sigmas

    def _take_sigmas(self, feed: SensorFeed, which: Ints, expected: Floats) -> None:
        """Count what those plots state of their errors over what they are to, (k, m).

        A radar's follow from the ratio that each tells; what is told in coarse steps is left out.
        """
        exact = feed.plots.category[which] == 0
        which, expected = which[exact], expected[:, exact]
        plots, keys = feed.plots.rows(which), feed.keys_of_sector[feed.plot_sector[which]]
        for number in np.unique(keys).tolist():
            sensor, rows = feed.expected[number], np.flatnonzero(keys == number)
            if sensor is None or not sensor.model.errs_as_stated:
                continue
            of, by_ratio = plots.rows(rows), {}
            if sensor.keys.type in RADARS:
                by_ratio = sensor.stated_sigmas(10 ** (of.snr_db / 10), np.maximum(of.channel, 0))
            for k, name in enumerate(NAMES):
                column = f"sigma_{QUANTITIES[name][0]}"
                stated: Floats = getattr(of, column, np.full(len(of), np.nan))
                usual = np.full(len(of), np.nan) if by_ratio else expected[k, rows]
                share = (stated / by_ratio.get(column, usual)) ** 2
                share = np.minimum(share[np.isfinite(share)], MOST_OFF)
                self._sigmas[k] += len(share), share.sum(), share @ share

    def checks(self) -> list[Check]:
        """All that is expected, checked; with why what cannot be checked is not."""
        told: dict[str, Any]
        is_asked, nothing = self._against == "asked", not self._is_compared
        if nothing and not is_asked and not self.why_not:
            near = "no plots near targets, or none that tells directions or ranges"
            self.why_not = near if self._plots else "no plots came"
        found = self.errors.checks("asked of each plot" if is_asked else self._no_time)
        if nothing:
            names = () if is_asked else (*REACH, "time")
            found = [replace(c, why_not=self.why_not) for c in found if c.name in names]
        if is_asked:
            found = [c for c in found if c.name != "time"]
            found += [never(f"{q} outliers", n, self.joined) for q, n in self.off.items()]
            found.append(never("time", self.times_off, self.joined))
        for name, (n, total, squares) in zip(NAMES, self._sigmas.tolist(), strict=True):
            if n < FEWEST_SIGMAS:
                continue
            # Whether plots state, on average, what they are to.
            mean = total / n
            se = math.sqrt(max(squares / n - mean**2, ROUNDING) / n)
            beyond = max(abs(mean - 1) - SAME_SIGMA, 0.0)
            told = {"found": math.sqrt(mean), "sigma": se / (2 * math.sqrt(mean)), "of": round(n)}
            found.append(
                Check(name=f"{name} sigma", expected=1.0, p=p_of_normal(beyond / se), **told)
            )
        pd = self.looks.check()
        if self.why_not and self._plots:
            pd = Check(name="Pd", expected=math.nan, why_not=self.why_not)
        if not pd.is_judged and self.why_not_pd and not self.why_not:
            pd = replace(pd, why_not=f"not known here: {self.why_not_pd}")
        found.append(pd)
        bins = self.by_range() if is_asked else []
        for at in bins if len(bins) > 1 else ():
            name, half = f"Pd {at.from_m / 1000:.2f}-{at.to_m / 1000:.2f} km", at.high - at.low
            told = {"found": at.found, "sigma": half / (2 * 1.96), "of": at.looks}
            found.append(Check(name=name, expected=at.expected, p=at.p, **told))
        return [*found, self._clutter()]

    def by_range(self) -> list[PdFigures]:
        """Looks of at most `MAX_BINS` equal bins over the ranges looked at; none is empty."""
        if self._bins is None:
            self._bins = pd_by_range(self.looks.tally)
        return self._bins

    def _clutter(self) -> Check:
        why = self.why_no_clutter or (self.why_not if self._plots else "")
        if not why and math.isnan(self.alarms):
            why = self._why_no_alarms or "it is not known how many are expected"
        if not why:
            return residuals.clutter_check(self.left, self.alarms, self.scans, self.false_hits)
        unjudged = Check(name="false alarms", unit="a scan", expected=math.nan, of=self.left)
        return replace(unjudged, why_not=why)

    # By the ledger.

    def _take_told(self, feed: SensorFeed, sigmas: Floats) -> None:
        looks, told = feed.looks, feed.told
        self.left += feed.false_alarms
        counted = looks.rows(looks.counts)
        self.looks.add(counted.odds(counted.detected), counted.range_m)
        if told is None or not len(told.plots):
            return
        self._is_compared = True
        self.joined += len(told.plots)
        plots = feed.plots.rows(told.is_target)
        sector = feed.plot_sector[told.is_target]
        own, row = _rows_in(
            (sector, told.plots.target, np.maximum(plots.channel, 0)),
            (looks.sector, looks.target, looks.channel),
        )
        alone = told.plots.drones[own] == 1
        self._take_sigmas(feed, np.flatnonzero(told.is_target)[own[alone]], sigmas[:, row[alone]])
        keys = feed.keys_of_sector[feed.plot_sector[told.is_target]]
        for which, category in {*zip(keys.tolist(), plots.category.tolist(), strict=True)}:
            is_of = (keys == which) & (plots.category == category)
            every = np.zeros(len(feed.plots), np.bool_)
            every[np.flatnonzero(told.is_target)[is_of]] = True
            of = told.rows(every)
            self._compare_told(feed.expected[which], of, plots.rows(is_of))

    def _compare_told(
        self, expected: AskedSensor | None, told: ToldTruth, plots: MeasuredPlots
    ) -> None:
        found = laws.compared(expected, told.echoes, told.plots, plots, laws.in_steps)
        self.left_out += found.left_out
        self.times_off += found.off.pop("time", 0)
        self.off.update(found.off)
        noisy = found.variance > np.maximum((FINEST * found.step) ** 2, ROUNDING)
        judged = noisy & np.isfinite(found.error + found.variance + found.kurtosis)
        error, sigma = np.where(judged, found.error, np.nan), np.sqrt(found.variance)
        shares = np.clip((error / sigma + FURTHEST) / STEP, 0, len(EDGES) - 2)
        for i, of in enumerate(judged.T):
            cells = shares[of, i].astype(np.int64)
            self.histograms[i] += np.bincount(cells, minlength=len(EDGES) - 1)
        # Of each plot anew: nothing hangs together with what came before.
        n = len(plots)
        self.errors.add(
            Residuals(
                target=np.arange(n),
                t_s=np.zeros(n),
                error=error,
                sigma=sigma,
                rate=np.zeros_like(error),
                kurtosis=found.kurtosis,
            )
        )

    # By place.

    def _take_by_place(self, feed: SensorFeed, sigmas: Floats) -> None:
        if isinstance(feed.known.model if feed.known else None, ElectronicRadar):
            # What searches brings no plot by itself.
            kept = np.flatnonzero(feed.looks.channel != SEARCH)
            looks, sigmas = feed.looks.rows(kept), sigmas[:, kept]
            feed = feed._replace(looks=looks.but(channel=np.zeros(len(looks), np.int64)))
        pairs, looks = ComparedPlots(feed), feed.looks
        if not pairs.columns:
            self.left += len(feed.plots)
            if not len(feed.plots) and feed.merging is None:  # else several looks have one outcome
                self._count_looks(feed, np.zeros(len(looks), np.bool_), looks.counts, 0.0)
            return
        self._is_compared = True
        reach = np.array([REACH[NAMES[i]] for i in pairs.columns])
        group, blurred, plots_of_blurred = _told_apart(feed, pairs)
        sharp = np.flatnonzero(~blurred[pairs.candidates.look])
        found = residuals.plot_pairs(pairs.candidates.rows(sharp), reach, len(looks))
        chosen = sharp[found.chosen]
        plot, look = pairs.candidates.plot[chosen], pairs.candidates.look[chosen]
        false_hits = found.false_per_look * float((1 - looks.pd).sum())
        hit = np.zeros(len(looks), np.bool_)
        hit[look] = True
        judged = ~_of_any(group, blurred | _near_an_end(feed))
        whole = ~_of_any(group, ~(hit & judged))[look]
        gate = np.full(len(NAMES), found.gate[0])
        gate[pairs.columns] = found.gate
        rows = _residuals(feed, pairs, chosen[whole])
        self.errors.add(_means(rows, group[look[whole]]), false_hits, gate)
        if laws.TIME_OF_SENDING in feed.plots.category:
            self._no_time = "its times are those of sending"
        self._take_sigmas(feed, plot[whole], sigmas[:, look[whole]])
        self._count_looks(feed, hit, judged & ~_of_any(group, ~looks.counts), found.false_per_look)
        left = np.setdiff1d(np.arange(len(feed.plots)), np.append(plot, plots_of_blurred))
        self.left += len(left)
        self.false_hits += false_hits

    def _count_looks(self, feed: SensorFeed, hit: Bools, which: Bools, false: float) -> None:
        self.looks.add(feed.looks.odds(hit).rows(which), feed.looks.range_m[which], false)


def _fields_deg(feed: SensorFeed, sector: Ints, keys: Any) -> Floats | None:
    """Fields of view in those frames, of a camera that zooms: as plots before and after tell alike.

    Not by plots of the frame itself, as there are more where more was detected; (n,), NaN if
    unknown.
    """
    exact = np.flatnonzero(feed.plots.category == 0)
    if not oracle.zooms(keys) or not len(exact):
        return None
    told_deg = oracle.field_of_view_deg(keys, feed.plots.sigma_elevation_deg[exact])
    at, t_ns = feed.plot_sector[exact], feed.plots.t_utc_ns[exact].astype(np.int64)
    before, after = np.searchsorted(at, sector) - 1, np.searchsorted(at, sector, side="right")
    is_between = (before >= 0) & (after < len(at))
    before, after = np.maximum(before, 0), np.minimum(after, len(at) - 1)
    alike = np.isclose(told_deg[before], told_deg[after], rtol=1e-5)
    alike &= t_ns[after] - t_ns[before] < SAME_FIELD_NS
    return np.where(is_between & alike, told_deg[before], np.nan)


def _rows_in(keys: tuple[Ints, ...], among: tuple[Ints, ...]) -> tuple[Ints, Ints]:
    """Which rows of some columns are among others, and the rows there; (m,) each."""
    n = len(keys[0])
    both = np.stack([np.concatenate(each) for each in zip(keys, among, strict=True)])
    _, number = np.unique(both, axis=1, return_inverse=True)
    number = number.reshape(-1)
    row_of = np.full(number.max(initial=0) + 1, -1)
    row_of[number[n:]] = np.arange(len(among[0]))
    row = row_of[number[:n]]
    return np.flatnonzero(row >= 0), row[row >= 0]


def never(name: str, count: int, of: int) -> Check:
    """What never is where all is right."""
    return Check(name=name, expected=0.0, found=count, p=0.0 if count else 1.0, of=of)


class PdFigures:
    """Looks at some ranges, and how many of them detected."""

    def __init__(self, cells: Floats, from_m: float, to_m: float) -> None:
        """`cells` are those of a `LookTally` there."""
        count, sum_pd, *_ = cells
        looks, pd, _, detected, off = cells.sum(axis=1).tolist()
        mean_pd = np.divide(sum_pd, count, out=np.zeros_like(count), where=count > 0)
        self.from_m, self.to_m, self.looks = from_m, to_m, round(looks)
        self.expected = pd / looks  # Mean of the looks' own probabilities
        self.found = detected / looks  # Share detected, and its 95 % interval
        self.low, self.high = laws.share_interval(round(detected), self.looks)
        # Probability of such a share, or one further off, by chance.
        self.p = p_of_trials(count, mean_pd, residuals.nearer(round(detected), pd, off))


def pd_by_range(looks: residuals.LookTally) -> list[PdFigures]:
    """Figures of at most `MAX_BINS` equal bins over the ranges looked at; none is empty."""
    cells = looks.cells()
    at = np.flatnonzero(cells[0])
    if not len(at):
        return []
    first, end = int(at[0]), int(at[-1]) + 1
    step = round(_round_up((end - first) * CELL_M / MAX_BINS) / CELL_M)
    return [
        PdFigures(cells[:, begin : begin + step], begin * CELL_M, (begin + step) * CELL_M)
        for begin in range(first // step * step, end, step)
        if cells[0, begin : begin + step].any()
    ]


def _round_up(width_m: float) -> float:
    """A width of 1, 2 or 5 times a power of ten, where cells fit into it, and at least a cell."""
    unit = 10.0 ** math.floor(math.log10(max(width_m, CELL_M)))
    for times in (1, 2, 5, 10, 20, 50):
        step = times * unit
        if step >= width_m and step % CELL_M == 0:
            return step
    return 10 * CELL_M * math.ceil(width_m / (10 * CELL_M))


class ComparedPlots:
    """All pairs of a feed's plots and looks of one sector that are not far from each other."""

    def __init__(self, feed: SensorFeed) -> None:
        parts = [_compare(feed, plot, look) for plot, look in _pairs(feed)]
        plot, look, error, variance, kurtosis = (
            np.concatenate(columns) if parts else np.zeros((0, len(NAMES)))
            for columns in (zip(*parts, strict=True) if parts else [()] * 5)
        )
        known = np.isfinite(error) & np.isfinite(variance)
        if feed.is_bistatic:
            known[:, NAMES.index("range")] = False  # it follows from the others
        known[:, NAMES.index("range rate")] = False
        known = known.reshape(-1, len(NAMES))
        # Quantities by which they are paired.
        self.columns = columns = [i for i in PAIRED if known[:, i].any()]
        rows = known[:, columns].any(axis=1) if columns else np.zeros(len(known), np.bool_)
        # How what was measured differs from the truth, of all quantities, (n, k), with its spread.
        self.error = np.where(known, error, np.nan)[rows]
        self.sigma: Floats = np.sqrt(np.maximum(variance, 1e-12))[rows]
        self.kurtosis = np.where(np.isfinite(kurtosis), kurtosis, 3.0)[rows]
        self.candidates = residuals.Candidates(
            plot=plot[rows].astype(np.int64),
            look=look[rows].astype(np.int64),
            error=self.error[:, columns],
            sigma=self.sigma[:, columns],
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


def _compare(feed: SensorFeed, plot: Ints, look: Ints) -> tuple[Ints, Ints, Floats, Floats, Floats]:
    """Errors and their expected variances and kurtoses, by what was expected in each sector."""
    error, variance, kurtosis = (np.full((len(plot), len(NAMES)), np.nan) for _ in range(3))
    keys = feed.keys_of_sector[feed.plot_sector[plot]]
    categories = feed.plots.category[plot]
    for which, category in {*zip(keys.tolist(), categories.tolist(), strict=True)}:
        rows = np.flatnonzero((keys == which) & (categories == category))
        found = laws.compared(
            feed.expected[which],
            *_truth_of(feed.looks.rows(look[rows])),
            # One plot may be in many pairs, which is more rows than there are.
            MeasuredPlots.holding({n: c[plot[rows]] for n, c in vars(feed.plots).items()}),
            laws.with_rounding,
            keeps_ends=True,
        )
        error[rows], variance[rows], kurtosis[rows] = found[:3]
    return plot, look, error, variance, kurtosis


def _truth_of(looks: FeedLooks) -> tuple[TrueEchoes, TruePlots]:
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
            target=looks.target,
            drones=np.ones(n, np.int64),
            range_rate_m_s=np.full(n, np.nan),
        ),
    )


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
        expected = feed.expected[which]
        if expected is None:
            continue
        rows = np.flatnonzero(keys == which)
        looks = feed.looks.rows(rows)
        place_m = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
        values = _place_values(expected, place_m, looks.channel)
        exact = MeasuredPlots.of([{**usual, "channel": 0}] * len(rows)).but(
            channel=looks.channel, **{QUANTITIES[NAMES[i]][0]: values[:, i] for i in PAIRED}
        )
        found = laws.compared(expected, *_truth_of(looks), exact)
        near[rows] = ~np.isfinite(found.error).any(axis=1)
        if expected.is_bistatic:  # along a baseline nothing can be placed
            near[rows] |= ~np.isfinite(found.variance[:, NAMES.index("range")])
    return near


def _place_values(expected: AskedSensor | None, place_enu_m: Floats, channel: Ints) -> Floats:
    """Quantities of places by the sensor, (n, k), heights over its own place."""
    azimuth_deg, elevation_deg, range_m = enu_to_aer(place_enu_m)
    found = {"azimuth": azimuth_deg, "elevation": elevation_deg, "range": range_m}
    found["height"] = place_enu_m[:, 2]
    if expected is not None and expected.is_bistatic:
        found["bistatic range"] = bistatic_range(place_enu_m, expected.from_enu_m(channel))
    return np.stack([found.get(name, np.full(len(range_m), np.nan)) for name in NAMES], axis=1)


def _difference(later: Floats, earlier: Floats) -> Floats:
    """Values less others, (n, k), azimuths within half a turn."""
    difference, k = later - earlier, NAMES.index("azimuth")
    difference[:, k] = wrap_180(difference[:, k])
    return difference


def _told_apart(feed: SensorFeed, pairs: ComparedPlots) -> tuple[Ints, Bools, Ints]:
    """Groups of looks that plots may not tell apart; of which echoes merge; and plots there.

    What is measured of a group is its sum, whichever plot is whose; of echoes that merge, nothing.
    """
    looks, candidates, merging = feed.looks, pairs.candidates, feed.merging
    names = [NAMES[i] for i in pairs.columns]
    width = CONFUSED * np.nanquantile(candidates.sigma, 0.9, axis=0)
    if merging is not None:
        cells = {
            "azimuth": merging.azimuth_deg,
            "elevation": merging.elevation_deg,
            "range": max(merging.range_m),
            "bistatic range": max(merging.range_m),
        }
        width = np.fmax(width, [MERGED * (cells[name] or 0.0) for name in names])
    place_m = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
    values = _place_values(feed.known, place_m, looks.channel)[:, pairs.columns] / width
    since_ns = looks.t_utc_ns - looks.t_utc_ns.min(initial=0)
    scan = looks.sector if feed.known is None else since_ns / (feed.known.keys.scan.period_ns / 2)
    axes = [(scan.astype(np.float64), 0.0), (looks.channel.astype(np.float64), 0.0)]
    for name, value, each in zip(names, values.T, width.tolist(), strict=True):
        axes.append((value, 360.0 / each if name == "azimuth" else 0.0))
    group = residuals.look_groups(axes)
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


def _residuals(feed: SensorFeed, pairs: ComparedPlots, chosen: Ints) -> Residuals:
    """What was measured less what was true at the times that plots state."""
    plot, look = pairs.candidates.plot[chosen], pairs.candidates.look[chosen]
    looks = feed.looks.rows(look)
    stamped_ns = looks.t_utc_ns
    if laws.TIME_OF_SENDING not in feed.plots.category:
        told = zip(feed.plots.t_utc_ns[plot].tolist(), stamped_ns.tolist(), strict=True)
        stamped_ns = np.array([true if t is None else t for t, true in told], np.int64)
    place_m, velocity_m_s = _true_states(feed.looks, looks.target, stamped_ns)
    looked_m = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
    as_looked = stamped_ns == looks.t_utc_ns
    place_m[as_looked] = looked_m[as_looked]
    channel = np.maximum(feed.plots.channel[plot], 0)

    def values(place_enu_m: Floats) -> Floats:
        return _place_values(feed.known, place_enu_m, channel)

    step_m = velocity_m_s * STEP_S
    rate = _difference(values(place_m + step_m), values(place_m - step_m))
    return Residuals(
        target=looks.target,
        t_s=looks.t_utc_ns / NS,
        error=pairs.error[chosen] - _difference(values(place_m), values(looked_m)),
        sigma=pairs.sigma[chosen],
        rate=rate / (2 * STEP_S),
        kurtosis=pairs.kurtosis[chosen],
    )


def _true_states(looks: FeedLooks, target: Ints, t_utc_ns: Ints) -> tuple[Floats, Floats]:
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


def simulated_feed(scene: Scene, seen: SimulatedSensor, sectors: int = 0) -> SensorFeed:
    """The feed of a simulated sensor beside its claims, stamped by its own clock.

    Links and formats are left out. `sectors` is of how many it is, empty ones too, where the
    simulation does not tell.
    """
    keys, plots, looks = seen.sensor, seen.plots, seen.looks
    asked = AskedSensor(scene, keys)
    per_scan = keys.scan.sectors
    numbers = np.unique(
        np.concatenate([each.scan * per_scan + each.sector for each in (plots, looks)])
    )
    looks = looks.rows(np.argsort(looks.scan * per_scan + looks.sector, kind="stable"))
    plots = plots.rows(np.argsort(plots.scan * per_scan + plots.sector, kind="stable"))
    # Columns that plots as they are measured and as they are decoded both have.
    told = [name for of, _ in QUANTITIES.values() for name in (of, f"sigma_{of}")]
    held = {name for name in vars(plots) if getattr(plots, name) is not None}
    held &= {*MeasuredPlots.__annotations__}
    carried = ["channel", *(name for name in told if name in held)]
    measured = MeasuredPlots.of([{}] * len(plots)).but(
        t_utc_ns=(plots.t_utc_ns + asked.clock_ahead_ns).astype(np.object_),
        category=np.zeros(len(plots), np.int64),
        **{name: np.ascontiguousarray(getattr(plots, name)) for name in carried},
    )
    emitted_ns = looks.emitted_utc_ns
    return SensorFeed(
        FeedLooks(
            sector=np.searchsorted(numbers, looks.scan * per_scan + looks.sector),
            target=looks.drone,
            counts=np.ones(len(looks), np.bool_),
            emitted_utc_ns=np.zeros(len(looks), np.int64) if emitted_ns is None else emitted_ns,
            **{name: getattr(looks, name) for name in OF_LOOKS},
        ),
        measured,
        np.searchsorted(numbers, plots.scan * per_scan + plots.sector),
        np.zeros(max(len(numbers), 1), np.int64),
        [asked.claimed],
        (sectors or len(seen.sectors)) / per_scan,
        seen.drones,
    )


class Verdicts:
    """All checks of a recording, judged together."""

    def __init__(self, checks: Iterable[Check], against: Against) -> None:
        every = list(checks)
        self.against: Against = against
        self.false_rate = FALSE_RATES[against]  # Share of right ones in which any is called wrong
        wrong = residuals.wrong_at(every, self.false_rate)
        self.checks = [replace(c, wrong=w) for c, w in zip(every, wrong, strict=True)]

    @property
    def wrong(self) -> list[Check]:
        """The checks that fail."""
        return [each for each in self.checks if each.wrong]

    @property
    def judged(self) -> int:
        """How many say anything."""
        return sum(each.is_judged for each in self.checks)

    def as_json(self) -> dict[str, Any]:
        """The verdicts for JSON, what was expected under the name of what it is."""
        return {
            "against": self.against,
            "false_rate": self.false_rate,
            "wrong": [f"{each.sensor}: {each.name}" for each in self.wrong],
            "checks": [check_json(each, self.against) for each in self.checks],
        }


# Of a check, in the order of JSON.
TOLD = ("sensor", "link", "name", "unit", "expected", "found", "sigma", "z", "p", "of", "wrong",
        "why_not")  # fmt: skip


def check_json(check: Check, against: Against) -> dict[str, Any]:
    """A check for JSON."""
    called = {"name": "check", "expected": against}
    told: dict[str, Any] = finite({called.get(n, n): getattr(check, n) for n in TOLD})
    return told
