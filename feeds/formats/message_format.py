"""What formats have in common, and the plainest of them: plotfeed's own batches in protobuf."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS, ReportFormat
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.beam import Sector
from plotfeed.models.sensors.sensor_model import NO_LOOKS
from plotfeed.models.state import Ints, Looks, Plots, TruthState
from plotfeed.proto.asterix.codec.layout import Category
from plotfeed.proto.asterix.decode_plots import PlotItems
from plotfeed.proto.batch import plot_batch
from plotfeed.proto.content_types import asterix_content_type
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.utc import NS

MAX_BLOCK_OCTETS = 65535
"""What the length field of an ASTERIX data block can say."""
SERVICE_PERIOD_NS = 10 * NS
"""How often a sensor says where it stands and that it works."""


def _no_truth(t_utc_ns: int, _drones: Ints, /) -> TruthState:
    raise LookupError(f"nothing is known of the truth at {t_utc_ns}")


@dataclass(frozen=True, slots=True)
class Seen:
    """What came of one sector, and a way to ask where drones, by index, truly are at a time."""

    sector: Sector
    plots: Plots
    looks: Looks = NO_LOOKS
    truth_at: Callable[[int, Ints], TruthState] = _no_truth


class MessageFormat(Protocol):
    """Makes the messages that carry what came of one sector."""

    def messages(self, seen: Seen) -> list[Message]:
        """Due when the sector ends, in the order in which they are to leave."""


class Announcer(Protocol):
    """Makes what a sensor says of itself in a format, stamped when it is asked for."""

    every_ns: int
    """How often it says that nothing has changed."""

    def opening(self, now_utc_ns: int) -> list[Message]:
        """What comes before anything else, on every connection."""

    def regular(self, now_utc_ns: int) -> list[Message]:
        """News that nothing has changed."""

    def closing(self, now_utc_ns: int) -> list[Message]:
        """Goodbye."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A row of `FORMATS`: a format's facts, and how its messages are made and read."""

    facts: ReportFormat
    make: Callable[[Scene, Sensor], MessageFormat]
    """What makes the messages of a sensor; raises `PlotfeedError` if an extra is missing."""
    plots_in: Callable[[bytes, int], MeasuredPlots] | None
    """The plots in a payload, given a UTC time near its own; raises `DecodeError`.

    None for a format of tracks.
    """
    layouts: tuple[Category, ...] = ()
    """Of ASTERIX, where `proto.asterix.categories` does not have them."""
    plot_items: PlotItems | None = None
    """Where records of its own category tell of plots, where `decode_plots` does not have it."""
    late: Callable[[Scene, Message, int], Message | None] | None = None
    """A message as it may leave at a time, or None if it is dropped then, where that matters."""
    announcer: Callable[[Scene, Sensor], Announcer] | None = None
    """What makes the messages of a sensor of itself, if the format has any."""

    @property
    def name(self) -> str:
        """The name that scenes have for it."""
        return self.facts.name


class Topics:
    """Addresses a sensor's messages, with CloudEvents attributes as MQTT 5 user properties."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._root = f"{scene.mqtt.prefix}/{sensor.id}"
        self._sensor = sensor.id
        self._qos = scene.mqtt.qos
        self._alike: tuple[Sector | None, tuple[tuple[str, str], ...]] = (None, ())

    def asterix(self, sector: Sector, blocks: Sequence[tuple[int, bytes]]) -> list[Message]:
        """A message for each data block, given with its category, numbered within its category."""
        counts: dict[int, int] = {}
        messages = []
        for category, block in blocks:
            counts[category] = counts.get(category, -1) + 1
            messages.append(
                self.message(
                    f"asterix/{category:03d}",
                    asterix_content_type(category),
                    block,
                    sector,
                    counts[category],
                )
            )
        return messages

    def message(
        self, kind: str, content_type: str, payload: bytes, sector: Sector, number: int = 0
    ) -> Message:
        """One message; `number` tells those of one kind and sector apart."""
        return Message(
            topic=f"{self._root}/{kind}",
            payload=payload,
            content_type=content_type,
            due_utc_ns=sector.end_ns,
            qos=self._qos,
            properties=(
                ("id", f"{kind.replace('/', '-')}-{sector.scan}-{sector.index}-{number}"),
                ("type", f"plotfeed.{kind.replace('/', '.')}"),
                *self._alike_of(sector),
            ),
        )

    def _alike_of(self, sector: Sector) -> tuple[tuple[str, str], ...]:
        """The attributes that all messages of a sector share, worked out once."""
        if self._alike[0] is not sector:
            of_sector = attributes(
                self._root,
                "",
                "",
                sector.end_ns,
                sensor=self._sensor,
                scan=sector.scan,
                sector=sector.index,
            )
            own = {"id", "type"}
            self._alike = (sector, tuple(pair for pair in of_sector if pair[0] not in own))
        return self._alike[1]


def max_block_octets(scene: Scene, sensor: Sensor) -> int:
    """What a data block may hold so that it fits wherever the sensor's messages go."""
    datagrams = (udp.max_octets for udp in scene.udp if udp.takes(sensor.id))
    return min(datagrams, default=MAX_BLOCK_OCTETS)


def comes_up(period_ns: int, sector: Sector) -> bool:
    """Whether something periodic, at whole multiples of its period, is due in a sector."""
    return sector.end_ns // period_ns != sector.start_ns // period_ns


PLOTS = REPORT_FORMATS["plots"]


class PlotBatches:
    """plotfeed's own protobuf, one message a sector; an empty one says that nothing was found."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._topics = Topics(scene, sensor)
        self._sensor = sensor.id

    def messages(self, seen: Seen) -> list[Message]:
        """The batch of the sector."""
        sector = seen.sector
        batch = plot_batch(self._sensor, sector.scan, sector.index, seen.plots)
        return [self._topics.message(PLOTS.topic, PLOTS.content_type, batch, sector)]
