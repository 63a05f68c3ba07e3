"""A recorded flight, the options of reading one, and which of its records can be flown."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from math import dist
from typing import Any, Literal

import numpy as np

from plotfeed.feeds.telemetry.admission import CONFIRM_NS, CONFIRM_REPORTS, MAX_SPEED_M_S, reach_m
from plotfeed.feeds.telemetry.foreign_files import FILE_LIMITS
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused, check
from plotfeed.models.frames import geodetic_to_ecef
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

MOST = FILE_LIMITS["other flight"].count
MAX_SKIPPED = 10_000  # Lines kept on records that were not taken; the rest are only counted
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MAX_CHAINS = 16


# Which coordinate `GPS(...)` in a DJI subtitle names first.
GpsOrder = Literal["lat-lon", "lon-lat"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightOptions:
    """What a file does not say of itself."""

    # Quantity to column of a table, such as latitude_deg to "lat".
    columns: Mapping[str, str] = field(default_factory=dict)
    altitude_reference: AltitudeReference | None = None
    gps_order: GpsOrder | None = None
    utc_offset_h: float = 0.0  # Of times without a time zone, hours east of UTC
    start_utc_ns: int | None = None  # Time of the start of a subtitle file that carries no dates
    max_speed_m_s: float = MAX_SPEED_M_S  # What cannot have been flown to at this speed is skipped
    # Of a flight whose file has no heights: above take-off, unless the reference says otherwise.
    height_m: float | None = None

    @property
    def stated_height(self) -> tuple[float, AltitudeReference] | None:
        """The height of a file without any, and what it is above."""
        if self.height_m is None:
            return None
        return self.height_m, self.altitude_reference or AltitudeReference.ABOVE_TAKEOFF


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """One drone's reports in strictly increasing time."""

    name: str
    reports: tuple[PositionReport, ...]
    # A line for each record that was not taken: where it stands, and why.
    skipped: tuple[str, ...] = ()
    # A line for each thing that the file did not say and that was taken for granted.
    assumed: tuple[str, ...] = ()
    starts: tuple[int, ...] = ()  # Indices of reports to which no flight leads from those before
    # A line for each thing that the file says of itself: columns, units, references.
    stated: tuple[str, ...] = ()
    # How many records were not taken, by why, without their numbers.
    dropped: Mapping[str, int] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """Seconds from the first report to the last."""
        return (self.reports[-1].t_utc_ns - self.reports[0].t_utc_ns) / NS


@dataclass(slots=True)
class Log:
    """What a reader has found so far."""

    found: list[tuple[str, PositionReport]] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
    more_skipped: int = 0
    stated: list[str] = field(default_factory=list)
    dropped: Counter[str] = field(default_factory=Counter)

    def take(
        self,
        where: str,
        t_utc_ns: int,
        place: tuple[float, float],
        height: tuple[float, AltitudeReference],
        **more: Any,
    ) -> None:
        """A record at `where`: latitude and longitude, altitude and above what, other fields.

        Skipped if a value is out of range.
        """
        if len(self.found) >= MOST:
            raise PlotfeedError(f"more than {MOST} records, the most that are read")
        if not any(place):
            self.skip(where, "position 0, 0: no GPS fix")
            return
        report = PositionReport(
            t_utc_ns=t_utc_ns,
            latitude_deg=place[0],
            longitude_deg=place[1],
            altitude_m=height[0],
            altitude_reference=height[1],
            **more,
        )
        try:
            check(report)
        except Refused as refused:
            self.skip(where, refused.detail)
        else:
            self.found.append((where, report))

    def skip(self, where: str, why: str) -> None:
        """A record at `where` that is not taken."""
        # By the reason without its numbers and quotations, in a few words.
        plain = re.sub(r"'[^']*'|-?\d+(\.\d+)?(e[+-]?\d+)?", "…", why)
        self.dropped[" ".join(re.split(r"[;(]", plain)[0].split())[:60] or "unknown"] += 1
        if len(self.skipped) < MAX_SKIPPED:
            self.skipped.append(" ".join(f"{where}: {why}".split()))
        else:
            self.more_skipped += 1

    def assume(self, what: str) -> None:
        """Something that the file does not say; told once."""
        if what not in self.assumed:
            self.assumed.append(what)

    def state(self, what: str) -> None:
        """Something that the file says of itself, and how it was understood; told once."""
        if what not in self.stated:
            self.stated.append(what)

    def flight(self, name: str, max_speed_m_s: float = MAX_SPEED_M_S) -> Flight:
        """The records that follow each other in time and could have been flown."""
        in_order = self._in_order()
        reports = [report for _, report in in_order]
        found = courses(reports, max_speed_m_s)
        for i, why in sorted(found.refused.items()):
            self.skip(in_order[i][0], why)
        taken = [i for i in range(len(reports)) if i not in found.refused]
        if not taken:
            why = f"; the first problem: {self.skipped[0]}" if self.skipped else ""
            raise PlotfeedError(f"no position in this file{why}")
        if found.second:
            self.assume(f"{found.second} records are of another source than most, and skipped")
        for i in found.starts:
            self.assume(f"{in_order[i][0]}: the drone is elsewhere, and stays there: a new start")
        more = (f"and {self.more_skipped} more",) if self.more_skipped else ()
        return Flight(
            name=name,
            reports=tuple(reports[i] for i in taken),
            skipped=(*self.skipped, *more),
            assumed=tuple(self.assumed),
            starts=tuple(bisect_left(taken, i) for i in found.starts),
            stated=tuple(self.stated),
            dropped=dict(self.dropped),
        )

    def _in_order(self) -> list[tuple[str, PositionReport]]:
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


