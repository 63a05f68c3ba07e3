"""`Uplink`: the messages of one client through its link, when each leaves and what is lost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from plotfeed.feeds.link.impairment import Impairment, flip
from plotfeed.feeds.messages.message import HELD_NS, Message
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.proto import plotfeed_pb2 as pb

# A message's payload as it may still leave at that time, or None if it is too late for it.
InTime = Callable[[Message, int], bytes | None]


class Uplink:
    """A link of one client, which numbers its messages in the order in which they are due."""

    def __init__(
        self,
        link: LinkSettings | None,
        seed: int,
        name: str,
        in_time: InTime | None = None,
        *,
        later_ns: int = 0,
    ) -> None:
        """Messages leave at once where `link` is None.

        By seed and name chance is the same in each run, in a replay that is `later_ns` later, too.
        """
        self.link = link  # Its keys now
        self.json = json_of(link)  # The same as the ledger tells them
        self._impair = partial(Impairment, seed=seed, name=name, later_ns=later_ns)
        self._in_time = in_time
        self._impairment = None if link is None else self._impair(link)
        self._number = 0
        # What waits for the link to be up again, each with the others of its sector.
        self._held: list[tuple[Message, list[Message]]] = []

    def passed(self, messages: Sequence[Message]) -> Sequence[Message]:
        """Messages that are handed to the link when they are due, each with what becomes of it.

        A copy that the link makes comes behind its message.
        """
        for number, one in enumerate(messages, self._number):
            one.number = number
        self._number += len(messages)
        if self._impairment is None:
            return messages
        found: list[Message] = []
        for one in messages:
            one.over_link = True
            found.append(one)
            self._pass(one, found, self._impairment, one.due_utc_ns)
        return found

    def change(self, link: LinkSettings | None, at_utc_ns: int) -> list[Message]:
        """Be so for what comes from then on; what was held, and leaves then or is lost."""
        self.link, self.json = link, json_of(link)
        settings = link or LinkSettings()
        if self._impairment is None:
            self._impairment = self._impair(settings)
        else:
            self._impairment.change(settings)
        let_go: list[Message] = []
        held, self._held = self._held, []
        for one, others in held:
            copies = len(others)
            self._pass(one, others, self._impairment, at_utc_ns)
            if one.leaves_utc_ns != HELD_NS:
                let_go += [one, *others[copies:]]
        return let_go

    def _pass(
        self, one: Message, others: list[Message], impairment: Impairment, t_utc_ns: int
    ) -> None:
        """Ask the link what becomes of one that is handed to it then, or again."""
        fate, copies = impairment.pass_on(t_utc_ns, len(one.payload))
        if not fate:  # it holds what comes
            if len(self._held) < impairment.link.queue_messages:
                one.leaves_utc_ns = HELD_NS
                self._held.append((one, others))
            else:
                one.leaves_utc_ns, one.fate = one.due_utc_ns, pb.QUEUE_FULL
        elif fate != pb.SENT:
            one.leaves_utc_ns, one.fate = one.due_utc_ns, fate
        else:
            for copy, (leaves_utc_ns, flipped_bit) in enumerate(copies):
                if copy:
                    one = one.duplicate()
                    others.append(one)
                one.leaves_utc_ns = leaves_utc_ns
                if flipped_bit is not None:
                    one.flipped_bit = flipped_bit
                    one.become(flip(one.payload, flipped_bit))
                if self._in_time is not None:
                    payload = self._in_time(one, leaves_utc_ns)
                    if payload is None:
                        one.fate = pb.STALE
                    elif payload is not one.payload:
                        one.become(payload)


def json_of(link: LinkSettings | None) -> str:
    """A link's keys for the ledger, without those that have their defaults; empty for none."""
    return "" if link is None else link.model_dump_json(exclude_defaults=True)
