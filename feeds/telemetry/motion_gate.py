"""Whether a drone can have flown from one report to the next, and what becomes of the others.

A report from where the drone cannot be is refused: one wrong fix shall not move a drone by
kilometres, nor be taken for speed. But where several agree with each other, the drone is there, and
starts anew; and where others go on to come from where it was, two sources report under one name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import dist, fsum, isnan, sqrt

import numpy as np

from plotfeed.feeds.telemetry.position_report import Reason, Refused, ReportRow
from plotfeed.models.frames import geodetic_to_ecef
from plotfeed.models.state import NS

MAX_SPEED_M_S = 150.0  # Multicopters reach 60 m/s, those with jets 150 m/s
# A fix may be off by this without being taken for wrong: receivers jump, coarse logs step.
GRACE_M = 30.0
SIGMAS = 4.0  # And by so many standard deviations of both positions, where they are stated
CONFIRM_REPORTS = 3
# So many reports from elsewhere over so long are a new start. A receiver that is upsampled repeats
# one wrong fix for 0.2 s.
CONFIRM_NS = NS
# For how many from elsewhere one from where the drone was counts: who reports less is refused.
AGAINST = 2
# So many from elsewhere, and as many in between from where the drone was, are two sources.
SOURCE_REPORTS = 3
MEMORY_NS = 10 * NS  # After so long without a report from elsewhere, there is no second source
MAX_METRES_PER_DEG = 113_500.0  # Of latitude or longitude, up to 100 km above the ground


def reach_m(seconds: float, max_speed_m_s: float, sigma_m: float = 0.0) -> float:
    """How far two reports of a drone may be apart; `sigma_m` is the sum of what they state."""
    return GRACE_M + SIGMAS * sigma_m + max_speed_m_s * seconds


@dataclass(slots=True)
class _Elsewhere:
    """Reports that no flight from a drone's last one explains, and that agree with each other."""

    last: ReportRow
    since_ns: int  # When they began to outweigh those from where the drone was
    weight: int = 1
    reports: int = 1
    between: int = 0  # Reports from where the drone was, since the first of these


class Course:
    """The last report of a drone that was taken, and what has come since from elsewhere."""

    __slots__ = ("elsewhere", "is_single", "row", "since_utc_ns", "sources_are_told")

    def __init__(self, row: ReportRow) -> None:
        self.row = row
        self.elsewhere: _Elsewhere | None = None
        self.sources_are_told = False  # Whether it was said that two sources report under its name
        self.is_single = True  # Whether this is the only report of it that was taken
        self.since_utc_ns = row.t_utc_ns  # When it became known


