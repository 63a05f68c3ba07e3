"""Which reports of telemetry are taken: of few enough drones, near now, in order, and flyable.

No publisher is told from another: what comes by MQTT names a drone and not its sender. So what
bounds a flood of names is what one can see: whether a name comes again, and how long it is silent.
A report from where the drone cannot be is refused: one wrong fix shall not move a drone by
kilometres, nor be taken for speed. But where several agree with each other, the drone is there, and
starts anew; and where others go on to come from where it was, two sources report under one name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import dist, fsum, isnan, sqrt

import numpy as np

from plotfeed.feeds.scene.telemetry_keys import Telemetry
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.frames import geodetic_to_ecef
from plotfeed.proto.utc import NS

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


def reach_m(seconds: float, max_speed_m_s: float, *sigmas_m: float) -> float:
    """How far two reports of a drone may be apart; `sigmas_m` are what they state, or NaN."""
    return GRACE_M + SIGMAS * fsum(s for s in sigmas_m if not isnan(s)) + max_speed_m_s * seconds


@dataclass(slots=True)
class _Elsewhere:
    """Reports that no flight from a drone's last one explains, and that agree with each other."""

    last: PositionReport
    since_ns: int  # When they began to outweigh those from where the drone was
    weight: int = 1
    reports: int = 1
    between: int = 0  # Reports from where the drone was, since the first of these


class Course:
    """The last report of a drone that was taken, and what has come since from elsewhere."""

    __slots__ = ("elsewhere", "is_single", "row", "since_utc_ns", "sources_are_told")

    def __init__(self, row: PositionReport, since_utc_ns: int) -> None:
        self.row, self.since_utc_ns = row, since_utc_ns  # When it became known
        self.elsewhere: _Elsewhere | None = None
        self.sources_are_told = False  # Whether it was said that two sources report under its name
        self.is_single = True  # Whether this is the only report of it that was taken


class MotionGate:
    """Lets reports on that a drone can have made, one after the other in the order of time."""

    def __init__(self, max_speed_m_s: float) -> None:
        self._max_speed_m_s = max_speed_m_s
        self._max_m2_s2 = max_speed_m_s**2
        self._m_per_ns = max_speed_m_s / NS

    def take(self, course: Course, row: PositionReport) -> bool:
        """Take a later report; whether the drone starts anew with it. Raises `Refused`."""
        before = course.row
        east_m_s, north_m_s, up_m_s = row.velocity_enu_m_s
        speed_m2_s2 = east_m_s * east_m_s + north_m_s * north_m_s + up_m_s * up_m_s
        away_m = (
            abs(row.latitude_deg - before.latitude_deg)
            + abs(row.longitude_deg - before.longitude_deg)
        ) * MAX_METRES_PER_DEG + abs(row.altitude_m - before.altitude_m)
        if not speed_m2_s2 <= self._max_m2_s2:  # or some of it is not known
            self.check_speed(row)
        reach = GRACE_M + self._m_per_ns * (row.t_utc_ns - before.t_utc_ns)
        if away_m <= reach and course.elsewhere is None:
            course.row = row
            return False
        return self._look_closer(course, row)

    def _look_closer(self, course: Course, row: PositionReport) -> bool:
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

    def _refusal(self, course: Course, row: PositionReport, elsewhere: _Elsewhere) -> Refused:
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

    def _is_within_reach(self, a: PositionReport, b: PositionReport) -> bool:
        seconds = max(0.0, (b.t_utc_ns - a.t_utc_ns) / NS)
        most_m = reach_m(seconds, self._max_speed_m_s, a.sigma_m, b.sigma_m)
        return dist(*_places_m(a, b)) <= most_m

    def check_speed(self, row: PositionReport) -> None:
        """Raise `Refused` if the report itself says that it is too fast."""
        speed_m_s = sqrt(sum(v * v for v in row.velocity_enu_m_s if not isnan(v)))
        if speed_m_s > self._max_speed_m_s:
            limit = f"{self._max_speed_m_s:g} m/s (telemetry.max_speed_m_s)"
            detail = f"speed is {speed_m_s:g} m/s; expected at most {limit}"
            raise Refused(Reason.IMPLAUSIBLE_MOTION, detail)


def _places_m(a: PositionReport, b: PositionReport) -> Sequence[Sequence[float]]:
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


