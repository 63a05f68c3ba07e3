"""What becomes of each message on an impaired link: a function of the message and of chance."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.link.delays import MOST_REPEATS, DelayLaw, DelaySeries, waits_ns
from plotfeed.feeds.link.losses import LossChain, chain_of, left_of
from plotfeed.feeds.scene.link_keys import LinkSettings, ReorderSettings
from plotfeed.models.chance import Chance, Purpose
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS


class RateLimit:
    """Arithmetic of a queue that leaves at a rate, which may change; it holds no messages."""

    def __init__(self, link: LinkSettings) -> None:
        self._ends: deque[int] = deque()
        self.free_utc_ns = 0  # When all that has been taken is sent
        self.change(link)

    def change(self, link: LinkSettings) -> None:
        """Be so for what comes from now on; what was taken leaves when it was going to."""
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


class Copy(NamedTuple):
    """A message as it leaves the link."""

    due_utc_ns: int
    # Of the payload, counted from the most significant bit of its first octet.
    flipped_bit: int | None


class Outcome(NamedTuple):
    """A message's fate, and the copies that leave; a second one is a duplicate."""

    fate: pb.Fate
    copies: tuple[Copy, ...]


_new = tuple.__new__  # half the time of a named tuple's own constructor
LOST = Outcome(pb.LOST, ())
QUEUE_FULL = Outcome(pb.QUEUE_FULL, ())
OUTAGE = Outcome(pb.OUTAGE, ())
# Not known yet: the link is down and loses nothing. Pass it on again when it is up.
HELD = Outcome(pb.FATE_UNSPECIFIED, ())


