"""The door to SAPIENT: behind it is plotfeed[sapient], which no other scene imports."""

from __future__ import annotations

from typing import TYPE_CHECKING

from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.feeds.delivery.outbox import InTime
    from plotfeed.feeds.formats.sapient.announcer import SapientAnnouncer
    from plotfeed.feeds.formats.sapient.sapient_reports import SapientReports
    from plotfeed.feeds.messages.message import Message
    from plotfeed.feeds.scene.scene import Scene
    from plotfeed.feeds.scene.sensors import Sensor
    from plotfeed.feeds.timing.clock import Clock
    from plotfeed.feeds.transport.sapient_tcp import SapientTcpLink


def need_sapient() -> None:
    """Raise `PlotfeedError` if the extra is not installed."""
    try:
        import sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2  # noqa: F401
    except ImportError:
        raise PlotfeedError(
            "SAPIENT needs sapient-proto: pip install 'plotfeed[sapient]'"
        ) from None


def reports(scene: Scene, sensor: Sensor) -> SapientReports:
    """The format; raises `PlotfeedError`."""
    need_sapient()
    from plotfeed.feeds.formats.sapient.sapient_reports import SapientReports

    return SapientReports(scene, sensor)


def herald(scene: Scene, sensor: Sensor) -> SapientAnnouncer | None:
    """Whoever announces the sensor, if it reports in SAPIENT; raises `PlotfeedError`."""
    if "sapient" not in sensor.report:
        return None
    need_sapient()
    from plotfeed.feeds.formats.sapient.announcer import SapientAnnouncer

    return SapientAnnouncer(scene, sensor)


def in_time(scene: Scene) -> InTime:
    """The rule for messages of SAPIENT that leave late."""

    def check(message: Message, t_utc_ns: int) -> Message | None:
        if not message.topic.endswith("/sapient"):
            return message
        from plotfeed.feeds.formats.sapient.announcer import as_it_may_leave

        return as_it_may_leave(message, t_utc_ns, scene.sapient.late)

    return check


def middleware_links(
    scene: Scene, herald: SapientAnnouncer | None, clock: Clock
) -> list[SapientTcpLink]:
    """A sensor's own connection to the scene's middleware, if there is one."""
    if herald is None or scene.sapient.middleware is None:
        return []
    from plotfeed.feeds.transport.sapient_tcp import SapientTcpLink

    return [SapientTcpLink(scene.sapient.middleware, herald, clock)]
