"""Formats, from plots to messages and back, and `FORMATS`, their one table.

A new category of ASTERIX is its layout, its encoder and its format, all in one file, and a line:
`register(FORMAT, ActiveRadarKeys)`, after which scenes may ask for it. One that comes with plotfeed
is a file in `proto.asterix`, a row of `ASTERIX_FORMATS` there, how sensors speak it here, a row of
`FORMATS`, and its name among the `formats` of the sensors that report in it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Address, Message, SectorMessage
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS, LoadedOnUse
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor, SensorKeys
from plotfeed.models.beam import Sectors
from plotfeed.models.state import Floats, Ints
from plotfeed.proto.content_types import asterix_content_type
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.report_format import ReportFormat
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.feeds.formats.sensor_tracks import SceneTracks
    from plotfeed.proto.measured_plots import MeasuredPlots


MAX_BLOCK_OCTETS = 65535  # What the length field of an ASTERIX data block can say
SERVICE_PERIOD_NS = 10 * NS  # How often a sensor says where it stands and that it works
Sensors = Mapping[int, Sensor]  # Sensors by their index in the scene
PLACE = "position_enu_m"
# Of a sensor, by the item that says it; a place that is the site's is the site's key.
KEYS_OF_ITEMS = {
    "I034/041": "scan.period_s",
    "I034/120": PLACE,
    "I025/600": PLACE,
    "I016/400": PLACE,
    "I016/420": PLACE,
    "I016/410": "transmitters",
    "I205/050": PLACE,
}
# A category of ASTERIX, and its data blocks of each sector.
Blocks = tuple[int, Sequence[Sequence[bytes]]]


class MessageFormat(Protocol):
    """Makes the messages that carry what came of sectors of a scene's sensors."""

    def messages(self, batch: Batch) -> list[list[Message]]:
        """Messages of each sector, due when it ends, in the order in which they are to leave."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A row of `FORMATS`: a format's facts, and how its messages are made and read."""

    facts: ReportFormat
    # What makes the messages of some sensors; raises `PlotfeedError` if an extra is missing.
    maker: Callable[[Scene, Sensors], MessageFormat]
    # The plots in a payload, given a UTC time near its own; raises `DecodeError`.
    #
    # None for a format of tracks.
    plots_in: Callable[[bytes, int], MeasuredPlots] | None

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

    @abstractmethod
    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        """What makes the messages of that sensor."""

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
        self._scene, self._sensors = scene, sensors
        # As encoders know the sensors, by their index in the scene.
        self._numbers = numbers_of(sensors)
        self._addresses: dict[int, dict[int, Address]] = {}  # By category, of each sensor

    @abstractmethod
    def blocks(self, batch: Batch) -> list[Blocks]:
        """Blocks of all sectors, category by category, in the order in which they are to leave."""

    def messages(self, batch: Batch) -> list[list[Message]]:
        """Messages of each sector; one that cannot be encoded is an `EncodeError`."""
        try:
            found = self.blocks(batch)
        except EncodeError:
            if len(batch) == 1:
                raise
            # What some of them measure and others do not cannot be encoded together.
            each = [batch.rows(np.array([i])) for i in range(len(batch))]
            return [messages for one in each for messages in self.messages(one)]
        made: list[list[Message]] = [[] for _ in range(len(batch))]
        sectors = list(zip(made, batch.sectors.sensor.tolist(), batch.stamps, strict=True))
        for category, blocks in found:
            if category not in self._addresses:
                self._addresses[category] = {
                    i: asterix_address(self._scene, sensor, category)
                    for i, sensor in self._sensors.items()
                }
            addresses = self._addresses[category]
            for (messages, sensor, stamp), some in zip(sectors, blocks, strict=True):
                if some:
                    address = addresses[sensor]
                    for index, block in enumerate(some):
                        messages.append(SectorMessage(address, block, stamp, index))
        return made


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


def address_of(scene: Scene, sensor: Sensor, kind: str, content_type: str) -> Address:
    """Where a sensor's messages of a kind go."""
    source = f"{scene.mqtt.prefix}/{sensor.id}"
    return Address(source, sensor.id, kind, content_type, scene.mqtt.qos)


def asterix_address(scene: Scene, sensor: Sensor, category: int) -> Address:
    """Where a sensor's messages of a category of ASTERIX go."""
    return address_of(scene, sensor, f"asterix/{category:03d}", asterix_content_type(category))


def addresses_in(scene: Scene, sensors: Sensors, facts: ReportFormat) -> dict[int, Address]:
    """Where the messages of sensors go that hold plots or tracks in a format, by their index."""
    return {
        i: address_of(scene, sensor, facts.topic, facts.content_type)
        for i, sensor in sensors.items()
    }


def max_block_octets(scene: Scene, sensor: Sensor) -> int:
    """What a data block may hold so that it fits wherever the sensor's messages go."""
    to = (udp for udp in scene.udp if udp.takes(sensor.id) and udp.format is None)
    return min((udp.max_octets for udp in to), default=MAX_BLOCK_OCTETS)


