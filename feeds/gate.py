"""Which reports are admitted: names, times, and how many drones."""

from __future__ import annotations

from collections import Counter

from plotfeed.feeds.report import NS, Reason, Refused, Report

MAX_DRONE_NAME = 64
NAME_SEPARATORS = frozenset("/+#")
"""Characters that MQTT gives a meaning in topics."""


class Gate:
    """Admission in the order of time, drone by drone; counts what is refused and why."""

    def __init__(
        self, *, max_ahead_s: float = 2.0, max_age_s: float | None = None, max_drones: int = 10_000
    ) -> None:
        self.max_ahead_ns = round(max_ahead_s * NS)
        self.max_age_ns = None if max_age_s is None else round(max_age_s * NS)
        self.max_drones = max_drones
        self.refused: Counter[Reason] = Counter()
        self._last_utc_ns: dict[str, int] = {}

    def admit(self, drone: str, report: Report, now_utc_ns: int) -> None:
        """Take the report as the drone's latest, or raise `Refused`, already counted."""
        try:
            self._check_name(drone)
            self._check_now(report.t_utc_ns, now_utc_ns)
            self._check_order(drone, report.t_utc_ns)
        except Refused as refused:
            self.refuse(refused)
            raise
        self._last_utc_ns[drone] = report.t_utc_ns

    def refuse(self, refused: Refused) -> int:
        """Count a refusal, once however often it is asked; how many there were for its reason."""
        if refused.count is None:
            self.refused[refused.reason] += 1
            refused.count = self.refused[refused.reason]
        return refused.count

    def forget(self, drone: str) -> None:
        """Make room for another drone; this one may come back at any time."""
        self._last_utc_ns.pop(drone, None)

    def _check_name(self, drone: str) -> None:
        shown = ascii(drone[: MAX_DRONE_NAME + 1])
        good = 0 < len(drone) <= MAX_DRONE_NAME and drone.isprintable()
        if not good or NAME_SEPARATORS.intersection(drone):
            expected = f"1 to {MAX_DRONE_NAME} printable characters without / + #"
            raise Refused(Reason.NAME, f"drone name {shown}; expected {expected}")
        if drone not in self._last_utc_ns and len(self._last_utc_ns) >= self.max_drones:
            detail = f"drone {shown} is new, and {self.max_drones} drones are the most taken"
            raise Refused(Reason.TOO_MANY_DRONES, detail)

    def _check_now(self, t_utc_ns: int, now_utc_ns: int) -> None:
        ahead_ns = t_utc_ns - now_utc_ns
        if ahead_ns > self.max_ahead_ns:
            limit_s = self.max_ahead_ns / NS
            detail = f"time_utc is {ahead_ns / NS:.3f} s ahead of now; at most {limit_s:g} s"
            raise Refused(Reason.FUTURE, detail)
        if self.max_age_ns is not None and -ahead_ns > self.max_age_ns:
            limit_s = self.max_age_ns / NS
            detail = f"time_utc is {-ahead_ns / NS:.3f} s old; at most {limit_s:g} s"
            raise Refused(Reason.STALE, detail)

    def _check_order(self, drone: str, t_utc_ns: int) -> None:
        last_utc_ns = self._last_utc_ns.get(drone)
        if last_utc_ns is None or t_utc_ns > last_utc_ns:
            return
        if t_utc_ns == last_utc_ns:
            raise Refused(Reason.DUPLICATE, f"drone {drone!r} has reported for this time before")
        behind_s = (last_utc_ns - t_utc_ns) / NS
        detail = f"time_utc is {behind_s:.3f} s before the last report of drone {drone!r}"
        raise Refused(Reason.BACKWARDS, detail)
