"""What a page has to know of a scene before anything happens: sensors, cover, places."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from plotfeed.feeds.page.basemap import Basemap
from plotfeed.feeds.scene.fields import Site
from plotfeed.feeds.scene.geometry import enu_from, frame_at, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.sensor_keys import AzimuthCoverKeys, VolumeKeys
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.state import Floats, Ints


class Placements:
    """One offset and one rotation a sensor, from its own horizontal to that of the site."""

    def __init__(self, site: Site, sensors: Sequence[Sensor]) -> None:
        self.site = site_frame(site)
        frames = [frame_at(site, sensor.position_enu_m) for sensor in sensors]
        self.position_enu_m = np.array(
            [self.site.from_ecef(frame.origin_ecef_m) for frame in frames]
        ).reshape(-1, 3)
        self._rotations = np.array(
            [self.site.rotation_from_ecef @ frame.rotation_from_ecef.T for frame in frames]
        ).reshape(-1, 3, 3)
        self.range_max_m = np.array([sensor.range_max_m for sensor in sensors])

    def places_m(
        self, sensor: Ints, azimuth_deg: Floats, elevation_deg: Floats, range_m: Floats
    ) -> tuple[Floats, Floats]:
        """East and north of the site, metres, each (n,), of what sensors by number measured.

        An elevation that was not measured is taken for 0, a range for that of cover; NaN without
        an azimuth.
        """
        elevation_deg = np.where(np.isnan(elevation_deg), 0.0, elevation_deg)
        range_m = np.where(np.isnan(range_m), self.range_max_m[sensor], range_m)
        local_m = aer_to_enu(azimuth_deg, elevation_deg, range_m)
        east_north = self._rotations[:, :2]
        placed_m = np.einsum("nij,nj->ni", east_north[sensor], local_m)
        placed_m += self.position_enu_m[sensor, :2]
        return placed_m[:, 0], placed_m[:, 1]


def outline(scene: Scene, placements: Placements, basemap: Basemap | None) -> dict[str, Any]:
    """The scene as JSON; metres are east and north of the site."""
    site = scene.scene.site
    return {
        "name": scene.scene.name,
        "site": {
            "latitude_deg": site.latitude_deg,
            "longitude_deg": site.longitude_deg,
            "height_m": site.height_m,
        },
        "prefix": scene.mqtt.prefix,
        "stale_after_s": scene.telemetry.stale_after_s,
        "sensors": [
            _sensor(scene, sensor, position_m)
            for sensor, position_m in zip(
                scene.sensor, np.round(placements.position_enu_m, 2).tolist(), strict=True
            )
        ],
        "basemap": basemap and {"media_type": basemap.media_type, "corners_m": basemap.corners_m},
    }


def _sensor(scene: Scene, sensor: Sensor, position_m: list[float]) -> dict[str, Any]:
    cover = sensor.azimuth_cover if isinstance(sensor, AzimuthCoverKeys) else None
    return {
        "id": sensor.id,
        "type": sensor.type,
        "label": sensor.label,
        "preset": sensor.preset,
        "east_m": position_m[0],
        "north_m": position_m[1],
        "range_min_m": sensor.range_min_m if isinstance(sensor, VolumeKeys) else 0.0,
        "range_max_m": sensor.range_max_m,
        "azimuth_min_deg": cover.min_deg if cover else 0.0,
        "azimuth_span_deg": cover.span_deg if cover else 360.0,
        "period_s": sensor.scan.period_s,
        "rotates": sensor.scan.rotates,
        "false_alarms_per_scan": sensor.model(scene.scene.site).false_alarms_per_scan,
        "transmitters": _transmitters(scene, sensor),
        "pfa": sensor.false_alarm_probability,
        "loss_db": getattr(sensor, "loss_db", None),
    }


def _transmitters(scene: Scene, sensor: Sensor) -> list[dict[str, Any]]:
    """Those of opportunity, which stand elsewhere."""
    site = scene.scene.site
    here = Placements(site, [])
    places = [(t.id, enu_from(here.site, site, t.place)) for t in sensor.illuminators]
    return [
        {"id": name, "east_m": round(float(enu_m[0]), 1), "north_m": round(float(enu_m[1]), 1)}
        for name, enu_m in places
    ]
