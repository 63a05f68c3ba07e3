"""What a sensor says of itself in SAPIENT: that it is there, how it is, that it goes."""

from __future__ import annotations

import contextlib
from dataclasses import replace

from plotfeed.feeds.formats.sapient.sapient_node import node_of
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.sapient.decode_sapient import restamped
from plotfeed.proto.sapient.encode_node import registration, status
from plotfeed.proto.utc import NS, iso_utc

CONTENT_TYPE = REPORT_FORMATS["sapient"].content_type
REGISTRATION = ("type", "plotfeed.sapient.registration")
STATUS = ("type", "plotfeed.sapient.status")
MAX_LATE_NS = 800_000_000
"""A stamp may be a group of sectors older, up to 94 ms, and the last way takes some time too."""


class SapientAnnouncer:
    """Makes the messages of a node besides its detections, stamped when they are asked for."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self.sensor = sensor.id
        self.every_ns = round(scene.sapient.status_interval_s * NS)
        self._root = f"{scene.mqtt.prefix}/{sensor.id}"
        self._node = node_of(scene, sensor)

    def opening(self, now_utc_ns: int) -> list[Message]:
        """Registration and a first status; on every connection before anything else."""
        return [
            self._message(registration(self._node, now_utc_ns), now_utc_ns, REGISTRATION),
            self._message(status(self._node, now_utc_ns, new=True), now_utc_ns, STATUS),
        ]

    def regular(self, now_utc_ns: int) -> list[Message]:
        """News that nothing has changed."""
        return [self._message(status(self._node, now_utc_ns), now_utc_ns, STATUS)]

    def closing(self, now_utc_ns: int) -> list[Message]:
        """Goodbye: news, for a status that is unchanged would have to be the last one."""
        farewell = status(self._node, now_utc_ns, system="GOODBYE", new=True)
        return [self._message(farewell, now_utc_ns, STATUS)]

    def _message(self, payload: bytes, now_utc_ns: int, kind: tuple[str, str]) -> Message:
        return Message(
            topic=f"{self._root}/sapient",
            payload=payload,
            content_type=CONTENT_TYPE,
            due_utc_ns=now_utc_ns,
            qos=1,
            properties=(
                ("specversion", "1.0"),
                ("id", f"{kind[1].rpartition('.')[2]}-{now_utc_ns}"),
                ("source", self._root),
                kind,
                ("time", iso_utc(now_utc_ns)),
                ("sensor", self.sensor),
            ),
        )


def is_registration(message: Message) -> bool:
    """Whether a message is the first that a node sends."""
    return REGISTRATION in message.properties


def as_it_may_leave(message: Message, t_utc_ns: int, rule: str) -> Message | None:
    """The message as it leaves at that time, or None if it is dropped."""
    if t_utc_ns - message.due_utc_ns <= MAX_LATE_NS or rule == "send":
        return message
    if rule == "drop":
        return None
    with contextlib.suppress(DecodeError):  # of a message that the link has corrupted
        return replace(message, payload=restamped(message.payload, t_utc_ns))
    return message
