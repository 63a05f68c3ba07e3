"""The judge of feeds: what came of sensors beside what is expected of them, named and with a risk.

Against what was *asked* a sensor is to be as the scene has it, biases, drifts and degradations
among that. Against what it *claims* it is to be as it takes itself to be, at the times that its
plots state. The ledger says whose plot is whose.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np

from plotfeed.feeds.console.printed import finite
from plotfeed.feeds.engine.simulation import SimulatedSensor
from plotfeed.feeds.lab import laws, oracle
from plotfeed.feeds.lab.evidence import RADARS, AskedSensor
from plotfeed.feeds.lab.laws import QUANTITIES
from plotfeed.feeds.recording.recorded_plots import are_targets, names_of
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models import residuals
from plotfeed.models.frames import LocalFrame, aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.residuals import Check, LookOdds, PdFigures, Residuals, pd_by_range
from plotfeed.models.sensors.electronic_radar import SEARCH
from plotfeed.models.state import Bools, Floats, Ints, Texts
from plotfeed.models.tail_chances import p_of_normal
from plotfeed.models.track_metrics import FlightPath
from plotfeed.proto.ledger import ToldLooks, ToldPlots, ledger_octets, tables_of, truth_columns
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.utc import NS

Against = Literal["asked", "claimed"]
# Share of right recordings, all their sensors together, in which anything is called wrong.
FALSE_RATES: Mapping[Against, float] = {"asked": 1e-3, "claimed": 1e-2}
NAMES = [*QUANTITIES]
# Heights are told by elevation and range, so that their noise is that of these.
MEASURED = [
    residuals.MeasuredQuantity(n, unit, n == "height") for n, (_, unit) in QUANTITIES.items()
]
# What claims are said not to be judged of, where no plot can be compared.
CLAIMED = ("azimuth", "range", "bistatic range", "elevation", "time")
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
# Plots from which on it is judged what they state of their errors, and by how much variances may
# differ from what is expected to be the same: their mean over few plots is not normal.
FEWEST_SIGMAS, SAME_SIGMA = 20, 0.2
# Stated variances over expected ones count as no more than this, however wild what is stated.
MOST_OFF = 1e12
# By how much joined places may be off, as errors are known to first order: in sigmas, seconds,
# and shares of their spread, below it and above, as parts of the detections make some of them.
JOINED_OFF, JOINED_LATE_S, JOINED_SPREAD = 0.25, 0.25, (0.15, 0.7)
NOT_AS_STATED = "its plots do not err by the spread that they state"


class SensorFeed(NamedTuple):
    """What came of a sensor in some sectors, with numbers from 0, and what is expected of it."""

    looks: ToldLooks  # In the order of sectors, whose numbers stand in place of entries'
    truths: ToldPlots  # What is true of plots, likewise
    plots: MeasuredPlots  # Plots as they came, in the order of what is true of them
    came: Bools  # Which of the truths those are of
    keys_of_sector: Ints  # Which of `expected` holds in each sector
    # None where no scene says what is expected, but the plots.
    expected: Sequence[AskedSensor | None]
    scans: float  # That were seen, parts of one counted as such

    @property
    def known(self) -> AskedSensor | None:
        """The sensor as its scene first has it; None where none says."""
        return next((each for each in self.expected if each is not None), None)


class LooksExpected(NamedTuple):
    """What is expected of looks, (n,)."""

    odds: LookOdds
    counts: Bools  # Of which Pd is known
    sigmas: Floats  # What plots of them are to state of their errors, (k, n); NaN if not known
    joined: Floats | None  # As `laws.compared` asks, a row a look


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
        self.left, self.alarms, self.scans = 0, 0.0, 0.0
        # Of which it is not known what Pd is expected, and why.
        self.unjudged, self.why_not_pd = 0, ""
        self._against: Against = against
        self._no_time = "asked of each plot" if against == "asked" else ""
        self._why_not = "no plots came"
        self._why_no_alarms = "it is not known how many are expected"
        # Number, sum and sum of squares of stated variances over expected ones.
        self._sigmas = np.zeros((len(NAMES), 3))
        self._are_joined = False  # Whether plots are places that several detections make
        self._bins: list[PdFigures] | None = None  # As far as they are worked out already

    @np.errstate(all="ignore")  # whatever numbers others have recorded
    def take(self, feed: SensorFeed) -> None:
        """Take sectors."""
        self._bins = None
        looks, names, look_names = feed.looks, names_of(feed.truths), names_of(feed.looks)
        numbers: dict[str, int] = {}
        whose, target = (
            np.array([numbers.setdefault(name, len(numbers)) for name in each.tolist()], np.int64)
            for each in (names, look_names)
        )
        self._take_false_alarms(feed, int((names == "").sum()))
        expected = self._odds(feed, look_names, target)
        counts = expected.counts
        self.looks.add(expected.odds.rows(counts), looks.range_m[counts])
        is_target = are_targets(names)
        own, plots = is_target & feed.came, feed.plots.rows(is_target[feed.came])
        truths, whose, n = feed.truths.rows(own), whose[own], len(plots)
        if len(feed.plots):
            is_known = feed.known is None or feed.known.errs_as_known
            self._why_not = "" if is_known else NOT_AS_STATED
        if not n:
            return
        self.joined += n
        keys = feed.keys_of_sector[truths.entry]
        alone = np.flatnonzero([not others for others in truths.merged_drones])
        found, row = _rows_in(
            (truths.entry[alone], whose[alone], np.maximum(plots.channel[alone], 0)),
            (looks.entry, target, looks.channel),
        )
        alone = alone[found]
        sigmas, joined = expected.sigmas[:, row], None
        if expected.joined is not None:
            joined = np.full((n, *expected.joined.shape[1:]), np.nan)
            joined[alone] = expected.joined[row]
            _, place, times = np.unique(
                np.stack([truths.entry, whose]), axis=1, return_inverse=True, return_counts=True
            )
            is_part = times[place.reshape(-1)] > 1  # Made of some of its detections each
            joined[is_part] = np.nan
            sigmas[:, is_part[alone]] = np.nan
        self._take_sigmas(feed.expected, plots.rows(alone), keys[alone], sigmas)
        echoes = _echoes(looks, target, truths, whose, numbers)
        error, sigma, kurtosis = np.full((3, n, len(NAMES)), np.nan)
        for which, category in {*zip(keys.tolist(), plots.category.tolist(), strict=True)}:
            rows = np.flatnonzero((keys == which) & (plots.category == category))
            anew = np.full(n, -1)
            anew[rows] = np.arange(len(rows))
            mine = echoes.but(entry=anew[echoes.entry]).rows(anew[echoes.entry] >= 0)
            of_joined = None if joined is None else joined[rows]
            of_these = mine, truths.rows(rows), plots.rows(rows), of_joined
            compared = laws.compared(feed.expected[which], *of_these)
            error[rows], sigma[rows] = self._judged(compared)
            kurtosis[rows] = compared.kurtosis
        errors = Residuals(
            # Of each plot anew: nothing hangs together with what came before.
            target=np.arange(n),
            t_s=np.zeros(n),
            error=error,
            sigma=sigma,
            rate=np.zeros_like(error),
            kurtosis=kurtosis,
        )
        if self._against == "claimed":
            errors = _at_stated_times(errors.but(target=whose), feed, target, truths, plots)
            if laws.TIME_OF_SENDING in plots.category:
                self._no_time = "its times are those of sending"
        self.errors.add(errors)

    def _take_false_alarms(self, feed: SensorFeed, count: int) -> None:
        """Take how many there were, and how many are expected in those sectors."""
        self.left += count
        self.scans += feed.scans
        per_scan = np.array([np.nan if e is None else e.false_alarms[0] for e in feed.expected])
        for each in feed.expected:
            if each is not None and each.false_alarms[1]:
                self._why_no_alarms = f"not known here: {each.false_alarms[1]}"
        of_sectors = per_scan[feed.keys_of_sector]
        self.alarms += float(of_sectors.sum()) * feed.scans / max(len(of_sectors), 1)

    def _odds(self, feed: SensorFeed, names: Texts, target: Ints) -> LooksExpected:
        """What is expected of looks; where nobody says what, Pd is that of the ledger."""
        looks, n = feed.looks, len(feed.looks)
        pd, counts, sigmas = looks.pd.copy(), np.ones(n, np.bool_), np.full((len(NAMES), n), np.nan)
        off, keys = np.zeros(n), feed.keys_of_sector[looks.entry]
        joined: Floats | None = None
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
                    drone=names[rows],
                    channel=of.channel,
                    emitted_utc_ns=of.emitted_utc_ns if of.emitted_utc_ns.any() else None,
                    field_deg=_fields_deg(feed, of.entry, expected.keys),
                    detected=of.detected,
                )
            )
            pd[rows] = np.where(found.known, found.pd, pd[rows])
            counts[rows] = found.known
            off[rows] = found.pd_off
            self.unjudged += int((~found.known).sum())
            self.why_not_pd = self.why_not_pd or found.why_not
            for name in ("range", "azimuth", "elevation"):
                sigma = getattr(found, f"sigma_{QUANTITIES[name][0]}") / expected.error_factor
                sigmas[NAMES.index(name), rows] = np.where(found.known, sigma, np.nan)
            if found.joined is not None:
                self._are_joined = True
                joined = np.full((n, 3, len(laws.JOINED)), np.nan) if joined is None else joined
                joined[rows] = found.joined.law
                for name, column in zip(laws.JOINED, found.joined.stated.T, strict=True):
                    sigmas[NAMES.index(name), rows] = column
        t_s = looks.t_utc_ns / NS
        odds = LookOdds(target=target, t_s=t_s, pd=pd, hit=looks.detected, off=off)
        return LooksExpected(odds, counts, sigmas, joined)

    def _take_sigmas(
        self,
        sensors: Sequence[AskedSensor | None],
        plots: MeasuredPlots,
        keys: Ints,
        expected: Floats,
    ) -> None:
        """Count what plots state of their errors over what they are to, (k, n).

        A radar's follow from the ratio that each tells; what is told in coarse steps is left out.
        """
        exact = plots.category == 0
        for number in np.unique(keys[exact]).tolist():
            sensor, rows = sensors[number], np.flatnonzero(exact & (keys == number))
            if sensor is None or not sensor.errs_as_known:
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

    def _judged(self, found: laws.Comparison) -> tuple[Floats, Floats]:
        """Errors that are to be judged, NaN for others, and their standard deviations."""
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
        return error, sigma

    def checks(self) -> list[Check]:
        """All that is expected, checked; with why what cannot be checked is not."""
        told: dict[str, Any]
        is_asked = self._against == "asked"
        found = self.errors.checks(self._no_time)
        if self._are_joined:
            found = [self._hardly_off(check) for check in found]
        if is_asked:
            found = [c for c in found if c.name != "time"] if self.joined else []
            found += [never(f"{q} outliers", n, self.joined) for q, n in self.off.items()]
            found.append(never("time", self.times_off, self.joined))
        elif not self.errors.count.any():
            why = self._why_not
            found = [replace(c, why_not=why or c.why_not) for c in found if c.name in CLAIMED]
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
        if not pd.is_judged and self.why_not_pd:
            pd = replace(pd, why_not=f"not known here: {self.why_not_pd}")
        found.append(pd)
        bins = self.by_range() if is_asked else []
        for at in bins if len(bins) > 1 else ():
            name, half = f"Pd {at.from_m / 1000:.2f}-{at.to_m / 1000:.2f} km", at.high - at.low
            told = {"found": at.found, "sigma": half / (2 * 1.96), "of": at.looks}
            found.append(Check(name=name, expected=at.expected, p=at.p, **told))
        why = self._why_no_alarms if math.isnan(self.alarms) else ""
        return [*found, residuals.clutter_check(self.left, self.alarms, self.scans, why)]

    def _hardly_off(self, check: Check) -> Check:
        """A check of errors that are known to first order: it holds where they are hardly off."""
        if not check.is_judged:
            return check
        most = JOINED_LATE_S if check.name == "time" else JOINED_SPREAD[check.found > 1]
        if check.expected == 0 and check.name != "time":
            k = NAMES.index(check.name.removesuffix(" or time"))
            most = JOINED_OFF * self.errors.usual_sigma(k)
        beyond = max(abs(check.found - check.expected) - most, 0.0)
        return replace(check, p=p_of_normal(beyond / check.sigma))

    def by_range(self) -> list[PdFigures]:
        """Looks of at most `MAX_BINS` equal bins over the ranges looked at; none is empty."""
        if self._bins is None:
            self._bins = pd_by_range(self.looks.tally)
        return self._bins


def _fields_deg(feed: SensorFeed, sector: Ints, keys: Any) -> Floats | None:
    """Fields of view in those frames, of a camera that zooms: as plots before and after tell alike.

    Not by plots of the frame itself, as there are more where more was detected; (n,), NaN if
    unknown.
    """
    exact = np.flatnonzero(feed.plots.category == 0)
    if not oracle.zooms(keys) or not len(exact):
        return None
    told_deg = oracle.field_of_view_deg(keys, feed.plots.sigma_elevation_deg[exact])
    at, t_ns = feed.truths.entry[feed.came][exact], feed.plots.t_utc_ns[exact].astype(np.int64)
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


def _echoes(
    looks: ToldLooks, target: Ints, truths: ToldPlots, whose: Ints, numbers: Mapping[str, int]
) -> ToldLooks:
    """The looks of which plots are, each with the number of its plot in place of an entry's.

    A plot in which several echoes merged has those at each of its drones.
    """
    is_merged = np.array([bool(others) for others in truths.merged_drones], np.bool_)
    alone = np.flatnonzero(~is_merged)
    of_plots = (truths.entry[alone], whose[alone], truths.t_utc_ns[alone])
    found, row = _rows_in(of_plots, (looks.entry, target, looks.t_utc_ns))
    plot, look = [alone[found]], [row]
    for n in np.flatnonzero(is_merged).tolist():
        first, end = np.searchsorted(looks.entry, [truths.entry[n], truths.entry[n] + 1])
        for drone in (whose[n], *(numbers.get(name, -1) for name in truths.merged_drones[n])):
            look.append(first + np.flatnonzero(target[first:end] == drone))
            plot.append(np.full(len(look[-1]), n))
    plots, rows = np.concatenate(plot), np.concatenate(look)
    order = np.argsort(plots, kind="stable")
    columns = {name: column[rows[order]] for name, column in vars(looks).items()}
    return ToldLooks.holding(columns | {"entry": plots[order]})


def _at_stated_times(
    errors: Residuals, feed: SensorFeed, target: Ints, truths: ToldPlots, plots: MeasuredPlots
) -> Residuals:
    """Errors about where targets were at the times that plots state, and how fast that changed."""
    true_ns = stated_ns = truths.t_utc_ns
    if laws.TIME_OF_SENDING not in plots.category:
        told = zip(plots.t_utc_ns.tolist(), true_ns.tolist(), strict=True)
        stated_ns = np.array([true if t is None else t for t, true in told], np.int64)
    channel = np.maximum(plots.channel, 0)

    def values(place_enu_m: Floats) -> Floats:
        return _place_values(feed.known, place_enu_m, channel)

    looks = feed.looks
    if feed.known is not None and feed.known.is_steered:
        # What searches tells a place of another time of its dwell, which is a wrong speed between
        # looks that are a millisecond apart.
        kept = np.flatnonzero(looks.channel != SEARCH)
        looks, target = looks.rows(kept), target[kept]
    looked_m, _ = _true_states(looks, target, errors.target, true_ns)
    place_m, velocity_m_s = _true_states(looks, target, errors.target, stated_ns)
    moved = _difference(values(place_m), values(looked_m))
    moved[stated_ns == true_ns] = 0.0
    # What others follow from, or what is not known at other times.
    for name in ("range rate", *["range"] * (feed.known is not None and feed.known.is_bistatic)):
        moved[:, NAMES.index(name)] = np.nan
    step_m = velocity_m_s * STEP_S
    rate = _difference(values(place_m + step_m), values(place_m - step_m)) / (2 * STEP_S)
    return errors.but(t_s=true_ns / NS, error=errors.error - moved, rate=rate)


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


def _true_states(
    looks: ToldLooks, target: Ints, whose: Ints, t_utc_ns: Ints
) -> tuple[Floats, Floats]:
    """Places of targets at times and their velocities, east, north and up; (n, 3), NaN if unknown.

    By where they were when they were looked at.
    """
    order = np.lexsort((looks.t_utc_ns, target))
    looks, target = looks.rows(order), target[order]
    ecef_m = ANYWHERE.to_ecef(aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m))
    between_ns = np.diff(looks.t_utc_ns)
    between_ns = between_ns[(np.diff(target) == 0) & (between_ns > 0)]
    gap_ns = round(LONGEST_GAP * float(np.median(between_ns))) if len(between_ns) else 0
    place_m, velocity_m_s = (np.full((len(whose), 3), np.nan) for _ in range(2))
    for each in np.unique(whose).tolist():
        first, end = np.searchsorted(target, [each, each + 1])
        path = FlightPath.of(looks.t_utc_ns[first:end], ecef_m[first:end], gap_ns)
        rows = np.flatnonzero(whose == each)
        place, velocity = path.states_at(t_utc_ns[rows])
        place_m[rows] = ANYWHERE.from_ecef(place)
        velocity_m_s[rows] = ANYWHERE.rotate_from_ecef(velocity)
    return place_m, velocity_m_s


def simulated_feed(scene: Scene, seen: SimulatedSensor, sectors: int = 0) -> SensorFeed:
    """The feed of a simulated sensor beside its claims, stamped by its own clock.

    Links and formats are left out. `sectors` is of how many it is, empty ones too, where the
    simulation does not tell.
    """
    asked, per_scan = AskedSensor(scene, seen.sensor), seen.sensor.scan.sectors
    looks = seen.looks.rows(np.lexsort((seen.looks.sector, seen.looks.scan)))
    plots = seen.plots.rows(np.lexsort((seen.plots.sector, seen.plots.scan)))
    of_looks, of_plots = (each.scan * per_scan + each.sector for each in (looks, plots))
    numbers = np.unique(np.concatenate([of_looks, of_plots]))
    targets, parts = truth_columns(looks, plots, seen.drones)
    parts["sectors"] = {
        **dict.fromkeys(("sensor", "link"), np.full(len(numbers), -1)),
        "looks_end": np.searchsorted(of_looks, numbers, side="right"),
        "plots_end": np.searchsorted(of_plots, numbers, side="right"),
    }
    told = tables_of([ledger_octets({"targets": targets}, parts, ())])
    # Columns that plots as they are measured and as they are decoded both have.
    carried = ["channel", *(n for of, _ in QUANTITIES.values() for n in (of, f"sigma_{of}"))]
    measured = MeasuredPlots.of([{}] * len(plots)).but(
        t_utc_ns=(plots.t_utc_ns + asked.clock_ahead_ns).astype(np.object_),
        **{n: np.ascontiguousarray(getattr(plots, n)) for n in carried if plots.measures(n)},
    )
    return SensorFeed(
        looks=told.looks,
        truths=told.plots,
        plots=measured,
        came=np.ones(len(plots), np.bool_),
        keys_of_sector=np.zeros(max(len(numbers), 1), np.int64),
        expected=[asked.claimed],
        scans=(sectors or len(seen.sectors)) / per_scan,
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
