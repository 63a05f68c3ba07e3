"""The drones that are known: how names come in, how long they stay, and who gives way to whom.

No publisher is told from another: what comes by MQTT names a drone and not its sender. So what
bounds a flood of names is what one can see: whether a name comes again, and how long it is silent.
"""

from __future__ import annotations

from plotfeed.feeds.telemetry.motion_gate import Course
from plotfeed.feeds.telemetry.position_report import Reason, Refused
from plotfeed.proto.utc import NS

# How often it is looked up at most who is gone, where there is no place for a new drone.
LOOK_EVERY_NS = NS // 10
MAX_KNOCKED = 10_000  # Names that are remembered of those that were too many in their second


class KnownDrones:
    """Courses of drones by name: of a limited number, new ones at a limited rate.

    A drone is gone when no sensor can ask for it any more. After a longer time it is forgotten; one
    of which a single report was taken, at once. Before that it gives way where there is no place.
    """

    def __init__(
        self, *, max_drones: int, max_new_per_s: int, forget_after_ns: int, gone_after_ns: int
    ) -> None:
        self._courses: dict[str, Course] = {}
        # Drones of which one report was taken, the oldest first.
        self._singles: dict[str, None] = {}
        self._max_drones = max_drones
        self._max_new_per_s = max_new_per_s
        self._gone_after_ns = gone_after_ns
        self._forget_after_ns = max(forget_after_ns, gone_after_ns)
        self._new = _Budget(max_new_per_s)
        self._again = _Budget(max_new_per_s)
        self._knocked: dict[str, None] = {}
        self._swept_s = 0
        self._looked_ns = 0
        # Drones that were gone when it was last looked up, the one that is gone longest last.
        self._gone: list[str] = []
        self._forgotten: list[str] = []

    def __len__(self) -> int:
        return len(self._courses)

    def get(self, drone: str) -> Course | None:
        """The course of a drone, if it is known."""
        return self._courses.get(drone)

    def begin(self, drone: str, course: Course, now_utc_ns: int) -> None:
        """Know a new drone; raises `Refused` where there is no place for it, or not now."""
        if not self._may_come(drone, now_utc_ns):
            detail = (
                f"drone {drone!a} is new, and {self._max_new_per_s} new ones a second are the "
                "most taken (telemetry.max_new_drones_per_s); its next report may be"
            )
            raise Refused(Reason.TOO_MANY_NEW_DRONES, detail)
        if len(self._courses) >= self._max_drones:
            self._forget(self._who_gives_way(drone, now_utc_ns))
        course.is_single, course.since_utc_ns = True, now_utc_ns
        self._courses[drone] = course
        self._singles[drone] = None

    def establish(self, drone: str, course: Course) -> None:
        """Note that a second report of a drone was taken."""
        course.is_single = False
        del self._singles[drone]

    def forget_gone(self, now_utc_ns: int) -> None:
        """Forget whom it is time to forget, as of the whole second."""
        second = now_utc_ns // NS
        if second <= self._swept_s:
            return
        self._swept_s, now_utc_ns = second, second * NS
        silent = (self._forget_after_ns, self._gone_after_ns)
        for drone in [
            drone
            for drone, course in self._courses.items()
            if now_utc_ns - course.row.t_utc_ns > silent[course.is_single]
        ]:
            self._forget(drone)

    def take_forgotten(self) -> list[str]:
        """Who was forgotten since this was last asked; they may be known again by now."""
        forgotten, self._forgotten = self._forgotten, []
        return forgotten

    def _forget(self, drone: str) -> None:
        if self._courses.pop(drone).is_single:
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
            gone = [(c.row.t_utc_ns, d) for d, c in self._courses.items() if self._is_gone(c)]
            self._gone = [name for _, name in sorted(gone, reverse=True)]
        while self._gone:
            course = self._courses.get(name := self._gone.pop())
            if course is not None and self._is_gone(course):
                return name
        single = next(iter(self._singles), None)
        if single is not None and self._courses[single].since_utc_ns < now_utc_ns:
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