def flip(payload: bytes, bit: int) -> bytes:
    """The payload with that bit the other way round."""
    octets = bytearray(payload)
    octets[bit // 8] ^= 0x80 >> bit % 8
    return bytes(octets)


FEWEST_ROWS = 8
MOST_ROWS = 4096  # Drawn at once
COLUMNS = 8  # Two steps of Philox, each of which gives four numbers


def random_rows(chance: Chance, second: int, first: int, count: int) -> NDArray[np.float64]:
    """Uniform numbers from 0 to 1 of a second's messages from the first-th on; (count, 8)."""
    rng = chance.rng(Purpose.IMPAIRMENT, second)
    if first:
        cast(np.random.Philox, rng.bit_generator).advance(first * COLUMNS // 4)
    return rng.random((count, COLUMNS))


class Draws:
    """The random numbers of a link: for each message a row of them, whatever becomes of it.

    Rows begin anew with every second of due time, so that a session that starts again, on any
    clock, draws what it would have drawn. A setting takes its own column and leaves the others
    alone. `next` says at which place of the columns a message's numbers are.
    """

    def __init__(self, link: LinkSettings, seed: int, name: str, later_ns: int = 0) -> None:
        self._chance, self._later_ns = Chance(seed, name), later_ns
        self._second = -1
        self._row = self._first = self._end = 0
        self._rows_of_last_second = 0
        self._series = DelaySeries(link)
        self._is_clear, self._duplicates = link.is_clear, link.duplicate > 0

    def change(self, link: LinkSettings) -> None:
        """Draw what these settings need from the next message on."""
        self._series.use(self._row - self._first)
        self._series = DelaySeries(link, self._series.score)
        self._first = self._end = self._row
        self._is_clear, self._duplicates = link.is_clear, link.duplicate > 0

    def next(self, t_utc_ns: int) -> int:
        """The place of the next message, which is due then, in the columns."""
        second = (t_utc_ns - self._later_ns) // NS
        if second != self._second:
            self._begin(second)
        row = self._row
        if row >= self._end and not self._is_clear:
            self._draw()
        self._row = row + 1
        return row - self._first

    def _begin(self, second: int) -> None:
        self._series.use(self._row - self._first)
        self._second, self._rows_of_last_second = second, self._row
        self._row = self._first = self._end = 0

    def _draw(self) -> None:
        """Draw as many rows as the last second had; where that is not enough, twice as many."""
        row = self._row
        self._series.use(row - self._first)
        count = self._rows_of_last_second - row
        count = min(max(count if count > 0 else row, FEWEST_ROWS), MOST_ROWS)
        block = random_rows(self._chance, self._second, row, count)
        self._first, self._end = row, row + count
        *chances, own, copies = block.T
        columns: Iterator[list[float]] = (column.tolist() for column in chances)
        self.state, self.loss, self.duplicate, self.corrupt, self.bit, self.reorder = columns
        self.delay_ns, self.copy_delay_ns = self._series.draw(
            own, copies if self._duplicates else None
        )


class Impairment:
    """A link. It is told of every message, in the order of due times, also while it is clear.

    What it does depends on the seed, its name, the times and sizes of messages, and nothing else.
    """

    def __init__(self, link: LinkSettings, seed: int, name: str, later_ns: int = 0) -> None:
        """Chance is that of messages which are due `later_ns` sooner."""
        self._draws = Draws(link, seed, name, later_ns)
        self._rate = RateLimit(link)
        self._chain: LossChain | None = None
        self._state = 0
        self._now_utc_ns = self._latest_utc_ns = 0
        self._not_reordered = 0
        self._set(link)

    @property
    def link(self) -> LinkSettings:
        """The keys that it works by now."""
        return self._link

    def change(self, link: LinkSettings) -> None:
        """Do this from now on; what is on its way, the order and the state of loss carry on."""
        self._draws.change(link)
        self._rate.change(link)
        self._set(link)

    def _set(self, link: LinkSettings) -> None:
        self._link = link
        self._is_clear, self._keeps_order = link.is_clear, link.keeps_order
        before, self._chain = self._chain, None if link.loss is None else chain_of(link.loss)
        if self._chain is not None:
            known = before is not None and self._state < before.start == self._chain.start
            self._state = self._state if known else self._chain.start
        self._duplicate, self._corrupt, self._reorder = link.duplicate, link.corrupt, link.reorder
        self._is_plain = self._is_clear or not (
            link.duplicate or link.corrupt or link.reorder or link.rate_kbit_s
        )
        stalls = link.on_loss == "stall"
        self._waits_ns = waits_ns(DelayLaw.of(link)) if stalls else None
        self._stopped = (HELD if stalls else OUTAGE) if link.down else None

    def pass_on(self, due_utc_ns: int, octets: int) -> Outcome:
        """What becomes of a message that is due then, with a payload of that size.

        One that is due before the last one counts as due with that.
        """
        last_utc_ns = self._now_utc_ns
        t_utc_ns = self._now_utc_ns = due_utc_ns if due_utc_ns > last_utc_ns else last_utc_ns
        draws = self._draws
        i = draws.next(t_utc_ns)
        if self._is_clear:
            delay_ns = 0
        else:
            repeats = 0 if self._chain is None else self._repeats(self._chain, i)
            if self._stopped is not None:
                return self._stopped
            delay_ns = draws.delay_ns[i]
            if repeats:
                if self._waits_ns is None:
                    return LOST
                delay_ns += self._waits_ns[repeats]
        if self._is_plain:
            free_utc_ns = self._rate.free_utc_ns
            sent_utc_ns = t_utc_ns if t_utc_ns > free_utc_ns else free_utc_ns
            return _new(
                Outcome, (pb.SENT, (_new(Copy, (self._in_order(sent_utc_ns + delay_ns), None)),))
            )
        return self._changed(t_utc_ns, octets, delay_ns, i)

    def _changed(self, t_utc_ns: int, octets: int, delay_ns: int, i: int) -> Outcome:
        """Where more is asked than delay and loss."""
        first = self._leave(t_utc_ns, octets, delay_ns, i)
        if first is None:
            return QUEUE_FULL
        if self._duplicate and self._draws.duplicate[i] < self._duplicate:
            delay_ns = self._draws.copy_delay_ns[i]
            second = self._leave(t_utc_ns, octets, delay_ns, i, again=True)
            if second is not None:
                return Outcome(pb.SENT, (first, second))
        return Outcome(pb.SENT, (first,))

    def _repeats(self, chain: LossChain, i: int) -> int:
        """How often it must be sent again: 0 if it passes, 1 if nobody repeats what is lost."""
        before, u, v = self._state, self._draws.state[i], self._draws.loss[i]
        state = self._state = chain.targets[before][bisect_right(chain.edges[before], u)]
        if v >= chain.emissions[state]:
            return 0
        if self._waits_ns is None or self._stopped is not None:
            return 1
        repeats, self._state = chain.repeats(before, u, v, MOST_REPEATS)
        return repeats

    def _leave(
        self, t_utc_ns: int, octets: int, delay_ns: int, i: int, *, again: bool = False
    ) -> Copy | None:
        """A copy of the i-th message, or its second one `again`; None if the queue is full."""
        sent_utc_ns = self._rate.take(t_utc_ns, octets)
        if sent_utc_ns is None:
            return None
        if self._reorder is not None and self._overtakes(self._reorder, i, again=again):
            delay_ns = 0
        bit = self._flipped_bit(octets, i, again=again) if self._corrupt else None
        return Copy(self._in_order(sent_utc_ns + delay_ns), bit)

    def _in_order(self, due_utc_ns: int) -> int:
        if due_utc_ns >= self._latest_utc_ns:
            self._latest_utc_ns = due_utc_ns
        elif self._keeps_order:
            return self._latest_utc_ns
        return due_utc_ns

    def _overtakes(self, reorder: ReorderSettings, i: int, *, again: bool) -> bool:
        u = self._draws.reorder[i]
        if again:
            u = left_of(u, reorder.probability)
        self._not_reordered += 1
        if self._not_reordered < reorder.gap or u >= reorder.probability:
            return False
        self._not_reordered = 0
        return True

    def _flipped_bit(self, octets: int, i: int, *, again: bool) -> int | None:
        u, place = self._draws.corrupt[i], self._draws.bit[i] * 8 * octets
        if again:
            u, place = left_of(u, self._corrupt), place % 1 * 8 * octets
        return int(place) if u < self._corrupt and octets else None


class LinkExpectation:
    """What a link asks for, in closed form: what is delivered is held against it."""

    def __init__(self, link: LinkSettings) -> None:
        self.link = link
        self.delay = DelayLaw.of(link)  # Of the law alone, before a rate, an order or a stall
        self.loss = chain_of(link.loss)  # While the link is up; of what is repeated, if it stalls
