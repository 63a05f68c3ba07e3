"""What formats have in common: rows of their table, their two kinds, and addresses of messages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Address, Message, SectorProperties, SectorStamp
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.state import Ints
from plotfeed.proto.content_types import asterix_content_type
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.report_format import ReportFormat
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.proto.measured_plots import MeasuredPlots

MAX_BLOCK_OCTETS = 65535
"""What the length field of an ASTERIX data block can say."""
SERVICE_PERIOD_NS = 10 * NS
"""How often a sensor says where it stands and that it works."""
Sensors = Mapping[int, Sensor]
"""Sensors by their index in the scene."""
PLACE = "position_enu_m"
KEYS_OF_ITEMS = {
    "I034/041": "scan.period_s",
    "I034/120": PLACE,
    "I025/600": PLACE,
    "I016/400": PLACE,
    "I016/420": PLACE,
    "I016/410": "transmitters",
    "I205/050": PLACE,
}
"""Of a sensor, by the item that says it; a place that is the site's is the site's key."""
Blocks = list[tuple[int, bytes]]
"""Data blocks of ASTERIX, each with its category."""


class MessageFormat(Protocol):
    """Makes the messages that carry what came of sectors of a scene's sensors."""

    def messages(self, batch: Batch) -> list[list[Message]]:
        """Messages of each sector, due when it ends, in the order in which they are to leave."""


class Announcer(Protocol):
    """Makes what a sensor says of itself in a format, stamped by its clock when it is asked for."""

    every_ns: int
    """How often it says that nothing has changed."""
    inbox: str
    """Topic on which somebody may ask something of the sensor."""

    def opening(self, now_utc_ns: int) -> list[Message]:
        """What comes before anything else, on every connection."""

    def regular(self, now_utc_ns: int) -> list[Message]:
        """News that nothing has changed."""

    def closing(self, now_utc_ns: int) -> list[Message]:
        """Goodbye."""

    def changed(self, sensor: Sensor, now_utc_ns: int) -> list[Message]:
        """What there is to say of the sensor's new keys."""

    def answer(
        self, payload: bytes, now_utc_ns: int, change: Callable[[Mapping[str, Any] | None], object]
    ) -> AnnouncerReply:
        """Do what the payload asks, by `change` of the sensor's keys, and what is said to that."""


@dataclass(frozen=True, slots=True)
class AnnouncerReply:
    """What is said to whoever asked something of a sensor, and whether it was done."""

    messages: list[Message]
    accepted: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A row of `FORMATS`: a format's facts, and how its messages are made and read."""

    facts: ReportFormat
    maker: Callable[[Scene, Sensors], MessageFormat]
    """What makes the messages of some sensors; raises `PlotfeedError` if an extra is missing."""
    plots_in: Callable[[bytes, int], MeasuredPlots] | None
    """The plots in a payload, given a UTC time near its own; raises `DecodeError`.

    None for a format of tracks.
    """
    late: Callable[[Scene, Message, int], Message | None] | None = None
    """A message as it may leave at a time, or None if it is dropped then, where that matters."""
    announcer: Callable[[Scene, Sensor], Announcer] | None = None
    """What makes the messages of a sensor of itself, if the format has any."""

    @property
    def name(self) -> str:
        """The name that scenes have for it."""
        return self.facts.name

    def make(self, scene: Scene) -> MessageFormat:
        """What makes the messages of all sensors that report in it; raises `PlotfeedError`.

        Where one of them cannot be told of in it, that names the scene's key.
        """
        sensors = {i: s for i, s in enumerate(scene.sensor) if self.name in s.report}
        try:
            return self.maker(scene, sensors)
        except EncodeError as error:
            raise scene.refusal(self._misfits(scene, sensors) or [("", str(error))]) from None

    def _misfits(self, scene: Scene, sensors: Sensors) -> list[tuple[str, str]]:
        """Keys of the sensors that it cannot tell of, and why: the first of each."""
        found = []
        for index, sensor in sensors.items():
            try:
                self.maker(scene, {index: sensor})
            except EncodeError as error:
                why = str(error).removeprefix(f"{error.field}: ")
                what = f"{why}, for {error.field} of {self.name}"
                found.append((key_of_item(error.field, index, sensor), what))
        return found


def plots_in_asterix(payload: bytes, near_utc_ns: int) -> MeasuredPlots:
    """The plots in a datagram of ASTERIX, whose UTC time is near that; raises `DecodeError`."""
    from plotfeed.proto.asterix import decode_plots

    return decode_plots.plots_in_asterix(payload, near_utc_ns)


def key_of_item(item: str, index: int, sensor: Sensor) -> str:
    """The key of a scene that an item of a sensor's own messages is made of."""
    own = next((key for begins, key in KEYS_OF_ITEMS.items() if item.startswith(begins)), "report")
    if own != PLACE or any(sensor.position_enu_m):
        return f"sensor[{index}].{own}"
    part = {"HGT": ".height_m", "LAT": ".latitude_deg", "LON": ".longitude_deg"}
    return f"scene.site{part.get(item.rpartition('/')[2], '')}"


