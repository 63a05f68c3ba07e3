"""A recorded flight, the options of reading one, and the log that readers fill."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

from plotfeed.feeds.flights.plausibility import implausible
from plotfeed.feeds.report import NS, AltitudeReference, Refused, Report, check
from plotfeed.proto.errors import PlotfeedError

MAX_OCTETS = 256 * 1024 * 1024
MAX_SKIPPED = 10_000
"""Lines kept on records that were not taken; the rest are only counted."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


GpsOrder = Literal["lat-lon", "lon-lat"]
"""Which coordinate `GPS(...)` in a DJI subtitle names first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightOptions:
    """What a file does not say of itself."""

    columns: Mapping[str, str] = field(default_factory=dict)
    """Quantity to column of a table, such as latitude_deg to "lat"."""
    altitude_reference: AltitudeReference | None = None
    gps_order: GpsOrder | None = None
    utc_offset_h: float = 0.0
    """Of times without a time zone, hours east of UTC."""
    start_utc_ns: int | None = None
    """Time of the start of a subtitle file that carries no dates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """One drone's reports in strictly increasing time."""

    name: str
    reports: tuple[Report, ...]
    skipped: tuple[str, ...] = ()
    """A line for each record that was not taken: where it stands, and why."""
    assumed: tuple[str, ...] = ()
    """A line for each thing that the file did not say and that was taken for granted."""

    @property
    def duration_s(self) -> float:
        """From the first report to the last."""
        return (self.reports[-1].t_utc_ns - self.reports[0].t_utc_ns) / NS


@dataclass(slots=True)
class Log:
    """What a reader has found so far."""

    found: list[tuple[str, Report]] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
    more_skipped: int = 0

    def take(self, where: str, **values: Any) -> None:
        """A record at `where`, with the fields of a report; skipped if a value is out of range."""
        report = Report(**values)
        try:
            check(report)
        except Refused as refused:
            self.skip(where, refused.detail)
        else:
            self.found.append((where, report))

    def skip(self, where: str, why: str) -> None:
        """A record at `where` that is not taken."""
        if len(self.skipped) < MAX_SKIPPED:
            self.skipped.append(" ".join(f"{where}: {why}".split()))
        else:
            self.more_skipped += 1

    def assume(self, what: str) -> None:
        """Something that the file does not say; told once."""
        if what not in self.assumed:
            self.assumed.append(what)

    def flight(self, name: str) -> Flight:
        """The records that follow each other in time and could have been flown."""
        in_order = self._in_order()
        reports = [report for _, report in in_order]
        refused = implausible(reports)
        for i, why in sorted(refused.items()):
            self.skip(in_order[i][0], why)
        taken = tuple(r for i, r in enumerate(reports) if i not in refused)
        if not taken:
            why = f"; the first problem: {self.skipped[0]}" if self.skipped else ""
            raise PlotfeedError(f"no position in this file{why}")
        more = (f"and {self.more_skipped} more",) if self.more_skipped else ()
        return Flight(
            name=name,
            reports=taken,
            skipped=(*self.skipped, *more),
            assumed=tuple(self.assumed),
        )

    def _in_order(self) -> list[tuple[str, Report]]:
        """The most records that can be had in strictly increasing time; others are skipped.

        A single wrong clock reading, early or late, so costs no more than its own record.
        """
        kept = longest_increasing([report.t_utc_ns for _, report in self.found])
        times = {self.found[i][1].t_utc_ns for i in kept}
        for i in sorted(set(range(len(self.found))).difference(kept)):
            where, report = self.found[i]
            again = report.t_utc_ns in times
            self.skip(where, "same time as another" if again else "out of the order of time")
        return [self.found[i] for i in kept]


def longest_increasing(times: Sequence[int]) -> list[int]:
    """Indices of a longest strictly increasing subsequence; of equal times the first.

    Patience sorting: `ends[k]` is the index of the smallest time that can end k + 1 of them.
    """
    ends: list[int] = []
    end_times: list[int] = []
    before = [-1] * len(times)
    for i, time in enumerate(times):
        k = bisect_left(end_times, time)
        before[i] = ends[k - 1] if k else -1
        if k == len(ends):
            ends.append(i)
            end_times.append(time)
        elif time < end_times[k]:
            ends[k], end_times[k] = i, time
    chosen: list[int] = []
    i = ends[-1] if ends else -1
    while i >= 0:
        chosen.append(i)
        i = before[i]
    return chosen[::-1]


def utc_ns(when: datetime, utc_offset_h: float) -> int:
    """Nanoseconds of UTC since 1970; a time without a zone is that many hours ahead of UTC."""
    if when.tzinfo is None:
        return _whole_ns(when.replace(tzinfo=UTC) - _EPOCH) - round(utc_offset_h * 3600 * NS)
    return _whole_ns(when - _EPOCH)


def _whole_ns(since: timedelta) -> int:
    return (since // timedelta(microseconds=1)) * 1000
