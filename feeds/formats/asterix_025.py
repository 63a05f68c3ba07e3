"""ASTERIX category 025: that a sensor works, and where it stands."""

from __future__ import annotations

from plotfeed.feeds.formats.base import SERVICE_PERIOD_NS, comes_up
from plotfeed.feeds.places import frame_at
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.sensors import Sensor
from plotfeed.models.scan import Sector
from plotfeed.proto.asterix.cat025 import CAT025, CAT025_HALF_TURN
from plotfeed.proto.asterix.status_025 import StatusEncoder025

EDITIONS = {"full-turn": CAT025, "half-turn": CAT025_HALF_TURN}


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