# How often it is looked up at most who is gone, where there is no place for a new drone.
LOOK_EVERY_NS = NS // 10
MAX_KNOCKED = 10_000  # Names that are remembered of those that were too many in their second


class KnownDrones(dict[str, Course]):
    """Courses of drones by name: of a limited number, new ones at a limited rate.

    A drone is gone when no sensor can ask for it any more. After a longer time it is forgotten; one
    of which a single report was taken, at once. Before that it gives way where there is no place.
    """

    def __init__(self, keys: Telemetry, gone_after_ns: int) -> None:
        super().__init__()
        # Drones of which one report was taken, the oldest first.
        self._singles: dict[str, None] = {}
        self._max_drones = keys.max_drones
        self._max_new_per_s = keys.max_new_drones_per_s
        self._gone_after_ns = gone_after_ns
        self._forget_after_ns = max(round(keys.forget_after_s * NS), gone_after_ns)
        self._new = _Budget(self._max_new_per_s)
        self._again = _Budget(self._max_new_per_s)
        self._knocked: dict[str, None] = {}
        self._swept_s = 0
        self._looked_ns = 0
        # Drones that were gone when it was last looked up, the one that is gone longest last.
        self._gone: list[str] = []
        self._forgotten: list[str] = []

    def begin(self, drone: str, row: PositionReport, now_utc_ns: int) -> None:
        """Know a new drone; raises `Refused` where there is no place for it, or not now."""
        if not self._may_come(drone, now_utc_ns):
            detail = (
                f"drone {drone!a} is new, and {self._max_new_per_s} new ones a second are the "
                "most taken (telemetry.max_new_drones_per_s); its next report may be"
            )
            raise Refused(Reason.TOO_MANY_NEW_DRONES, detail)
        if len(self) >= self._max_drones:
            self._forget(self._who_gives_way(drone, now_utc_ns))
        self[drone], self._singles[drone] = Course(row, now_utc_ns), None

    def establish(self, drone: str, course: Course) -> None:
        """Note that a second report of a drone was taken."""
        course.is_single = False
        del self._singles[drone]

    def forgotten(self, now_utc_ns: int) -> list[str]:
        """Who gave way since this was last asked, or is forgotten as of the whole second.

        They may be known again by now.
        """
        second = now_utc_ns // NS
        if second > self._swept_s:
            self._swept_s = second
            silent_ns = (self._forget_after_ns, self._gone_after_ns)
            for drone, course in [*self.items()]:
                if second * NS - course.row.t_utc_ns > silent_ns[course.is_single]:
                    self._forget(drone)
        forgotten, self._forgotten = self._forgotten, []
        return forgotten

    def _forget(self, drone: str) -> None:
        if self.pop(drone).is_single:
            del self._singles[drone]
        self._forgotten.append(drone)

    def _may_come(self, drone: str, now_utc_ns: int) -> bool:
        """Whether a new drone is within the rate; those that come again have one of their own."""
        if self._new.spend(now_utc_ns):
            return True
        if drone in self._knocked:
            if self._again.spend(now_utc_ns):
                del self._knocked[drone]
                return True
            return False
        if len(self._knocked) >= MAX_KNOCKED:
            del self._knocked[next(iter(self._knocked))]
        self._knocked[drone] = None
        return False

    def _who_gives_way(self, drone: str, now_utc_ns: int) -> str:
        """Whoever is gone longest; else whose single report came first, before now.

        Of many that report once, one that reports again so has the most time for it. Raises
        `Refused` where all are there and established.
        """
        if now_utc_ns - self._looked_ns >= LOOK_EVERY_NS:
            self._looked_ns = now_utc_ns
            gone = [(c.row.t_utc_ns, d) for d, c in self.items() if self._is_gone(c)]
            self._gone = [name for _, name in sorted(gone, reverse=True)]
        while self._gone:
            course = self.get(name := self._gone.pop())
            if course is not None and self._is_gone(course):
                return name
        single = next(iter(self._singles), None)
        if single is not None and self[single].since_utc_ns < now_utc_ns:
            return single
        detail = f"drone {drone!a} is new, and {self._max_drones} drones are the most taken"
        raise Refused(Reason.TOO_MANY_DRONES, detail)

    def _is_gone(self, course: Course) -> bool:
        return self._looked_ns - course.row.t_utc_ns > self._gone_after_ns


