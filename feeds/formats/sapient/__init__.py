"""SAPIENT's row of the formats, which loads plotfeed[sapient] when a scene asks for it.

What a node is and its detections are in `sapient_node`; what it says of itself and does when it is
asked to in `sapient_announcer`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from google.protobuf.runtime_version import VersionError

from plotfeed.feeds.formats import Format, MessageFormat, Sensors
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.feeds.formats.sapient.sapient_announcer import SapientAnnouncer
    from plotfeed.proto.measured_plots import MeasuredPlots

INSTALL = "pip install 'plotfeed[sapient]'"


def need_sapient() -> None:
    """Raise `PlotfeedError` if the extra is not installed, or if what is does not load."""
    try:
        import sapient_msg
    except ImportError:
        raise PlotfeedError(f"SAPIENT needs sapient-proto: {INSTALL}") from None
    try:
        import sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2
    except ModuleNotFoundError as error:
        if str(error.name).startswith(sapient_msg.__name__):
            raise PlotfeedError(
                f"SAPIENT needs sapient-proto, and another package has its name: {INSTALL}"
            ) from None
        raise _does_not_load(error) from None
    except (ImportError, TypeError, VersionError) as error:  # of protobuf, where two define it
        raise _does_not_load(error) from None


def _does_not_load(error: Exception) -> PlotfeedError:
    why = " ".join(str(error).split())[:200]
    return PlotfeedError(
        f"sapient-proto does not load ({why}): {INSTALL}, without sapient-msg or sapient-py"
    )


def _reports(scene: Scene, sensors: Sensors) -> MessageFormat:
    need_sapient()
    from plotfeed.feeds.formats.sapient.sapient_node import SapientReports

    return SapientReports.of_sensors(scene, sensors)


def _plots_in(payload: bytes, _near_utc_ns: int) -> MeasuredPlots:
    need_sapient()
    from plotfeed.proto.sapient.decode_sapient import plots_in_sapient

    return plots_in_sapient(payload)


FORMAT = Format(facts=REPORT_FORMATS["sapient"], maker=_reports, plots_in=_plots_in)


def announcer_of(scene: Scene, sensor: Sensor) -> SapientAnnouncer | None:
    """What makes a node's messages of itself; None of a sensor that is none.

    Raises `PlotfeedError` without the extra.
    """
    if FORMAT.name not in sensor.report:
        return None
    need_sapient()
    from plotfeed.feeds.formats.sapient.sapient_announcer import SapientAnnouncer

    return SapientAnnouncer(scene, sensor)


def in_time(scene: Scene) -> Callable[[Message, int], bytes | None] | None:
    """Payload of a message as it may leave at a time, or None if it is too late for it.

    Where no sensor is a node, nothing is ever too late: there is no such rule.
    """
    if not any(FORMAT.name in sensor.report for sensor in scene.sensor):
        return None
    need_sapient()
    from plotfeed.feeds.formats.sapient.sapient_node import as_it_may_leave

    def check(message: Message, t_utc_ns: int) -> bytes | None:
        if not message.topic.endswith(f"/{FORMAT.facts.topic}"):
            return message.payload
        return as_it_may_leave(message, t_utc_ns, scene.sapient.late)

    return check
