"""ASTERIX of staring, MIMO and passive radars, microphones, direction finders: 015 to 025, 205."""

from __future__ import annotations

from typing import Any

import numpy as np

from plotfeed.feeds.formats import (
    SERVICE_PERIOD_NS,
    AsterixFormat,
    Blocks,
    Format,
    Sensors,
    limits_of,
    numbers_of,
    places_of,
    plots_in_asterix,
    says_how_it_is,
    sources_of,
)
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.fields import geodetic
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.models.state import Ints
from plotfeed.proto.asterix.cat015 import Geometry, PlotEncoder015, Scanning
from plotfeed.proto.asterix.cat016 import SystemEncoder016
from plotfeed.proto.asterix.cat025 import CAT025, CAT025_HALF_TURN, status_025
from plotfeed.proto.asterix.cat205 import BearingEncoder205
from plotfeed.proto.asterix.codec.encode import Parts, Reports
from plotfeed.proto.utc import NS

EDITIONS = {"full-turn": CAT025, "half-turn": CAT025_HALF_TURN}
NO_CLASS = 0  # In I015/300, of what the sensor does not name
# Numbers set aside for the observations of a scan, so that they do not depend on earlier ones.
OBSERVATIONS_A_SCAN = 4096
REPORTS_A_SCAN = 16  # Likewise, of bearings
GEOMETRIES = {
    SensorGeometry.MONOSTATIC: Geometry.MONOSTATIC,
    SensorGeometry.BISTATIC: Geometry.MULTISTATIC,
    SensorGeometry.BEARINGS: Geometry.OTHER,
}


def status_of(scene: Scene, sensors: Sensors) -> Reports:
    """Encodes that sensors work, for those whose own category has no word for it."""
    places = places_of(scene, sensors)
    return status_025(
        *sources_of(sensors),
        places,
        geoid_undulation_m=scene.sea_level().undulation_m(places[:, 0], places[:, 1]),
        category=EDITIONS[scene.asterix.longitude_025],
    )


class Asterix015(AsterixFormat):
    """Measurement plots of 015 at their full precision, 016 for a passive radar, and 025.

    Each scan's plots come first, then what there is to say of the system.
    """

    def __init__(self, scene: Scene, sensors: Sensors) -> None:
        super().__init__(scene, sensors)
        # Plots of sensors of one geometry that call classes alike are encoded together.
        manners: dict[Any, dict[int, Sensor]] = {}
        for i, sensor in sensors.items():
            manner = sensor.geometry, tuple(sensor.class_codes.items())
            manners.setdefault(manner, {})[i] = sensor
        self._manner = np.zeros(len(numbers_of(sensors)), np.int64)
        for number, some in enumerate(manners.values()):
            self._manner[list(some)] = number
        self._plots = [_plots_of(scene, some) for some in manners.values()]
        self._status = status_of(scene, sensors)
        self._systems = _systems(scene, sensors)

    def blocks(self, batch: Batch) -> list[Blocks]:
        """Blocks of category 015, then those of 016 and 025 where they are due."""
        sectors = batch.sectors
        found: list[Blocks] = [(15, batch.in_groups(self._manner[sectors.sensor], self._of_plots))]
        for numbers, encoder in self._systems:
            found += says_how_it_is(16, sectors, numbers, encoder.blocks)
        return found + says_how_it_is(25, sectors, self._numbers, self._status.one_each)

    def _of_plots(self, manner: int, batch: Batch) -> list[list[bytes]]:
        """Blocks of category 015 of sensors of one geometry that call classes alike."""
        numbers, encoder = self._plots[manner]
        parts = Parts(batch.plots_by, numbers[batch.sectors.sensor])
        first = batch.sectors.scan * OBSERVATIONS_A_SCAN
        return encoder.blocks_by(batch.plots, parts, first)


def _plots_of(scene: Scene, sensors: Sensors) -> tuple[Ints, PlotEncoder015]:
    """The numbers of sensors of one manner, by their index, and the encoder of their plots."""
    every = list(sensors.values())
    codes = every[0].class_codes
    return numbers_of(sensors), PlotEncoder015(
        *sources_of(sensors),
        geometry=GEOMETRIES[every[0].geometry],
        classes={"": NO_CLASS, **codes} if codes else None,
        scanning=[Scanning.FORWARD if s.scan.rotates else Scanning.STATIC for s in every],
        max_octets=limits_of(scene, sensors),
    )


def _systems(scene: Scene, sensors: Sensors) -> list[tuple[Ints, SystemEncoder016]]:
    """The numbers of sensors with as many transmitters, by their index, and their encoder."""
    alike: dict[int, dict[int, Sensor]] = {}
    for i, sensor in sensors.items():
        if sensor.illuminators:
            alike.setdefault(len(sensor.illuminators), {})[i] = sensor
    n, site = len(numbers_of(sensors)), scene.scene.site
    at_site = site.latitude_deg, site.longitude_deg
    return [
        (
            numbers_of(some, n),
            SystemEncoder016(
                *sources_of(some),
                transmitters=[
                    [geodetic(site, each.place) for each in sensor.illuminators]
                    for sensor in some.values()
                ],
                receivers=places_of(scene, some),
                reference=(*at_site, site.height_m),
                period_s=SERVICE_PERIOD_NS // NS,
                geoid_undulation_m=float(scene.sea_level().undulation_m(*at_site)),
                max_octets=limits_of(scene, some),
            ),
        )
        for some in alike.values()
    ]


class Asterix205(AsterixFormat):
    """Sensor data of 205, a block a bearing, and 025 of sensors that 015 does not bring it of."""

    def __init__(self, scene: Scene, sensors: Sensors) -> None:
        super().__init__(scene, sensors)
        places = places_of(scene, sensors)
        self._bearings = BearingEncoder205(
            *sources_of(sensors), latitude_deg=places[:, 0], longitude_deg=places[:, 1]
        )
        untold = {i: each for i, each in sensors.items() if "asterix-015" not in each.report}
        self._untold = numbers_of(untold, len(self._numbers))
        self._status = status_of(scene, untold) if untold else None

    def blocks(self, batch: Batch) -> list[Blocks]:
        """Blocks of category 205, then 025 where it is due."""
        sectors = batch.sectors
        parts = Parts(batch.plots_by, self._numbers[sectors.sensor])
        first = sectors.scan * REPORTS_A_SCAN
        bearings = self._bearings.blocks_by(batch.plots, parts, sectors.end_ns, first)
        if self._status is None:
            return [(205, bearings)]
        status = says_how_it_is(25, sectors, self._untold, self._status.one_each)
        return [(205, bearings), *status]


FORMAT = Format(facts=REPORT_FORMATS["asterix-015"], maker=Asterix015, plots_in=plots_in_asterix)
BEARINGS = Format(facts=REPORT_FORMATS["asterix-205"], maker=Asterix205, plots_in=plots_in_asterix)
