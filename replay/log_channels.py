"""Channels of the native log: what a series of messages has in common, ours and that of others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from plotfeed.replay.recorded import Recorded, Stage

OURS = "plotfeed."
"""Before our names in a channel's metadata."""
BEFORE, PROPERTIES = "before/", "properties/"
"""Before topics, where one topic has several channels."""
PROTOBUF, JSON, ASTERIX = "application/x-protobuf", "application/json", "application/x-asterix"
MESSAGE_TYPE = "messageType="


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """What messages of a channel have in common."""

    topic: str
    content_type: str = ""
    stage: Stage = Stage.RECEIVED
    retain: bool = False
    qos: int = 0

    @classmethod
    def of(cls, recorded: Recorded) -> Series:
        """That of a message."""
        return cls(
            topic=recorded.topic,
            content_type=recorded.content_type,
            stage=recorded.stage,
            retain=recorded.retain,
            qos=recorded.qos,
        )

    @property
    def shown_topic(self) -> str:
        """The topic under which other tools list it."""
        return (BEFORE if self.stage is Stage.BEFORE else "") + self.topic

    def metadata(self, *, of_properties: bool) -> dict[str, str]:
        """Everything, for a channel of the messages, or of their user properties."""
        return {
            f"{OURS}topic": self.topic,
            f"{OURS}stage": str(self.stage),
            f"{OURS}content_type": self.content_type,
            f"{OURS}retain": "true" if self.retain else "false",
            f"{OURS}qos": str(self.qos),
            f"{OURS}holds": "properties" if of_properties else "messages",
        }


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel of a file that is read."""

    series: Series
    holds_properties: bool = False
    """Whether its messages are the user properties of the series' messages."""


def channel_of(topic: str, encoding: str, schema: str, metadata: Mapping[str, str]) -> Channel:
    """From the fields of its record; one that is not ours has been received."""
    given = {name.removeprefix(OURS): v for name, v in metadata.items() if name.startswith(OURS)}
    try:
        series = Series(
            topic=given["topic"],
            content_type=given["content_type"],
            stage=Stage(given["stage"]),
            retain=given["retain"] == "true",
            qos=int(given["qos"]),
        )
    except (KeyError, ValueError):
        return Channel(Series(topic=topic, content_type=_content_type(encoding, schema)))
    return Channel(series, given.get("holds") == "properties")


def encoding_of(content_type: str) -> str:
    """MCAP's name for how messages of a content type are written."""
    kind = content_type.partition(";")[0].strip()
    return {PROTOBUF: "protobuf", JSON: "json", ASTERIX: "asterix"}.get(kind, kind)


def message_type_of(series: Series) -> str:
    """Full name of the protobuf message that the messages are; empty if it is not known."""
    kind, _, parameters = series.content_type.partition(";")
    if kind.strip() != PROTOBUF:
        return ""
    for parameter in parameters.split(";"):
        if parameter.strip().startswith(MESSAGE_TYPE):
            return parameter.strip().removeprefix(MESSAGE_TYPE)
    return "plotfeed.v1.Telemetry" if series.stage is Stage.TELEMETRY else ""


def _content_type(encoding: str, schema: str) -> str:
    """What others wrote, in our words."""
    if encoding == "protobuf":
        return f"{PROTOBUF}; {MESSAGE_TYPE}{schema}" if schema else PROTOBUF
    return {"json": JSON, "asterix": ASTERIX}.get(encoding, f"application/x-{encoding or 'octets'}")
