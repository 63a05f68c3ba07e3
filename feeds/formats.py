"""From plots to messages: one class for each format that a sensor can report in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from plotfeed.feeds.message import PROTOBUF, Message
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.sensors import Sensor
from plotfeed.feeds.sensors.base import RotatingScan
from plotfeed.feeds.times import iso_utc
from plotfeed.models.scan import Sector
from plotfeed.models.state import Plots
from plotfeed.proto.asterix.plots import PlotEncoder048, ServiceEncoder034
from plotfeed.proto.batch import plot_batch

MAX_BLOCK_OCTETS = 65535


class Format(Protocol):
    """Makes the messages that carry one sector's plots."""

    def messages(self, sector: Sector, plots: Plots) -> list[Message]:
        """Due when the sector ends, in the order in which they are to leave."""


def formats_of(scene: Scene, sensor: Sensor) -> list[Format]:
    """The formats that the scene asks of a sensor."""
    make: dict[str, Callable[[Scene, Sensor], Format]] = {
        "asterix-048": Asterix048,
        "plots": PlotBatches,
    }
    return [make[name](scene, sensor) for name in dict.fromkeys(sensor.report)]


class _Topics:
    """Addresses a sensor's messages, with CloudEvents attributes as MQTT 5 user properties."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._root = f"{scene.mqtt.prefix}/{sensor.id}"
        self._sensor = sensor.id
        self._qos = scene.mqtt.qos

    def message(self, kind: str, content_type: str, payload: bytes, sector: Sector) -> Message:
        place = (str(sector.scan), str(sector.index))
        return Message(
            topic=f"{self._root}/{kind}",
            payload=payload,
            content_type=content_type,
            due_utc_ns=sector.end_ns,
            qos=self._qos,
            properties=(
                ("specversion", "1.0"),
                ("id", "-".join(place)),
                ("source", self._root),
                ("type", f"plotfeed.{kind.replace('/', '.')}"),
                ("time", iso_utc(sector.end_ns)),
                ("sensor", self._sensor),
                ("scan", place[0]),
                ("sector", place[1]),
            ),
        )


def max_block_octets(scene: Scene, sensor: Sensor) -> int:
    """What a data block may hold so that it fits wherever the sensor's messages go."""
    datagrams = (udp.max_octets for udp in scene.udp if udp.takes(sensor.id))
    return min(datagrams, default=MAX_BLOCK_OCTETS)


class Asterix048:
    """Target reports of category 048, and service messages of 034 where a beam turns.

    A sector's target reports leave when its end is crossed, before the message that says so; the
    north marker comes before the crossing of sector 0.
    """

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._topics = _Topics(scene, sensor)
        self._plots = PlotEncoder048(
            sensor.sac,
            sensor.sic,
            geoid_undulation_m=scene.telemetry.geoid_undulation_m or 0.0,
            max_octets=max_block_octets(scene, sensor),
        )
        self._service = None
        if isinstance(sensor.scan, RotatingScan):
            self._service = ServiceEncoder034(
                sensor.sac, sensor.sic, antenna_period_s=sensor.scan.period_s
            )

    def messages(self, sector: Sector, plots: Plots) -> list[Message]:
        """Blocks of category 048, then those of category 034."""
        blocks = [("048", block) for block in self._plots.blocks(plots)]
        if self._service is not None:
            if sector.end_deg >= 360.0:
                blocks.append(("034", self._service.north_marker(sector.end_ns)))
            crossed_deg = sector.end_deg % 360.0
            blocks.append(("034", self._service.sector_crossing(sector.end_ns, crossed_deg)))
        return [
            self._topics.message(
                f"asterix/{category}", f"application/x-asterix; cat={int(category)}", block, sector
            )
            for category, block in blocks
        ]


class PlotBatches:
    """plotfeed's own protobuf, one message a sector; an empty one says that nothing was found."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._topics = _Topics(scene, sensor)
        self._sensor = sensor.id

    def messages(self, sector: Sector, plots: Plots) -> list[Message]:
        """One message."""
        batch = plot_batch(self._sensor, sector.scan, sector.index, plots)
        content_type = f"{PROTOBUF}; messageType=plotfeed.v1.PlotBatch"
        return [self._topics.message("plots", content_type, batch, sector)]