@dataclass(frozen=True, slots=True)
class Courses:
    """What of reports was flown: all but `refused`, each with why it was not.

    To those at indices `starts` no flight leads from before; `second` are those of another source.
    """

    refused: Mapping[int, str]
    starts: tuple[int, ...] = ()
    second: int = 0


def courses(reports: Sequence[PositionReport], max_speed_m_s: float = MAX_SPEED_M_S) -> Courses:
    """Which reports belong to the flight; times must increase.

    Reports are strung into chains in which every step could have been flown: each to the longest
    that it can follow, or if several last long enough to be believed, to the latest of those. The
    longest is the flight: this finds the wrong ones also where they come first, or several in a
    row, as long as most are right. A chain that lasts and lies wholly before or after it is flown
    too, from a new start; one that lies beside it is another source.
    """
    columns = np.array([(r.latitude_deg, r.longitude_deg, r.altitude_m) for r in reports])
    where_m = geodetic_to_ecef(*columns.reshape(-1, 3).T).tolist()

    def follows(chain: list[int], i: int) -> bool:
        last, report = reports[chain[-1]], reports[i]
        seconds = (report.t_utc_ns - last.t_utc_ns) / NS
        stated_m = last.horizontal_accuracy_m, report.horizontal_accuracy_m
        return dist(where_m[chain[-1]], where_m[i]) <= reach_m(seconds, max_speed_m_s, *stated_m)

    def lasts(chain: list[int]) -> bool:
        lasted_ns = reports[chain[-1]].t_utc_ns - reports[chain[0]].t_utc_ns
        return len(chain) >= CONFIRM_REPORTS and lasted_ns >= CONFIRM_NS

    chains: list[list[int]] = []
    for i in range(len(reports)):
        able = [c for c in chains if follows(c, i)]
        if able:
            max(able, key=lambda c: (lasts(c), c[-1] if lasts(c) else len(c))).append(i)
        else:
            chains.append([i])
            if len(chains) > MAX_CHAINS:
                chains.remove(min(chains[:-1], key=len))
    flown: list[list[int]] = []
    second = 0
    for chain in sorted(chains, key=len, reverse=True):
        apart = all(chain[-1] < other[0] or other[-1] < chain[0] for other in flown)
        if not flown or (apart and lasts(chain)):
            flown.append(chain)
        elif lasts(chain):
            second += len(chain)
    taken = sorted(i for chain in flown for i in chain)

    def why(i: int) -> str:
        """The speed that it takes to fly there from the nearest report in time that is kept."""
        after = bisect_left(taken, i)
        apart_ns, near = min(
            (abs(reports[i].t_utc_ns - reports[j].t_utc_ns), j)
            for j in taken[max(0, after - 1) : after + 1]
        )
        away_m = dist(where_m[near], where_m[i])
        return f"implausible: {away_m:.0f} m away in {apart_ns / NS:.3g} s"

    refused = {i: why(i) for i in set(range(len(reports))).difference(taken)}
    return Courses(refused, tuple(sorted(chain[0] for chain in flown))[1:], second)


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
    ahead_ns = 0
    if when.tzinfo is None:
        when, ahead_ns = when.replace(tzinfo=UTC), round(utc_offset_h * 3600 * NS)
    return (when - _EPOCH) // timedelta(microseconds=1) * 1000 - ahead_ns
