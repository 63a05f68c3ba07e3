"""The live sources of a session: what they hear goes in as if drones had published it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.decode_reports import encode_protobuf
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused
from plotfeed.feeds.timing.clock import Clock, WallClock
from plotfeed.proto.content_types import PROTOBUF
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.feeds.telemetry.live.mapped_reports import MappedReports
    from plotfeed.feeds.transport.live_source import LiveSource


def sources_of(
    scene: Scene,
    clock: Clock,
    queue: Callable[[str, bytes, str | None], None],
    refuse: Callable[[str, Refused], None],
) -> list[LiveSource]:
    """The sources of a scene, not open yet; raises `PlotfeedError` where one cannot be.

    Reports go to `queue` as messages on the topics of their drones: so queues, refusals and
    recordings treat them like all telemetry.
    """
    sources = scene.outgoing.sources
    if not sources:
        return []
    if not (isinstance(clock, WallClock) and clock.is_real):
        raise PlotfeedError(
            "telemetry.source: live sources need real time: neither start_utc nor another --speed"
        )
    root = f"{scene.mqtt.prefix}/telemetry/"

    def take(drone: str, report: PositionReport) -> None:
        queue(root + drone, encode_protobuf(report), PROTOBUF)

    def not_taken(kind: str, drone: str, refused: Refused) -> None:
        refuse(root + (drone or kind), refused)

    from plotfeed.feeds.transport.live_source import LiveSource

    return [
        LiveSource(
            source,
            now_utc_ns=clock.now_ns,
            take=take,
            refuse=partial(not_taken, source.address.kind),
        )
        for source in sources
    ]


def taker_of_mapped(
    mapped: MappedReports | None,
    scene: Scene,
    clock: Clock,
    queue: Callable[[str, bytes, str | None], None],
    refuse: Callable[[str, Refused], None],
) -> Callable[[str, bytes], bool] | None:
    """A function that takes what other systems publish as if their drones had published it.

    Given topic and payload, it says whether the topic is mapped. None where none is.
    """
    if mapped is None:
        return None

    def take(topic: str, payload: bytes) -> bool:
        heard = mapped.hear(topic, payload, clock.now_ns())
        if heard is None:
            return False
        to = f"{scene.mqtt.prefix}/telemetry/{heard.drone}" if heard.drone else topic
        if isinstance(heard.said, Refused):
            refuse(to, heard.said)
        else:
            queue(to, encode_protobuf(heard.said), PROTOBUF)
        return True

    return take
