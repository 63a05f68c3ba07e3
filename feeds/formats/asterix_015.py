"""ASTERIX as staring, MIMO and passive radars and microphones speak it: 015, 016 and 025."""

from __future__ import annotations

from plotfeed.feeds.formats.message_format import (
    SERVICE_PERIOD_NS,
    Seen,
    Topics,
    comes_up,
    max_block_octets,
)
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.fields import frame_at, geodetic, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.models.beam import Sector
from plotfeed.models.frames import LocalFrame
from plotfeed.proto.asterix.cat015 import Geometry, PlotEncoder015, Scanning
from plotfeed.proto.asterix.cat016 import Component, Pair, SystemEncoder016
from plotfeed.proto.asterix.cat025 import CAT025, CAT025_HALF_TURN, StatusEncoder025
from plotfeed.proto.utc import NS

EDITIONS = {"full-turn": CAT025, "half-turn": CAT025_HALF_TURN}
OBSERVATIONS_A_SCAN = 4096
"""Numbers set aside for the observations of a scan, so that they do not depend on earlier ones."""
GEOMETRIES = {
    SensorGeometry.MONOSTATIC: Geometry.MONOSTATIC,
    SensorGeometry.BISTATIC: Geometry.MULTISTATIC,
    SensorGeometry.BEARINGS: Geometry.OTHER,
}


class Status025:
    """A status report every ten seconds, for sensors whose own category has none."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        place = frame_at(scene.scene.site, sensor.position_enu_m)
        self._encoder = StatusEncoder025(
            sensor.sac,
            sensor.sic,
            latitude_deg=place.latitude_deg,
            longitude_deg=place.longitude_deg,
            height_m=place.height_m,
            geoid_undulation_m=scene.telemetry.geoid_undulation_m or 0.0,
            category=EDITIONS[scene.asterix.longitude_025],
        )

    def blocks(self, sector: Sector) -> list[tuple[int, bytes]]:
        """The report, if one is due in this sector."""
        if not comes_up(SERVICE_PERIOD_NS, sector):
            return []
        return [(25, self._encoder.block(sector.end_ns))]


class Asterix015:
    """Measurement plots of 015 at their full precision, 016 for a passive radar, and 025.

    Each scan's plots come first, then what there is to say of the system.
    """

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._topics = Topics(scene, sensor)
        self._plots = PlotEncoder015(
            sensor.sac,
            sensor.sic,
            geometry=GEOMETRIES[sensor.geometry],
            scanning=Scanning.FORWARD if sensor.scan.rotates else Scanning.STATIC,
            max_octets=max_block_octets(scene, sensor),
        )
        self._status = Status025(scene, sensor)
        self._system = _system(scene, sensor) if sensor.illuminators else None

    def messages(self, seen: Seen) -> list[Message]:
        """Blocks of category 015, then those of 016 and 025 if they are due."""
        sector = seen.sector
        first = sector.scan * OBSERVATIONS_A_SCAN
        blocks = [(15, block) for block in self._plots.blocks(seen.plots, first_observation=first)]
        if self._system is not None and comes_up(SERVICE_PERIOD_NS, sector):
            blocks.extend((16, block) for block in self._system.blocks(sector.end_ns))
        blocks.extend(self._status.blocks(sector))
        return self._topics.asterix(sector, blocks)


def _system(scene: Scene, sensor: Sensor) -> SystemEncoder016:
    """A pair for each transmitter, numbered as the channels of plots are; one receiver, 0."""
    site = scene.scene.site
    transmitters = [
        _component(number, LocalFrame(*map(float, geodetic(site, transmitter.place))))
        for number, transmitter in enumerate(sensor.illuminators)
    ]
    return SystemEncoder016(
        sensor.sac,
        sensor.sic,
        period_s=SERVICE_PERIOD_NS // NS,
        pairs=[Pair(identity=n, transmitter=n, receiver=0) for n in range(len(transmitters))],
        transmitters=transmitters,
        receivers=[_component(0, frame_at(site, sensor.position_enu_m))],
        reference=_component(0, site_frame(site)),
        geoid_undulation_m=scene.telemetry.geoid_undulation_m or 0.0,
        max_octets=max_block_octets(scene, sensor),
    )


def _component(identity: int, place: LocalFrame) -> Component:
    return Component(
        identity=identity,
        latitude_deg=place.latitude_deg,
        longitude_deg=place.longitude_deg,
        height_m=place.height_m,
    )
