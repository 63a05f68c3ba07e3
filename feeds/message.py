"""A message on its way out, whatever carries it."""

from __future__ import annotations

from dataclasses import dataclass, field

PROTOBUF = "application/x-protobuf"
JSON = "application/json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """A payload, where it goes, and when it is due there.

    `properties` become MQTT 5 user properties; whoever cannot read those finds the same in the
    payload.
    """

    topic: str
    payload: bytes
    content_type: str
    due_utc_ns: int
    properties: tuple[tuple[str, str], ...] = ()
    retain: bool = False
    qos: int = 0
    packets: dict[int, bytes] = field(init=False, default_factory=dict, compare=False, repr=False)
    """The message as MQTT packets, by version, where they were made ahead of time."""
