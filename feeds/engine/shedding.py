"""What a session leaves out while it cannot do all of it: whole scans, of sensors in turn."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors, MissedScans
from plotfeed.models.state import Bools
from plotfeed.proto.utc import NS_IN_MS

# A tick that is later than the first is behind. No stall, which is made up for, but too much to do
# is what leaves it as late after the second, without a moment in which nothing was due.
LATE_NS, PROOF_NS = 20 * NS_IN_MS, 100 * NS_IN_MS
# A scan that has begun is given up only where it is late by a period over this.
WORTH_WAITING = 4
# So often it is looked up what a sector costs.
LOOK_NS = 250 * NS_IN_MS
# Share of its time for which a session that leaves scans out is busy, on average and at most.
BUSY, MOST_BUSY = 0.85, 0.95


class Shedding:
    """Leaves out scans that there is no time for: of each sensor the same share, evenly in time.

    Whether a scan is worked out is decided as it begins. Only where a session falls behind all the
    same, sensors give up the scans that they are in, first those that have lost least.
    """

    def __init__(
        self, sensors: EmulatedSensors, missed: Callable[[int, MissedScans], object]
    ) -> None:
        """`missed` is told of each sensor, by index, what it leaves out."""
        self._sensors, self._missed = sensors, missed
        n = len(sensors.sensors)
        # How many scans of each are owed: there was time for so many more of them.
        self._owed, self._lost_ns = np.zeros(n), np.zeros(n, np.int64)
        self._may: Bools = np.ones(n, np.bool_)
        # Of all scans, what is worked out; and what a sector costs of the session's time.
        self._share, self._cost_ns = 1.0, 0.0
        # Since the cost was looked up: sectors worked out and the time that they took, when that
        # was, what had been slept.
        self._sectors, self._took_ns, self._looked_ns, self._slept_ns = 0, 0, -1, 0
        # Whether sectors are what takes the time.
        self._is_by_sectors = False
        # Since when it is behind, how late it was then, and what had been slept.
        self._behind: tuple[int, int, int] | None = None

    def spare(self, which: Sequence[int]) -> None:
        """Leave nothing out of those sensors, by index."""
        self._may[list(which)] = False

    def took(self, duration_ns: int, sectors: int = 0) -> None:
        """Count the time that it took to send sectors, or to work out so many more."""
        self._sectors += sectors
        self._took_ns += duration_ns

    def look(self, now_ns: int, due_ns: int, before_ns: int, slept_ns: int) -> None:
        """Leave out what there is no time for, at a tick that was due then.

        Sectors that end before `before_ns` are worked out next; `slept_ns` is for how long nothing
        was due so far.
        """
        if now_ns - self._looked_ns >= LOOK_NS:
            self._look_up_cost(now_ns, slept_ns)
        late_ns = now_ns - due_ns
        if self._share < 1.0:
            self._begin_scans(before_ns, max(0, late_ns))
        if late_ns <= LATE_NS:
            self._behind = None
        elif self._behind is None or slept_ns > self._behind[2]:
            self._behind = now_ns, late_ns, slept_ns
        elif now_ns - self._behind[0] >= max(PROOF_NS, late_ns // 2):
            if late_ns >= self._behind[1]:
                self._give_up(now_ns, late_ns, slept_ns)
            self._behind = now_ns, late_ns, slept_ns

    def _begin_scans(self, before_ns: int, late_ns: int) -> None:
        """Have those begin their scans of which most are owed, as far as there is time for them.

        What it is late by is time that the scan after it has less.
        """
        sensors, owed = self._sensors, self._owed
        per_ns = sensors.sectors_per_ns
        begins = np.flatnonzero(self._may & sensors.begins_before(before_ns))
        if not len(begins):
            return
        period_ns = sensors.upcoming.period_ns
        share = self._share * np.maximum(1.0 - late_ns / period_ns, 0.0)
        busy, most = per_ns[sensors.amid_scans].sum(), MOST_BUSY / BUSY * (share * per_ns).sum()
        owed[begins] += share[begins]
        # What is owed to all alike there was no room for. Nobody gets far ahead of those
        # who wait for room.
        at_work = self._may & (per_ns > 0)
        owed -= max(0.0, owed[at_work].min(initial=np.inf) - 1.0)
        least = max(0.0, owed[at_work].max(initial=0.0) - 1.25)
        for i in begins[np.argsort(-owed[begins], kind="stable")].tolist():
            fits = busy + per_ns[i] <= most or (not busy and owed[i] >= 1.0)
            if fits and owed[i] > least:
                owed[i] -= 1.0
                busy += per_ns[i]
            else:
                self._leave_out(i)

    def _look_up_cost(self, now_ns: int, slept_ns: int) -> None:
        busy_ns = now_ns - self._looked_ns - (slept_ns - self._slept_ns)
        if self._looked_ns >= 0 and self._sectors:
            cost_ns = busy_ns / self._sectors
            if self._cost_ns:  # one stall makes little of a difference, and as little as a lull
                cost_ns = min((self._cost_ns + cost_ns) / 2, 2 * self._cost_ns)
            self._cost_ns = cost_ns
        self._is_by_sectors = 2 * self._took_ns > busy_ns
        self._sectors, self._took_ns, self._looked_ns, self._slept_ns = 0, 0, now_ns, slept_ns
        if self._share < 1.0:
            self._follow_cost()

    def _follow_cost(self) -> None:
        """Work out as many scans as there is time for; all of them where that is so."""
        needed = self._cost_ns * self._sensors.sectors_per_ns.sum()
        self._share = 1.0 if needed <= MOST_BUSY else BUSY / needed

    def _give_up(self, now_ns: int, late_ns: int, slept_ns: int) -> None:
        """Have as many sensors give up their scans as there is no time for, and one in ten more.

        None does so before it is late by a part of its period: a long scan is worth waiting for.
        """
        is_cold = not self._cost_ns  # what is done for the first time costs several times as much
        if self._sectors:
            self._look_up_cost(now_ns, slept_ns)
        if is_cold or not self._is_by_sectors:
            return  # but by what comes in, or by others: it passes
        self._follow_cost()
        per_ns = self._sensors.sectors_per_ns
        overdue = self._sensors.begins_before(now_ns)
        amid = self._may & (self._sensors.amid_scans | overdue)
        amid &= self._sensors.upcoming.period_ns <= WORTH_WAITING * late_ns
        late = np.flatnonzero(amid)
        late = late[np.lexsort((self._owed[late], self._lost_ns[late]))]
        per_ns, all_ns = per_ns[late], per_ns.sum()
        keeps = min(self._share * all_ns, 0.9 * per_ns.sum())
        left = per_ns.sum() - np.cumsum(per_ns)
        for i in late[: np.count_nonzero(left > keeps) + 1].tolist():
            self._leave_out(i)

    def _leave_out(self, i: int) -> None:
        self._lost_ns[i] += self._sensors.sensors[i].scan.period_ns
        self._missed(i, self._sensors.skip_scan(i))
