"""A message: what goes out, whatever carries it, what came in, and filters of topics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from plotfeed.feeds.messages.user_properties import Pair, dashed, type_of
from plotfeed.proto.content_types import JSON
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc

MESSAGE_EXPIRY_S = 60
"""So long a broker keeps a message that it cannot pass on."""


@dataclass(slots=True)  # frozen or by keywords, it would take some times as long to make
class Message:
    """A payload, where it goes, and when it is due there; it stays as it was made.

    `properties` become MQTT 5 user properties; whoever cannot read those finds the same in the
    payload.
    """

    topic: str
    payload: bytes
    content_type: str
    due_utc_ns: int
    properties: Sequence[Pair] = ()
    retain: bool = False
    qos: int = 0
    packets: dict[int, bytes] = field(init=False, default_factory=dict, compare=False, repr=False)
    """The message as MQTT packets, by version, where they were made ahead of time."""


def attributes(
    source: str, kind: str, number: str, t_utc_ns: int, **more: object
) -> tuple[Pair, ...]:
    """Properties of a message about that time; `number` tells those of a source and kind apart."""
    return (
        ("specversion", "1.0"),
        ("id", f"{dashed(kind)}-{number}"),
        ("source", source),
        ("type", type_of(kind)),
        ("time", iso_utc(t_utc_ns)),
        *[(name, str(value)) for name, value in more.items()],
    )


def retained_message(
    source: str, kind: str, payload: bytes, now_utc_ns: int, **more: str
) -> Message:
    """A message in JSON for whoever comes later, of QoS 1, on the topic {source}/{kind}."""
    return Message(
        topic=f"{source}/{kind}",
        payload=payload,
        content_type=JSON,
        due_utc_ns=now_utc_ns,
        properties=attributes(source, kind, str(now_utc_ns), now_utc_ns, **more),
        retain=True,
        qos=1,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceivedMessage:
    """A message as it came, over MQTT 5 or, without content type and properties, 3.1.1."""

    topic: str
    payload: bytes
    content_type: str | None
    properties: tuple[tuple[str, str], ...]
    """User properties."""
    retain: bool
    """Whether it was published so; over MQTT 3.1.1, whether it was there before we were."""
    qos: int
    """The lower one of what it was published with and 1."""


OnReceived = Callable[[ReceivedMessage], None]


def checked_topic_filter(topic_filter: str) -> str:
    """A text that is a topic filter, + a level and # the rest; raises `PlotfeedError` if not."""
    levels = topic_filter.split("/")
    for place, level in enumerate(levels):
        alone = len(level) == 1 and (level == "+" or place == len(levels) - 1)
        if ("+" in level or "#" in level) and not alone:
            raise PlotfeedError(f"{topic_filter!r}: + is a whole level, # is the last one")
    return topic_filter


def topic_matches(topic_filter: str, topic: str) -> bool:
    """Whether a topic is one of those that the filter is for."""
    wanted, levels = topic_filter.split("/"), topic.split("/")
    for place, level in enumerate(wanted):
        if level == "#":
            return True
        if place >= len(levels) or level not in ("+", levels[place]):
            return False
    return len(wanted) == len(levels)


def is_chosen(topic: str, filters: Sequence[str]) -> bool:
    """Whether a topic is one of those that one of the filters is for; without any, all are."""
    return not filters or any(topic_matches(each, topic) for each in filters)