def places_of(scene: Scene, sensors: Sensors) -> Floats:
    """Latitude and longitude, degrees, and height above the ellipsoid, metres; (n, 3)."""
    frames = [frame_at(scene.scene.site, sensor.position_enu_m) for sensor in sensors.values()]
    places = [(each.latitude_deg, each.longitude_deg, each.height_m) for each in frames]
    return np.array(places, np.float64).reshape(-1, 3)


def says_how_it_is(
    category: int, sectors: Sectors, numbers: Ints, encode: Callable[[Ints, Ints], Sequence[Any]]
) -> list[Blocks]:
    """Blocks by which sensors say every ten seconds where they stand and that they work.

    `numbers` are those of the sensors that do, by their index, and `encode` makes a block, or
    several, of each time and number. Nothing where no sector has the time for it.
    """
    of = numbers[sectors.sensor]
    periods = sectors.end_ns // SERVICE_PERIOD_NS - sectors.start_ns // SERVICE_PERIOD_NS
    due = np.flatnonzero((periods > 0) & (of >= 0))
    if not len(due):
        return []
    blocks = encode(sectors.end_ns[due], of[due])
    return [(category, among(len(sectors), due, blocks))]


def among(
    sectors: int, which: Ints, blocks: Sequence[bytes | Sequence[bytes]]
) -> list[Sequence[bytes]]:
    """Blocks of so many sectors: those of the ones at these indices, (k,), of the others none."""
    found: list[Sequence[bytes]] = [()] * sectors
    for i, some in zip(which.tolist(), blocks, strict=True):
        found[i] = [some] if isinstance(some, bytes) else some
    return found


# By the name that scenes have for it; the first are those that say most of plots. Formats that no
# scene asks for are not loaded.
FORMATS: LoadedOnUse[Format] = LoadedOnUse(
    {
        name: f"plotfeed.feeds.formats.{home}"
        for name, home in (
            ("plots", "plot_batches:FORMAT"),
            ("asterix-015", "asterix_015:FORMAT"),
            ("asterix-048", "asterix_048:FORMAT"),
            ("asterix-205", "asterix_015:BEARINGS"),
            ("asterix-062", "asterix_062:FORMAT"),
            ("sapient", "sapient:FORMAT"),
            *(
                (name, "track_messages:TRACK_ROWS")
                for name, facts in REPORT_FORMATS.items()
                if facts.tells_tracks and not facts.categories
            ),
        )
    }
)


def register(row: Format, *sensors: type[SensorKeys]) -> None:
    """Let scenes ask those sensors for another format, and everything read what it brings."""
    if row.name in FORMATS:
        raise ValueError(f"there is a format {row.name} already")
    FORMATS[row.name], REPORT_FORMATS[row.name] = row, row.facts
    from plotfeed.proto.asterix.categories import know

    know(row.facts)
    for keys in sensors:
        keys.formats += (row.name,)


def carries_plots(topic: str) -> bool:
    """Whether messages of a topic hold a sector's plots or tracks."""
    return any(topic.endswith(f"/{facts.topic}") for facts in REPORT_FORMATS.values())


class SceneFormats:
    """What makes the messages of a scene's sensors, in all formats that the scene asks of them."""

    def __init__(self, scene: Scene) -> None:
        """Raises `PlotfeedError` if an extra is missing."""
        asked = [tuple(dict.fromkeys(sensor.report)) for sensor in scene.sensor]
        self._reports = list(dict.fromkeys(asked))
        self._report = np.array([self._reports.index(names) for names in asked], np.int64)
        wanted = dict.fromkeys(name for names in self._reports for name in names)
        self._formats = {name: FORMATS[name].make(scene) for name in wanted}
        self._tracks: SceneTracks | None = None
        if any(REPORT_FORMATS[name].tells_tracks for name in wanted):
            from plotfeed.feeds.formats.sensor_tracks import SceneTracks

            self._tracks = SceneTracks(scene)

    def messages(self, batch: Batch) -> list[list[Message]]:
        """Messages of each sector, due when it ends, in the order in which they are to leave."""
        if self._tracks is not None:
            batch = self._tracks.tracked(batch)
        if len(self._reports) == 1:
            return self._in_formats(0, batch)
        return batch.in_groups(self._report[batch.sectors.sensor], self._in_formats)

    def switched_off(self, i: int) -> None:
        """A sensor is at work no more: on-board tracks end with that."""
        if self._tracks is not None:
            self._tracks.end(i)

    def _in_formats(self, report: int, batch: Batch) -> list[list[Message]]:
        """Messages of sensors that report in the same formats."""
        made = [self._formats[name].messages(batch) for name in self._reports[report]]
        if len(made) == 1:
            return made[0]
        if not made:
            return [[] for _ in range(len(batch))]
        return [[m for messages in each for m in messages] for each in zip(*made, strict=True)]


def inboxes_of(scene: Scene) -> dict[str, str]:
    """Topics on which sensors may be asked something in a format that they report in: whose."""
    return {
        f"{scene.mqtt.prefix}/{sensor.id}/{FORMATS[name].facts.inbox}": sensor.id
        for sensor in scene.sensor
        for name in sensor.report
        if FORMATS[name].facts.inbox
    }


__all__ = [
    "FORMATS",
    "Batch",
    "Format",
    "MessageFormat",
    "SceneFormats",
    "SectorFormat",
    "carries_plots",
    "inboxes_of",
    "register",
]
