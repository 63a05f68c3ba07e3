"""What a page has to know of a scene before anything happens: sensors, cover, places."""

from __future__ import annotations

from typing import Any

import numpy as np

from plotfeed.feeds.page.basemap import Basemap
from plotfeed.feeds.page.placements import Placements
from plotfeed.feeds.places import enu_from
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.sensors import PassiveRadarSensor, Sensor
from plotfeed.feeds.sensors.base import AzimuthCoverPart, RotatingScan, VolumePart


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
    cover = sensor.azimuth_cover if isinstance(sensor, AzimuthCoverPart) else None
    return {
        "id": sensor.id,
        "type": sensor.type,
        "preset": sensor.preset,
        "east_m": position_m[0],
        "north_m": position_m[1],
        "range_min_m": sensor.range_min_m if isinstance(sensor, VolumePart) else 0.0,
        "range_max_m": sensor.range_max_m,
        "azimuth_min_deg": cover.min_deg if cover else 0.0,
        "azimuth_span_deg": cover.span_deg if cover else 360.0,
        "period_s": sensor.scan.period_s,
        "rotates": isinstance(sensor.scan, RotatingScan),
        "false_alarms_per_scan": sensor.model(scene.scene.site).false_alarms_per_scan,
        "transmitters": _transmitters(scene, sensor),
        "pfa": getattr(sensor, "pfa", None),
        "loss_db": getattr(sensor, "loss_db", None),
    }


def _transmitters(scene: Scene, sensor: Sensor) -> list[dict[str, Any]]:
    """Those of opportunity, which stand elsewhere."""
    if not isinstance(sensor, PassiveRadarSensor):
        return []
    site = scene.scene.site
    here = Placements(site, [])
    places = [(t.id, enu_from(here.site, site, t.place)) for t in sensor.transmitters]
    return [
        {"id": name, "east_m": round(float(enu_m[0]), 1), "north_m": round(float(enu_m[1]), 1)}
        for name, enu_m in places
    ]
