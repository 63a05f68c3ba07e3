"""What of a tracker's reports can be scored; what cannot is counted, and told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from plotfeed.feeds.score.track_table import UNKNOWN_NS, ReportedTracks, TracksRead
from plotfeed.models.scoring.ground import GROUND, Level, rates
from plotfeed.models.scoring.track_grid import TrackReports, rates_by_differences
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.proto.utc import NS

FORGOTTEN_S = 60.0
"""A number that is silent for so long is another track's when it comes again."""
HIGHEST_M, FASTEST_M_S = 1e5, 1e4
"""Heights and velocities beyond these are not taken for any."""
KEPT_S = 10.0
"""Over which a velocity that is not told is taken from two reports."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UsableTracks:
    """Reports that can be scored, (n,), by track and time."""

    reports: TrackReports
    names: Sequence[str]
    """Of tracks. A number that was ended, or silent for a minute, is another track's after that."""
    velocity_enu_m_s: Floats
    covariance_m2: Floats
    leaps: Bools
    """Reports to which nothing flies from the one before: the number is in two places."""
    has_received: bool
    """Whether it is known when reports were received."""
    has_heights: bool
    """Whether all tell a height."""
    counts: Mapping[str, int]
    """Reports that were left out, or are odd, by the reason."""

    @property
    def latency_s(self) -> Floats:
        """Seconds from the time of a report to when it was received; NaN if unknown, (n,)."""
        late_s = (self.reports.known_utc_ns - self.reports.t_utc_ns) / NS
        return late_s if self.has_received else np.full(len(late_s), np.nan)


def usable_tracks(
    read: TracksRead,
    span_utc_ns: tuple[int, int],
    level: Level,
    *,
    future_s: float,
    max_speed_m_s: float,
    counts_tentative: bool,
) -> UsableTracks:
    """Sort reports, and sort out those that cannot be: of a run from the first time to the last.

    Of several with one number and time the last one counts. Reports of a time later than that at
    which they were received are of the future.
    """
    told, counts = read.reports, dict(read.unreadable)
    future_ns = round(future_s * NS)
    has_received = bool(len(told)) and bool((told.received_utc_ns != UNKNOWN_NS).all())
    kept = np.ones(len(told), np.bool_)
    for reason, wrong in (
        ("without a time", told.t_utc_ns == UNKNOWN_NS),
        ("not a place on Earth", ~_is_place(told)),
        ("of the future", has_received & (told.t_utc_ns - future_ns > told.received_utc_ns)),
        ("after the run", told.t_utc_ns - future_ns > span_utc_ns[1]),
        ("before the run", told.t_utc_ns + future_ns < span_utc_ns[0]),
        ("tentative", told.tentative & (not counts_tentative)),
    ):
        _count(counts, reason, int(np.count_nonzero(kept & wrong)))
        kept &= ~wrong
    came = np.flatnonzero(kept)
    if has_received:
        came = came[np.argsort(told.received_utc_ns[came], kind="stable")]
    _count(counts, "out of order", _out_of_order(told.track[came], told.t_utc_ns[came]))
    order = came[np.lexsort((np.arange(len(came)), told.t_utc_ns[came], told.track[came]))]
    same = (np.diff(told.track[order]) == 0) & (np.diff(told.t_utc_ns[order]) == 0)
    _count(counts, "repeated, of which the last counts", int(np.count_nonzero(same)))
    rows = told.rows(order[np.append(~same, True)] if len(order) else order)
    return _placed(rows, read.names, level, counts, max_speed_m_s, has_received=has_received)


def _count(counts: dict[str, int], reason: str, many: int) -> None:
    if many:
        counts[reason] = counts.get(reason, 0) + many


def _is_place(told: ReportedTracks) -> Bools:
    with np.errstate(invalid="ignore"):
        on_earth = (np.abs(told.latitude_deg) <= 90.0) & (np.abs(told.longitude_deg) <= 180.0)
        return on_earth & (np.isnan(told.height_m) | (np.abs(told.height_m) <= HIGHEST_M))


def _out_of_order(track: Ints, t_utc_ns: Ints) -> int:
    """How many came after a later one of their track."""
    by_track = np.argsort(track, kind="stable")
    number, times = track[by_track], t_utc_ns[by_track]
    late = (np.diff(number) == 0) & (np.diff(times) < 0)
    return int(np.count_nonzero(late))


def _placed(
    rows: ReportedTracks,
    names: Sequence[str],
    level: Level,
    counts: dict[str, int],
    max_speed_m_s: float,
    *,
    has_received: bool,
) -> UsableTracks:
    """Reports as points, with the numbers of their tracks anew."""
    place = (rows.latitude_deg, rows.longitude_deg)
    with np.errstate(invalid="ignore"):
        is_velocity = np.abs(rows.velocity_enu_m_s) <= FASTEST_M_S
    velocity = np.where(is_velocity, rows.velocity_enu_m_s, np.nan)
    point = level.points(*place, rows.height_m)
    same = np.diff(rows.track) == 0
    span_s = np.diff(rows.t_utc_ns) / NS
    begins = np.ones(len(rows), np.bool_)
    begins[1:] = ~same | rows.ended[:-1] | (span_s > FORGOTTEN_S)
    track = np.cumsum(begins) - 1
    apart_m = np.sqrt((np.diff(point[:, :GROUND], axis=0) ** 2).sum(axis=1))
    leaps = np.zeros(len(rows), np.bool_)
    leaps[1:] = ~begins[1:] & (apart_m > max_speed_m_s * span_s)
    _count(counts, "in two places at once", int(np.count_nonzero(leaps)))
    rate = rates_by_differences(track, rows.t_utc_ns, point, rates(*place, velocity), KEPT_S)
    reports = TrackReports(
        t_utc_ns=rows.t_utc_ns,
        known_utc_ns=rows.received_utc_ns if has_received else rows.t_utc_ns,
        track=track,
        point=point,
        rate=rate,
        ended=rows.ended,
    )
    return UsableTracks(
        reports=reports,
        names=_names([names[i] for i in rows.track[begins].tolist()]),
        velocity_enu_m_s=velocity,
        covariance_m2=rows.covariance_m2,
        leaps=leaps,
        has_received=has_received,
        has_heights=bool(len(rows)) and bool(np.isfinite(rows.height_m).all()),
        counts=counts,
    )


def _names(numbers: Sequence[str]) -> list[str]:
    """Names of tracks: those that have a number again say so."""
    seen: dict[str, int] = {}
    found = []
    for name in numbers:
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found