class SectorFormat(ABC):
    """A format that is made for each sensor, and goes sector by sector: the easy kind."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self.topics = Topics(scene, sensor)

    @classmethod
    def of_sensors(cls, scene: Scene, sensors: Sensors) -> MessageFormat:
        """What makes the messages of those sensors."""
        return _SectorBySector({i: cls(scene, sensor) for i, sensor in sensors.items()})

    @abstractmethod
    def messages_of(self, batch: Batch) -> list[Message]:
        """Messages of one sector, due when it ends, in the order in which they leave."""


@dataclass(frozen=True, slots=True)
class _SectorBySector:
    formats: Mapping[int, SectorFormat]

    def messages(self, batch: Batch) -> list[list[Message]]:
        every = enumerate(batch.sectors.sensor.tolist())
        return [self.formats[sensor].messages_of(batch.one(i)) for i, sensor in every]


class AsterixFormat(ABC):
    """A format of ASTERIX that encodes what came of all sectors at once, whatever their sensors."""

    def __init__(self, scene: Scene, sensors: Sensors) -> None:
        self._topics = {i: Topics(scene, sensor) for i, sensor in sensors.items()}

    @abstractmethod
    def blocks(self, batch: Batch) -> list[Blocks]:
        """Blocks of each sector, in the order in which they are to leave."""

    def messages(self, batch: Batch) -> list[list[Message]]:
        """Messages of each sector; one that cannot be encoded is an `EncodeError`."""
        try:
            blocks = self.blocks(batch)
        except EncodeError:
            if len(batch) == 1:
                raise
            # What some of them measure and others do not cannot be encoded together.
            each = [batch.rows(np.array([i])) for i in range(len(batch))]
            return [messages for one in each for messages in self.messages(one)]
        topics, stamps = self._topics, batch.stamps
        sensors = batch.sectors.sensor.tolist()
        return [
            topics[sensor].asterix(stamp, found) if found else []
            for sensor, stamp, found in zip(sensors, stamps, blocks, strict=True)
        ]


def numbers_of(sensors: Sensors, n: int | None = None) -> Ints:
    """Numbers of sensors in their own order, by index in the scene, (n,); -1 for any other."""
    numbers = np.full(max(sensors, default=-1) + 1 if n is None else n, -1, np.int64)
    numbers[list(sensors)] = np.arange(len(sensors))
    return numbers


def sources_of(sensors: Sensors) -> tuple[list[int], list[int]]:
    """SAC and SIC of each sensor, as encoders take them."""
    return [sensor.sac for sensor in sensors.values()], [sensor.sic for sensor in sensors.values()]


def limits_of(scene: Scene, sensors: Sensors) -> list[int]:
    """What a data block of each sensor may hold so that it fits wherever its messages go."""
    return [max_block_octets(scene, sensor) for sensor in sensors.values()]


class Topics:
    """Addresses a sensor's messages, with CloudEvents attributes as MQTT 5 user properties."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._root = f"{scene.mqtt.prefix}/{sensor.id}"
        self._sensor = sensor.id
        self._qos = scene.mqtt.qos
        self._categories: dict[int, Address] = {}

    def asterix(self, stamp: SectorStamp, blocks: Sequence[tuple[int, bytes]]) -> list[Message]:
        """A message for each data block, given with its category, numbered within its category."""
        counts: dict[int, int] = {}
        messages = []
        for category, block in blocks:
            counts[category] = number = counts.get(category, -1) + 1
            address = self._categories.get(category)
            if address is None:
                content_type = asterix_content_type(category)
                address = self.address(f"asterix/{category:03d}", content_type)
                self._categories[category] = address
            messages.append(message_to(address, block, stamp, number))
        return messages

    def address(self, kind: str, content_type: str) -> Address:
        """Where its messages of a kind go."""
        return Address(self._root, self._sensor, kind, content_type, self._qos)


def message_to(address: Address, payload: bytes, stamp: SectorStamp, number: int = 0) -> Message:
    """One message of a sector; `number` tells those of one kind and sector apart."""
    properties = SectorProperties(address, stamp, number)
    return Message(  # by keywords it would take twice as long
        address.topic,
        payload,
        address.content_type,
        stamp.due_ns,
        properties,
        False,
        address.qos,
    )


def max_block_octets(scene: Scene, sensor: Sensor) -> int:
    """What a data block may hold so that it fits wherever the sensor's messages go."""
    to = (udp for udp in scene.udp if udp.takes(sensor.id) and udp.format is None)
    datagrams = (udp.max_octets for udp in to)
    return min(datagrams, default=MAX_BLOCK_OCTETS)


Times = TypeVar("Times", int, Ints)


def periods_in(period_ns: int, start_ns: Times, end_ns: Times) -> Times:
    """How often something periodic, at whole multiples of its period, is due within times."""
    return end_ns // period_ns - start_ns // period_ns
