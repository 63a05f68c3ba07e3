"""A recorded flight, the options of reading one, and which of its records are plausible."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

from plotfeed.feeds.telemetry.position_report import PositionReport, Refused, check
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

MAX_OCTETS = 256 * 1024 * 1024
MAX_SKIPPED = 10_000
"""Lines kept on records that were not taken; the rest are only counted."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MAX_SPEED_M_S = 150.0
MAX_CLIMB_M_S = 60.0
JITTER_M = 30.0
"""A fix may be off by this without being taken for wrong: receivers jump, coarse logs step."""
MAX_CHAINS = 16
EARTH_RADIUS_M = 6_371_000.0


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
    reports: tuple[PositionReport, ...]
    skipped: tuple[str, ...] = ()
    """A line for each record that was not taken: where it stands, and why."""
    assumed: tuple[str, ...] = ()
    """A line for each thing that the file did not say and that was taken for granted."""

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

    def take(self, where: str, **values: Any) -> None:
        """A record at `where`, with the fields of a report; skipped if a value is out of range."""
        report = PositionReport(**values)
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
        skipped, assumed = (*self.skipped, *more), tuple(self.assumed)
        return Flight(name=name, reports=taken, skipped=skipped, assumed=assumed)

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


def implausible(reports: Sequence[PositionReport]) -> dict[int, str]:
    """Index of each report that cannot belong to the flight, and why; times must increase.

    Reports are strung into chains in which every step could have been flown, each report to the
    longest chain that it can follow. The longest chain is the flight: this finds the wrong ones
    also where they come first, or several in a row, as long as most are right.
    """
    chains: list[list[int]] = []
    for i, report in enumerate(reports):
        able = [c for c in chains if _reachable(reports[c[-1]], report)]
        if able:
            max(able, key=len).append(i)
        else:
            chains.append([i])
            if len(chains) > MAX_CHAINS:
                chains.remove(min(chains[:-1], key=len))
    flown = max(chains, key=len, default=[])
    rest = set(range(len(reports))).difference(flown)
    return {i: _why(reports, flown, i) for i in rest}


def _reachable(a: PositionReport, b: PositionReport) -> bool:
    dt_s = (b.t_utc_ns - a.t_utc_ns) / NS
    if abs(b.altitude_m - a.altitude_m) > JITTER_M + MAX_CLIMB_M_S * dt_s:
        return False
    return distance_m(a, b) <= JITTER_M + MAX_SPEED_M_S * dt_s


def distance_m(a: PositionReport, b: PositionReport) -> float:
    """Along the ground, on a sphere: good to half a percent."""
    north, south = math.radians(a.latitude_deg), math.radians(b.latitude_deg)
    east = math.radians(b.longitude_deg - a.longitude_deg)
    chord = math.hypot(
        math.sin((north - south) / 2),
        math.sqrt(math.cos(north) * math.cos(south)) * math.sin(east / 2),
    )
    return 2 * EARTH_RADIUS_M * math.asin(min(1.0, chord))


def _why(reports: Sequence[PositionReport], flown: Sequence[int], i: int) -> str:
    """The speed that it takes to fly here from the nearest report in time that is kept."""
    near = reports[min(flown, key=lambda j: abs(reports[j].t_utc_ns - reports[i].t_utc_ns))]
    dt_s = abs(near.t_utc_ns - reports[i].t_utc_ns) / NS
    climb_m = abs(near.altitude_m - reports[i].altitude_m)
    ground_m = distance_m(near, reports[i])
    return f"implausible: {ground_m:.0f} m away and {climb_m:.0f} m of height in {dt_s:.3g} s"


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