class _Budget:
    """A budget of so many a second, and of no more than that at once."""

    def __init__(self, per_s: int) -> None:
        self._each_ns = NS // per_s
        self._spent_until_ns = 0

    def spend(self, now_utc_ns: int) -> bool:
        """Whether there was one left."""
        until_ns = max(self._spent_until_ns, now_utc_ns) + self._each_ns
        if until_ns - now_utc_ns > NS:
            return False
        self._spent_until_ns = until_ns
        return True


MAX_DRONE_NAME = 64
NAME_SEPARATORS = frozenset("/+#")  # Characters that MQTT gives a meaning in topics


class Admission:
    """Takes reports as the latest of their drones, or refuses them with a reason."""

    def __init__(self, keys: Telemetry, look_back_s: float) -> None:
        """`look_back_s` is how far back sensors ask where a drone is.

        A report that is older by `stale_after_s` shows nobody anything any more, and a drone whose
        last report it is, is gone.
        """
        self._max_ahead_ns = round(keys.max_ahead_s * NS)
        self._max_age_ns = round(keys.max_age_s * NS)
        self._max_late_ns = round((keys.stale_after_s + look_back_s) * NS)
        self._surely_taken_ns = -min(self._max_age_ns, self._max_late_ns)
        self._gate = MotionGate(keys.max_speed_m_s)
        # Of whom a report was taken, and who is not forgotten.
        self.known = KnownDrones(keys, self._max_late_ns)

    def admit(self, drone: str, row: PositionReport, now_utc_ns: int) -> bool:
        """Take a report as the drone's latest; whether it starts anew there. Raises `Refused`."""
        t_utc_ns, course = row.t_utc_ns, self.known.get(drone)
        if course is None:
            good = 0 < len(drone) <= MAX_DRONE_NAME and drone.isprintable()
            if not good or NAME_SEPARATORS.intersection(drone):
                shown = ascii(drone[: MAX_DRONE_NAME + 1])
                expected = f"1 to {MAX_DRONE_NAME} printable characters without / + #"
                raise Refused(Reason.NAME, f"drone name {shown}; expected {expected}")
            self._check_now(t_utc_ns, now_utc_ns)
            self._check_late(now_utc_ns - t_utc_ns)
            self._gate.check_speed(row)
            self.known.begin(drone, row, now_utc_ns)
            return False
        last_utc_ns = course.row.t_utc_ns
        if (
            t_utc_ns <= last_utc_ns
            or not self._surely_taken_ns <= t_utc_ns - now_utc_ns <= self._max_ahead_ns
        ):
            self._check_now(t_utc_ns, now_utc_ns)
            if t_utc_ns == last_utc_ns:
                detail = f"drone {drone!r} has reported for this time before"
                raise Refused(Reason.DUPLICATE, detail)
            if t_utc_ns < last_utc_ns:
                behind_s = (last_utc_ns - t_utc_ns) / NS
                detail = f"time_utc is {behind_s:.3f} s before the last report of drone {drone!r}"
                raise Refused(Reason.BACKWARDS, detail)
            self._check_late(now_utc_ns - t_utc_ns)
        starts = self._gate.take(course, row)
        if course.is_single:
            self.known.establish(drone, course)
        return starts

    def _check_now(self, t_utc_ns: int, now_utc_ns: int) -> None:
        ahead_ns = t_utc_ns - now_utc_ns
        if ahead_ns > self._max_ahead_ns:
            limit_s = self._max_ahead_ns / NS
            detail = f"time_utc is {ahead_ns / NS:.3f} s ahead of now; at most {limit_s:g} s"
            raise Refused(Reason.FUTURE, detail)
        if -ahead_ns > self._max_age_ns:
            limit_s = self._max_age_ns / NS
            detail = f"time_utc is {-ahead_ns / NS:.3f} s old; at most {limit_s:g} s"
            raise Refused(Reason.STALE, detail)

    def _check_late(self, age_ns: int) -> None:
        if age_ns > self._max_late_ns:
            limit_s = self._max_late_ns / NS
            detail = (
                f"time_utc is {age_ns / NS:.3f} s old; after {limit_s:g} s no sensor can still see "
                "the drone there"
            )
            raise Refused(Reason.LATE, detail)
