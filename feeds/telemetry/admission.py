"""Which reports of telemetry are taken: of few enough drones, near now, in order, and flyable."""

from __future__ import annotations

from plotfeed.feeds.telemetry.known_drones import KnownDrones
from plotfeed.feeds.telemetry.motion_gate import MAX_SPEED_M_S, MotionGate
from plotfeed.feeds.telemetry.position_report import Reason, Refused, ReportRow
from plotfeed.proto.utc import NS

MAX_DRONE_NAME = 64
NAME_SEPARATORS = frozenset("/+#")  # Characters that MQTT gives a meaning in topics


class Admission:
    """Takes reports as the latest of their drones, or refuses them with a reason."""

    def __init__(
        self,
        *,
        max_ahead_s: float = 2.0,
        max_age_s: float | None = None,
        max_late_s: float | None = None,
        max_drones: int = 10_000,
        max_new_drones_per_s: int = 500,
        forget_after_s: float = 60.0,
        max_speed_m_s: float = MAX_SPEED_M_S,
    ) -> None:
        """`max_late_s` is the age from which a report shows nobody anything any more.

        A drone whose last report is so old is gone, and after `forget_after_s` forgotten.
        """
        self._max_ahead_ns = round(max_ahead_s * NS)
        self._max_age_ns = None if max_age_s is None else round(max_age_s * NS)
        self._max_late_ns = None if max_late_s is None else round(max_late_s * NS)
        ages_ns = [a for a in (self._max_age_ns, self._max_late_ns) if a is not None]
        self._surely_taken_ns = -min(ages_ns, default=0)
        self._gate = MotionGate(max_speed_m_s)
        forget_after_ns = round(forget_after_s * NS)
        gone_after_ns = forget_after_ns if self._max_late_ns is None else self._max_late_ns
        self._known = KnownDrones(
            max_drones=max_drones,
            max_new_per_s=max_new_drones_per_s,
            forget_after_ns=forget_after_ns,
            gone_after_ns=gone_after_ns,
        )

    def knows(self, drone: str) -> bool:
        """Whether a report of that drone was taken, and it is not forgotten."""
        return self._known.get(drone) is not None

    def forgotten(self, now_utc_ns: int) -> list[str]:
        """Who was forgotten, or gave way, since this was last asked; as of now."""
        self._known.forget_gone(now_utc_ns)
        return self._known.take_forgotten()

    def admit(self, drone: str, row: ReportRow, now_utc_ns: int) -> bool:
        """Take a report as the drone's latest; whether it starts anew there. Raises `Refused`."""
        t_utc_ns, course = row.t_utc_ns, self._known.get(drone)
        if course is None:
            self._check_name(drone)
            self._check_now(t_utc_ns, now_utc_ns)
            self._check_late(now_utc_ns - t_utc_ns)
            self._known.begin(drone, self._gate.first(row), now_utc_ns)
            return False
        last_utc_ns = course.row.t_utc_ns
        if (
            t_utc_ns <= last_utc_ns
            or not self._surely_taken_ns <= t_utc_ns - now_utc_ns <= self._max_ahead_ns
        ):
            self._check_now(t_utc_ns, now_utc_ns)
            if t_utc_ns <= last_utc_ns:
                self._check_order(drone, t_utc_ns, last_utc_ns)
            self._check_late(now_utc_ns - t_utc_ns)
        starts = self._gate.take(course, row)
        if course.is_single:
            self._known.establish(drone, course)
        return starts

    def _check_name(self, drone: str) -> None:
        shown = ascii(drone[: MAX_DRONE_NAME + 1])
        good = 0 < len(drone) <= MAX_DRONE_NAME and drone.isprintable()
        if not good or NAME_SEPARATORS.intersection(drone):
            expected = f"1 to {MAX_DRONE_NAME} printable characters without / + #"
            raise Refused(Reason.NAME, f"drone name {shown}; expected {expected}")

    def _check_now(self, t_utc_ns: int, now_utc_ns: int) -> None:
        ahead_ns = t_utc_ns - now_utc_ns
        if ahead_ns > self._max_ahead_ns:
            limit_s = self._max_ahead_ns / NS
            detail = f"time_utc is {ahead_ns / NS:.3f} s ahead of now; at most {limit_s:g} s"
            raise Refused(Reason.FUTURE, detail)
        if self._max_age_ns is not None and -ahead_ns > self._max_age_ns:
            limit_s = self._max_age_ns / NS
            detail = f"time_utc is {-ahead_ns / NS:.3f} s old; at most {limit_s:g} s"
            raise Refused(Reason.STALE, detail)

    def _check_order(self, drone: str, t_utc_ns: int, last_utc_ns: int) -> None:
        if t_utc_ns == last_utc_ns:
            raise Refused(Reason.DUPLICATE, f"drone {drone!r} has reported for this time before")
        behind_s = (last_utc_ns - t_utc_ns) / NS
        detail = f"time_utc is {behind_s:.3f} s before the last report of drone {drone!r}"
        raise Refused(Reason.BACKWARDS, detail)

    def _check_late(self, age_ns: int) -> None:
        if self._max_late_ns is not None and age_ns > self._max_late_ns:
            limit_s = self._max_late_ns / NS
            detail = (
                f"time_utc is {age_ns / NS:.3f} s old; after {limit_s:g} s no sensor can still see "
                "the drone there"
            )
            raise Refused(Reason.LATE, detail)
