"""`Uplink`: the messages of one client through its link, when each leaves and what is lost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from plotfeed.feeds.link.impairment import Fate, Impairment, flip
from plotfeed.feeds.messages.bounded_queue import BoundedQueue
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import HELD_NS, Outgoing
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.proto import plotfeed_pb2 as pb

# The message as it may still leave at that time, or None if it is too late for it.
InTime = Callable[[Message, int], Message | None]

_FATES = {Fate.LOST: pb.LOST, Fate.QUEUE_FULL: pb.QUEUE_FULL, Fate.OUTAGE: pb.OUTAGE}


class Uplink:
    """A link of one client, which numbers its messages in the order in which they are due."""

    def __init__(
        self,
        link: LinkSettings | None,
        impair: Callable[[LinkSettings], Impairment],
        in_time: InTime | None = None,
    ) -> None:
        """Messages leave at once where `link` is None; `impair` makes the impairment of a link."""
        self.link = link  # Its keys now
        self.json = json_of(link)  # The same as the ledger tells them
        self._impair, self._in_time = impair, in_time
        self._impairment = None if link is None else impair(link)
        self._number = 0
        # What waits for the link to be up again, each with the others of its sector.
        self._held: BoundedQueue[tuple[Outgoing, list[Outgoing]]] = BoundedQueue(0)

    def passed(self, messages: Sequence[Message]) -> list[Outgoing]:
        """What becomes of messages that are handed to the link when they are due, in that order.

        A copy that the link makes comes behind its message.
        """
        first, self._number = self._number, self._number + len(messages)
        made = list(map(Outgoing, messages, range(first, self._number)))
        if self._impairment is None:
            return made
        found: list[Outgoing] = []
        for one in made:
            one.over_link = True
            found.append(one)
            self._pass(one, found, self._impairment, one.due_utc_ns)
        return found

    def change(self, link: LinkSettings | None, at_utc_ns: int) -> list[Outgoing]:
        """Be so for what comes from then on; what was held, and leaves then or is lost."""
        self.link, self.json = link, json_of(link)
        settings = link or LinkSettings()
        if self._impairment is None:
            self._impairment = self._impair(settings)
        else:
            self._impairment.change(settings)
        let_go: list[Outgoing] = []
        for one, others in [self._held.take() for _ in range(len(self._held))]:
            copies = len(others)
            self._pass(one, others, self._impairment, at_utc_ns)
            if one.due_utc_ns != HELD_NS:
                let_go += [one, *others[copies:]]
        return let_go

    def _pass(
        self, one: Outgoing, others: list[Outgoing], impairment: Impairment, t_utc_ns: int
    ) -> None:
        """Ask the link what becomes of one that is handed to it then, or again."""
        outcome = impairment.pass_on(t_utc_ns, len(one.handed.payload))
        if outcome.fate is Fate.HELD:
            one.due_utc_ns = HELD_NS
            self._held.limit = impairment.link.queue_messages
            if not self._held.put((one, others)):
                one.due_utc_ns, one.fate = one.handed.due_utc_ns, pb.QUEUE_FULL
        elif outcome.fate is not Fate.SENT:
            one.due_utc_ns, one.fate = one.handed.due_utc_ns, _FATES[outcome.fate]
        else:
            for copy, (due_utc_ns, flipped_bit) in enumerate(outcome.copies):
                if copy:
                    one = one.duplicate()
                    others.append(one)
                self._leave(one, due_utc_ns, flipped_bit)

    def _leave(self, one: Outgoing, due_utc_ns: int, flipped_bit: int | None) -> None:
        one.due_utc_ns, one.flipped_bit = due_utc_ns, flipped_bit
        message: Message | None = one.handed
        if flipped_bit is not None:
            message = replace(one.handed, payload=flip(one.handed.payload, flipped_bit))
        if self._in_time is not None and message is not None:
            message = self._in_time(message, due_utc_ns)
        if message is None:
            one.fate = pb.STALE
        else:
            one.message = message


def json_of(link: LinkSettings | None) -> str:
    """A link's keys for the ledger, without those that have their defaults; empty for none."""
    return "" if link is None else link.model_dump_json(exclude_defaults=True)
