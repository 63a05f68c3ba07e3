"""When something was measured by UTC, of senders whose clocks count from anywhere, or are off."""

from __future__ import annotations

from plotfeed.proto.utc import NS

TRUSTED_WITHIN_NS = NS  # A sender's UTC that is further from ours than this, is off
LOOK_BACK_NS = 5 * NS
# A clock that goes back by more than this has begun anew; by less, messages passed each other.
RESTART_NS = NS


class SenderClock:
    """The clock of a sender beside ours, by when its messages come.

    No message comes before it is sent: the one that took least of late shows how far the clocks
    are apart, to that least delay. Where the sender says its UTC and is not off, that is taken.
    """

    def __init__(self, declared_ns: int | None = None) -> None:
        """`declared_ns` is the sender's UTC less what its messages count; 0 if they count UTC."""
        self.declared_ns = declared_ns
        self.is_off = False  # Whether the sender says a UTC that is not taken
        self._apart_ns: int | None = None
        self._recent_ns: int | None = None
        self._until_ns = 0
        self._last_ns: int | None = None

    def declare(self, declared_ns: int, count_ns: int) -> None:
        """Take what the sender said its UTC less its count is, at that count."""
        self._begin_anew_before(count_ns)
        self.declared_ns = declared_ns

    @property
    def off_s(self) -> float:
        """How far the sender's UTC is behind ours, seconds; 0 where it says none."""
        if self.declared_ns is None or self._apart_ns is None:
            return 0.0
        return (self._apart_ns - self.declared_ns) / NS

    def utc_ns(self, count_ns: int, now_utc_ns: int) -> int:
        """The UTC of a message that bears this count of the sender's clock and has come now."""
        self._begin_anew_before(count_ns)
        self._last_ns = count_ns
        apart_ns = now_utc_ns - count_ns
        left_ns = self._until_ns - now_utc_ns
        # Nothing was heard for long, or our own clock has jumped: what was known is worth nothing.
        jumped = not -LOOK_BACK_NS <= left_ns <= LOOK_BACK_NS
        if self._apart_ns is None or self._recent_ns is None or jumped:
            self._apart_ns = self._recent_ns = apart_ns
            self._until_ns = now_utc_ns + LOOK_BACK_NS
        elif left_ns < 0:
            # The least of the last stretch and of this one: so clocks may drift.
            self._apart_ns, self._recent_ns = self._recent_ns, apart_ns
            self._until_ns = now_utc_ns + LOOK_BACK_NS
        self._recent_ns = min(self._recent_ns, apart_ns)
        self._apart_ns = min(self._apart_ns, apart_ns)
        if self.declared_ns is None:
            return count_ns + self._apart_ns
        self.is_off = abs(self.declared_ns - self._apart_ns) > TRUSTED_WITHIN_NS
        return count_ns + (self._apart_ns if self.is_off else self.declared_ns)

    def _begin_anew_before(self, count_ns: int) -> None:
        """Forget everything if the clock has begun anew; its UTC, unless it counts that."""
        if self._last_ns is not None and count_ns < self._last_ns - RESTART_NS:
            self._apart_ns = self._recent_ns = self._last_ns = None
            if self.declared_ns != 0:
                self.declared_ns = None