class MotionGate:
    """Lets reports on that a drone can have made, one after the other in the order of time."""

    def __init__(self, max_speed_m_s: float = MAX_SPEED_M_S) -> None:
        self._max_speed_m_s = max_speed_m_s
        self._max_m2_s2 = max_speed_m_s**2
        self._m_per_ns = max_speed_m_s / NS

    def first(self, row: ReportRow) -> Course:
        """The course of a drone that is new; raises `Refused`."""
        self._check_speed(row)
        return Course(row)

    def take(self, course: Course, row: ReportRow) -> bool:
        """Take a later report; whether the drone starts anew with it. Raises `Refused`."""
        before = course.row
        east_m_s, north_m_s, up_m_s = row[5:8]
        speed_m2_s2 = east_m_s * east_m_s + north_m_s * north_m_s + up_m_s * up_m_s
        away_m = (
            abs(row.latitude_deg - before.latitude_deg)
            + abs(row.longitude_deg - before.longitude_deg)
        ) * MAX_METRES_PER_DEG + abs(row.altitude_m - before.altitude_m)
        if not speed_m2_s2 <= self._max_m2_s2:  # or some of it is not known
            self._check_speed(row)
        reach = GRACE_M + self._m_per_ns * (row.t_utc_ns - before.t_utc_ns)
        if away_m <= reach and course.elsewhere is None:
            course.row = row
            return False
        return self._look_closer(course, row)

    def _look_closer(self, course: Course, row: ReportRow) -> bool:
        elsewhere = course.elsewhere
        if self._is_within_reach(course.row, row):
            if elsewhere is not None:
                elsewhere.weight = max(0, elsewhere.weight - AGAINST)
                elsewhere.between += 1
                if row.t_utc_ns - elsewhere.last.t_utc_ns > MEMORY_NS:
                    course.elsewhere = None
            course.row = row
            return False
        if elsewhere is None or not self._is_within_reach(elsewhere.last, row):
            course.elsewhere = elsewhere = _Elsewhere(row, row.t_utc_ns)
        elif row.t_utc_ns > elsewhere.last.t_utc_ns:
            if not elsewhere.weight:
                elsewhere.since_ns = row.t_utc_ns
            elsewhere.last = row
            elsewhere.weight += 1
            elsewhere.reports += 1
            lasted_ns = row.t_utc_ns - elsewhere.since_ns
            if elsewhere.weight >= CONFIRM_REPORTS and lasted_ns >= CONFIRM_NS:
                course.row, course.elsewhere = row, None
                return True
        raise self._refusal(course, row, elsewhere)

    def _refusal(self, course: Course, row: ReportRow, elsewhere: _Elsewhere) -> Refused:
        away_m = dist(*_places_m(course.row, row))
        if min(elsewhere.reports, elsewhere.between) >= SOURCE_REPORTS:
            detail = (
                f"two sources report under this name, {away_m:.0f} m apart: taken is the one that "
                f"reports more, refused the one at latitude {row.latitude_deg:.5f}, longitude "
                f"{row.longitude_deg:.5f}"
            )
            told, course.sources_are_told = course.sources_are_told, True
            return Refused(Reason.SECOND_SOURCE, detail, is_told=told)
        seconds = (row.t_utc_ns - course.row.t_utc_ns) / NS
        detail = (
            f"{away_m:.0f} m from the last report in {seconds:.3g} s; expected at most "
            f"{self._max_speed_m_s:g} m/s (telemetry.max_speed_m_s) and {GRACE_M:g} m"
        )
        return Refused(Reason.IMPLAUSIBLE_MOTION, detail)

    def _is_within_reach(self, a: ReportRow, b: ReportRow) -> bool:
        seconds = (b.t_utc_ns - a.t_utc_ns) / NS
        stated_m = fsum(s for s in (a.sigma_m, b.sigma_m) if not isnan(s))
        return dist(*_places_m(a, b)) <= reach_m(max(0.0, seconds), self._max_speed_m_s, stated_m)

    def _check_speed(self, row: ReportRow) -> None:
        """Raise `Refused` if the report itself says that it is too fast."""
        speed_m_s = sqrt(sum(v * v for v in row[5:8] if not isnan(v)))
        if speed_m_s > self._max_speed_m_s:
            limit = f"{self._max_speed_m_s:g} m/s (telemetry.max_speed_m_s)"
            detail = f"speed is {speed_m_s:g} m/s; expected at most {limit}"
            raise Refused(Reason.IMPLAUSIBLE_MOTION, detail)


def _places_m(a: ReportRow, b: ReportRow) -> Sequence[Sequence[float]]:
    """Both positions in ECEF, metres, (2, 3), as if altitudes were above the ellipsoid.

    Between them it is the same whatever they are above; where that differs, they tell nothing.
    """
    alike = a.altitude_reference is b.altitude_reference
    positions_m: Sequence[Sequence[float]] = geodetic_to_ecef(
        np.array([a.latitude_deg, b.latitude_deg]),
        np.array([a.longitude_deg, b.longitude_deg]),
        np.array([a.altitude_m, b.altitude_m if alike else a.altitude_m]),
    ).tolist()
    return positions_m
