"""Strangers at a door: whose octets have a turn when, and who keeps a place where places are few.

What all doors grant is in `PEER_LIMITS`.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from plotfeed.feeds.telemetry.fair_queue import MAX_OF_TOPIC, FairQueue
from plotfeed.feeds.telemetry.live.heard import HeardReport, Listener, remember, unforeseen
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused


@dataclass(frozen=True, slots=True)
class PeerLimits:
    """What one kind of door grants those who come to it."""

    peers: int  # At a time; with one more, the one that has been silent longest gives way
    octets: int  # Of one message, or of what is taken at once
    patience_s: float = math.inf  # For a request to be there, and its answer to be taken


PEER_LIMITS: Mapping[str, PeerLimits] = {
    "live source, UDP": PeerLimits(256, 1 << 16),
    "live source, TCP": PeerLimits(64, 1 << 16),
    "live source, serial port, file or pipe": PeerLimits(1, 1 << 16),
    # Some 1,000 flights: of the 7 km that may be asked for, more than anybody has.
    "live source, HTTP: an answer": PeerLimits(1, 512 << 10, 10.0),
    "service of network Remote ID: a request": PeerLimits(100, 8192, 5.0),
    "live page: a request": PeerLimits(50, 1 << 16, 5.0),
}
# Octets of a stream that wait and are read together: a few messages, between which others go.
SLICE_OCTETS = 512
# Reports are made for so long at once, and then as many times as long not: a deadline is late by
# no more than the first, and the session has the rest of the time.
AT_ONCE_S, PAUSES = 0.001, 3.0
MAX_KNOWN = 1000  # Peers of whom something was understood
Who = TypeVar("Who", bound=Hashable)


class PeerTurns:
    """Octets of peers wait in short queues, have their turn, and reports come of them.

    All together have a share of the time, and each an equal share of that.
    """

    def __init__(
        self,
        listener: Listener,
        *,
        say: Callable[[HeardReport], object],
        note: Callable[[str], object],
        now_utc_ns: Callable[[], int],
        now_s: Callable[[], float] = time.perf_counter,
    ) -> None:
        """`say` is told of each report and refusal, `note` of what listeners find out.

        `now_s` is the clock by which it is seen what that takes.
        """
        self._listener, self._say, self._note = listener, say, note
        self._now_utc_ns, self._now_s = now_utc_ns, now_s
        self._waiting = FairQueue()
        self._known: dict[str, None] = {}
        self._speaker = ""
        self._said: Iterator[HeardReport] = iter(())
        self._full: dict[str, asyncio.Event] = {}
        self._leaving: set[str] = set()
        self._rests_until_s = 0.0
        self._timer: asyncio.TimerHandle | None = None

    def put(self, peer: str, data: bytes) -> None:
        """Have octets wait of a peer that cannot be held up; those without room are refused."""
        self._waiting.put(peer, data, None)
        if self._timer is None:
            self._plan()

    async def hear(self, peer: str, data: bytes) -> None:
        """Have octets of a stream wait; returns when there is room for more of it."""
        for at in range(0, len(data), SLICE_OCTETS):
            while self._waiting.of_topic(peer) >= MAX_OF_TOPIC:
                await self._full.setdefault(peer, asyncio.Event()).wait()
            self.put(peer, data[at : at + SLICE_OCTETS])

    def gone(self, peer: str) -> None:
        """Forget what is incomplete of a peer that has gone, when all it has said had its turn."""
        if peer == self._speaker or self._waiting.of_topic(peer):
            self._leaving.add(peer)
        else:
            self._listener.forget(peer)

    def refuse(self, why: str, number: int = 1) -> None:
        """Refuse something, so many times, of which nothing more is known."""
        self._say(HeardReport("", Refused(Reason.FLOOD, why, count=number)))

    async def emptied(self) -> None:
        """Return when nothing waits."""
        while self._timer is not None:  # noqa: ASYNC110 - of a queue that others fill
            await asyncio.sleep(AT_ONCE_S)

    def close(self) -> None:
        """Let nobody speak any more, and tell what found no room until now."""
        self._tell_dropped()
        if self._timer is not None:
            self._timer.cancel()

    def _plan(self) -> None:
        rest_s = max(self._rests_until_s - self._now_s(), 0.0)
        self._timer = asyncio.get_running_loop().call_later(rest_s, self._serve)

    def _serve(self) -> None:
        began_s = now_s = self._now_s()
        while (has_more := self._go_on()) and now_s - began_s < AT_ONCE_S:
            now_s = self._now_s()
        self._rests_until_s = now_s + PAUSES * (now_s - began_s)
        self._timer = None
        self._tell_dropped()
        for note in self._listener.notes():
            self._note(note)
        if has_more:
            self._plan()

    def _tell_dropped(self) -> None:
        for whose, number in self._waiting.dropped.items():
            self.refuse(f"{whose or 'others'}: more comes than there is time for", number)
        self._waiting.dropped.clear()

    def _go_on(self) -> bool:
        """The next report of who speaks, or the next speaker; False if there is none."""
        try:
            heard = next(self._said, None)
            if heard is not None:
                if isinstance(heard.said, PositionReport):
                    # Who was understood keeps room before those of whom nothing ever was.
                    if self._speaker not in self._known:
                        self._waiting.know(self._speaker)
                    for other in remember(self._known, self._speaker, None, MAX_KNOWN):
                        self._waiting.forget(other)
                self._say(heard)
                return True
            if self._speaker in self._leaving and not self._waiting.of_topic(self._speaker):
                self._leaving.remove(self._speaker)
                self._listener.forget(self._speaker)
            self._speaker = ""
            if not self._waiting:
                return False
            self._speaker, [(data, _)] = self._waiting.take_one()
            if self._waiting.of_topic(self._speaker) < MAX_OF_TOPIC and self._full:
                self._full.pop(self._speaker, asyncio.Event()).set()
            self._said = self._listener.hear(self._speaker, data, self._now_utc_ns())
        except Exception as error:  # noqa: BLE001 - of strangers' octets, whatever it is
            self._say(HeardReport("", unforeseen(error)))
        return True


class Places(Generic[Who]):
    """Who is connected, or has yet to ask: with one too many, somebody gives way.

    It is who has been silent longest, of the host that has most; who says nothing for as long as
    the door's patience lasts, goes in any case.
    """

    def __init__(self, limits: PeerLimits) -> None:
        self._limits = limits
        # Whose place it is, the one that has been silent longest first: of which host, how it is
        # made to go, and by when.
        self._held: dict[Who, tuple[str, Callable[[], object], asyncio.TimerHandle | None]] = {}

    def __contains__(self, who: Who) -> bool:
        """Whether that one has a place."""
        return who in self._held

    def take(self, who: Who, host: str, leave: Callable[[], object]) -> None:
        """Give somebody a place, who is made to `leave` if it has to."""
        if len(self._held) >= self._limits.peers:
            hosts = [host, *(held[0] for held in self._held.values())]
            most = max(set(hosts), key=hosts.count)
            of_most = (other for other, held in self._held.items() if held[0] == most)
            self._leave(next(of_most, next(iter(self._held))))
        patience_s, timer = self._limits.patience_s, None
        if patience_s < math.inf:
            timer = asyncio.get_running_loop().call_later(patience_s, self._leave, who)
        self._held[who] = host, leave, timer

    def heard(self, who: Who) -> None:
        """Have somebody be the last to give way: it has just said something."""
        if who in self._held:
            self._held[who] = self._held.pop(who)

    def give_up(self, who: Who) -> None:
        """Free somebody's place, if it has one."""
        timer = self._held.pop(who, ("", None, None))[2]
        if timer is not None:
            timer.cancel()

    def _leave(self, who: Who) -> None:
        leave = self._held[who][1]
        self.give_up(who)
        leave()
