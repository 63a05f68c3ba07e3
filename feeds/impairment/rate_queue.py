"""A rate limit: messages are sent one after the other, and a finite number of them waits."""

from __future__ import annotations

from collections import deque

from plotfeed.feeds.impairment.settings import Link


class RateQueue:
    """First in, first out, at a rate that may change; without a rate nobody waits."""

    def __init__(self, link: Link) -> None:
        self._ends: deque[int] = deque()
        self.free_utc_ns = 0
        """When all that has been taken is sent."""
        self.change(link)

    def change(self, link: Link) -> None:
        """For what comes from now on; what was taken leaves when it was going to."""
        self._ns_per_octet = 0.0 if link.rate_kbit_s is None else 8e6 / link.rate_kbit_s
        self._overhead_octets = link.overhead_octets
        self._most = link.queue_messages

    def take(self, t_utc_ns: int, octets: int) -> int | None:
        """When a message that comes now has been sent; None if the queue is full."""
        start_ns = max(t_utc_ns, self.free_utc_ns)
        if not self._ns_per_octet:
            return start_ns
        ends = self._ends
        while ends and ends[0] <= t_utc_ns:
            ends.popleft()
        if len(ends) >= self._most:
            return None
        self.free_utc_ns = start_ns + round((octets + self._overhead_octets) * self._ns_per_octet)
        ends.append(self.free_utc_ns)
        return self.free_utc_ns
