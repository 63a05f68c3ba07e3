"""Tracks at the steps of a common grid: their last reports, moved on by their own velocities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.state import NS, Bools, Columns, Floats, Ints


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Steps of equal length: the first is at `start_utc_ns`."""

    start_utc_ns: int
    step_ns: int
    steps: int

    @property
    def t_utc_ns(self) -> Ints:
        """Times of all steps, (steps,)."""
        return self.start_utc_ns + self.step_ns * np.arange(self.steps, dtype=np.int64)

    def at_or_after(self, t_utc_ns: Ints) -> Ints:
        """The first steps that are not before times."""
        return -((self.start_utc_ns - t_utc_ns) // self.step_ns)


@dataclass(frozen=True, kw_only=True)
class TrackReports(Columns):
    """What a tracker reported, a row a report, (n,), by track and time.

    Points and rates (n, 4) are those of `ground`; a rate is NaN where no velocity was told.
    """

    t_utc_ns: Ints
    """For which it holds."""
    known_utc_ns: Ints
    """When it was received; the time for which it holds where that is not known."""
    track: Ints
    """From 0."""
    point: Floats
    rate: Floats
    ended: Bools
    """The track ends with it."""


@dataclass(frozen=True, kw_only=True)
class GridRows(Columns):
    """Tracks at steps: which report says so, (n,), and where they are by it; by step."""

    step: Ints
    track: Ints
    report: Ints
    point: Floats
    age_s: Floats


def on_grid(reports: TrackReports, grid: Grid, stale_s: float, *, as_known: bool) -> GridRows:
    """Every track at every step at which its last report is not older than `stale_s`.

    `as_known` asks for what was known at the step's own time: a report counts from when it was
    received, and one that a later one has overtaken never counts. Else it counts from the time
    that it is of. Reports are by track, and by time within it.
    """
    rows = np.arange(len(reports))
    begin_ns = reports.known_utc_ns if as_known else reports.t_utc_ns
    if as_known:
        order = np.lexsort((reports.t_utc_ns, begin_ns, reports.track))
        rows = order[~_overtaken(reports.track[order], reports.t_utc_ns[order])]
        begin_ns = begin_ns[rows]
    track, t_ns = reports.track[rows], reports.t_utc_ns[rows]
    first = np.maximum(grid.at_or_after(begin_ns), 0)
    following = np.full(len(rows), grid.steps)
    if len(rows):
        following[:-1] = np.where(track[1:] == track[:-1], first[1:], grid.steps)
    oldest = (t_ns + round(stale_s * NS) - grid.start_utc_ns) // grid.step_ns + 1
    last = np.where(reports.ended[rows], first, np.minimum(following, oldest))
    many = np.clip(np.minimum(last, grid.steps) - first, 0, None)
    which = np.repeat(np.arange(len(rows)), many)
    starts = np.concatenate([[0], np.cumsum(many)[:-1]]) if len(many) else many
    step = first[which] + np.arange(len(which)) - starts[which]
    by_step = np.lexsort((track[which], step))
    which, step = which[by_step], step[by_step]
    report = rows[which]
    age_s = (grid.start_utc_ns + step * grid.step_ns - t_ns[which]) / NS
    moved = np.nan_to_num(reports.rate[report]) * age_s[:, None]
    return GridRows(
        step=step,
        track=track[which],
        report=report,
        point=reports.point[report] + moved,
        age_s=age_s,
    )


def _overtaken(track: Ints, t_utc_ns: Ints) -> Bools:
    """Which rows, by track and then by when they came, are of a time before an earlier one's."""
    if not len(track):
        return np.zeros(0, np.bool_)
    # Times are made to rise from track to track, so that one running maximum serves them all.
    span = int(np.ptp(t_utc_ns)) + 1
    number = np.zeros(len(track), np.int64)
    number[1:] = np.cumsum(np.diff(track) != 0)
    raised = (t_utc_ns - t_utc_ns.min()).astype(np.float64) + number * float(span)
    latest = np.maximum.accumulate(raised)
    found = np.zeros(len(track), np.bool_)
    found[1:] = np.less(raised[1:], latest[:-1])
    return found


def rates_by_differences(
    track: Ints, t_utc_ns: Ints, point: Floats, rate: Floats, longest_s: float
) -> Floats:
    """Rates (n, 4), with those between a track's last two reports where none was told.

    Rows are by track and time; of the first, and after `longest_s` without any, it stays unknown.
    """
    missing: Bools = np.asarray(np.isnan(rate).any(axis=1))
    if not missing.any() or len(track) < 2:
        return rate
    span_s = np.diff(t_utc_ns) / NS
    good = (track[1:] == track[:-1]) & (span_s > 0) & (span_s <= longest_s)
    slopes = np.diff(point, axis=0) / np.where(good, span_s, np.nan)[:, None]
    found = rate.copy()
    found[1:][missing[1:]] = slopes[missing[1:]]
    return found
