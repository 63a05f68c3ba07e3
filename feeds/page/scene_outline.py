"""What a page has to know of a scene before anything happens: sensors, cover, basemap, ways out."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.engine.sensor_description import outputs_of
from plotfeed.feeds.scene.examples import head_of
from plotfeed.feeds.scene.fields import Site, enu_from, frame_at, site_frame
from plotfeed.feeds.scene.output_keys import BasemapImage, UdpDestination
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.feeds.telemetry.foreign_files import FILE_LIMITS, file_octets
from plotfeed.models.cueing import CuedState
from plotfeed.models.dwell_agenda import PointedBeams
from plotfeed.models.frames import LocalFrame, aer_to_enu, geodetic_to_ecef
from plotfeed.models.state import Floats, Ints
from plotfeed.proto.errors import PlotfeedError


class Placements:
    """Offset and rotation of each sensor, from its own horizontal to that of the site."""

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
        "about": _about(scene),
        "site": {n: getattr(site, n) for n in ("latitude_deg", "longitude_deg", "height_m")},
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


def _about(scene: Scene) -> dict[str, Any]:
    """What the scene says of itself, or else what is in it."""
    head = head_of(scene.text)
    kinds = Counter(sensor.label for sensor in scene.sensor)
    counted = ", ".join(f"{number} × {label}" for label, number in kinds.items())
    words = head.words or f"Scene {scene.scene.name}: {counted or 'no sensor'}."
    return {"words": words, "look_for": list(head.look_for)}


def _sensor(scene: Scene, sensor: Sensor, position_m: list[float]) -> dict[str, Any]:
    return cover_of(sensor, scene.scene.site) | {
        "id": sensor.id,
        "type": sensor.type,
        "label": sensor.label,
        "preset": sensor.preset,
        "east_m": position_m[0],
        "north_m": position_m[1],
        "period_s": sensor.scan.period_s,
        "rotates": sensor.scan.rotates,
        "false_alarms_per_scan": sensor.model(scene.scene.site).false_alarms_per_scan,
        # Transmitters of opportunity, which stand elsewhere.
        "transmitters": _placed_at(scene.scene.site, {t.id: t.place for t in sensor.illuminators}),
        "pfa": sensor.false_alarm_probability,
        "loss_db": getattr(sensor, "loss_db", None),
    }


def cover_of(sensor: Sensor, site: Site) -> dict[str, Any]:
    """Where a sensor can see as its keys are now, and who jams it; metres from the site.

    What a mount turns has its cover from where the mount points: `pointing_of`.
    """
    low_deg, high_deg = _azimuths_deg(sensor)
    return {
        "enabled": sensor.enabled,
        "range_min_m": getattr(sensor, "range_min_m", 0.0),
        "range_max_m": sensor.range_max_m,
        "azimuth_min_deg": low_deg,
        "azimuth_span_deg": high_deg - low_deg,
        "turns": mount_of(sensor) is not None,
        "jammers": _placed_at(site, sensor.jamming),
    }


def pointing_of(sensor: Sensor, pointed: CuedState | PointedBeams) -> dict[str, Any]:
    """Where a mount or the beams of a radar pointed in the last scan, degrees from true north."""
    if isinstance(pointed, PointedBeams):
        return {
            "width_deg": round(pointed.width_deg, 3),
            "search_deg": np.round(pointed.search_deg, 2).tolist(),
            "tracks_deg": np.round(pointed.tracks_deg, 2).tolist(),
        }
    at, (low_deg, high_deg) = pointed.pointing, _azimuths_deg(sensor)
    if hasattr(sensor, "horizontal_fov_deg"):
        low_deg, high_deg = -at.field_deg / 2, at.field_deg / 2
    return {
        "pan_deg": round(at.pan_deg, 2),
        "tilt_deg": round(at.tilt_deg, 2),
        "from_deg": round(at.pan_deg + low_deg, 2),
        "span_deg": round(high_deg - low_deg, 3),
        "aim_deg": round(pointed.aim.pan_deg, 2),
        "sees": pointed.sees(at.t_utc_ns),
        "cued_by": pointed.source,
    }


def _azimuths_deg(sensor: Sensor) -> tuple[float, float]:
    """Where the cover begins and ends clockwise; all around where a sensor has no such keys."""
    low_deg: float = getattr(sensor, "azimuth_min_deg", -180.0)
    return low_deg, getattr(sensor, "azimuth_max_deg", 180.0)


def _placed_at(site: Site, places: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What stands at places, by name, east and north of the site."""
    frame = site_frame(site)
    placed = ((name, enu_from(frame, site, place)) for name, place in places.items())
    return [
        {"id": name, "east_m": round(float(enu_m[0]), 1), "north_m": round(float(enu_m[1]), 1)}
        for name, enu_m in placed
    ]


LIMITS = FILE_LIMITS["basemap"]
SKEW = 0.02  # Of its diagonal, by which the fourth corner of an image may be off the parallelogram
IMAGES = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}


@dataclass(frozen=True, slots=True)
class Basemap:
    """A basemap as browsers fetch it."""

    media_type: str
    content: bytes
    # East and north of an image's top left, top right and bottom left corner.
    corners_m: list[list[float]] | None = None


def load_basemap(settings: str | BasemapImage, path: Path, site: Site) -> Basemap:
    """Read the file that a scene names; raises `PlotfeedError`."""
    frame = site_frame(site)
    try:
        content = file_octets(path, "basemap")
        if isinstance(settings, str):
            shapes = _shapes(json.loads(content), frame)
            return Basemap("application/json", json.dumps(shapes, separators=(",", ":")).encode())
        types = (kind for magic, kind in IMAGES.items() if content.startswith(magic))
        if (media_type := next(types, None)) is None:
            raise ValueError("expected a PNG, JPEG or WebP image")
        return Basemap(media_type, content, _corners(settings, frame))
    except (ValueError, RecursionError, PlotfeedError) as error:
        raise PlotfeedError(f"page.basemap: {path}: {error}") from None
    except TypeError:  # of what is no list
        raise PlotfeedError(f"page.basemap: {path}: coordinates: expected lists") from None


def _corners(settings: BasemapImage, frame: LocalFrame) -> list[list[float]]:
    """Three corners, of which the fourth follows; raises ValueError if it does not."""
    latitude_deg, longitude_deg = np.array(settings.corners).T
    enu_m = frame.from_ecef(geodetic_to_ecef(latitude_deg, longitude_deg, frame.height_m))
    top_left, top_right, bottom_right, bottom_left = enu_m[:, :2]
    off_m = float(np.hypot(*(top_right + bottom_left - top_left - bottom_right)))
    diagonal_m = float(np.hypot(*(bottom_right - top_left)))
    if not diagonal_m > 1 or off_m > SKEW * diagonal_m:
        raise ValueError(
            f"corners: expected a parallelogram, in the order top left, top right, bottom right, "
            f"bottom left; the last is {off_m:.0f} m off"
        )
    return [[round(float(v), 2) for v in corner] for corner in (top_left, top_right, bottom_left)]


def _shapes(tree: Any, frame: LocalFrame) -> dict[str, list[Any]]:
    """Lines, areas and points: lists of east and north in turns, metres, with names of points."""
    shapes: dict[str, list[Any]] = {"lines": [], "areas": [], "points": []}
    vertices = 0
    for geometry, name in _geometries(tree):
        for kind, positions in _parts(geometry):
            vertices += len(positions)
            if vertices > LIMITS.count:
                raise ValueError(f"more than {LIMITS.count} vertices: simplify it")
            flat = np.round(_placed(positions, frame), 1).ravel().tolist()
            shapes[kind].append([*flat, name] if kind == "points" else flat)
    return shapes


def _geometries(tree: Any, depth: int = 0) -> Iterator[tuple[dict[str, Any], str]]:
    """Every geometry of a GeoJSON tree, with the name of its feature."""
    if not isinstance(tree, dict) or depth > LIMITS.depth:
        raise ValueError("expected GeoJSON: an object with a type")
    kind = tree.get("type")
    if kind == "FeatureCollection":
        for feature in _list(tree, "features"):
            yield from _geometries(feature, depth + 1)
    elif kind == "Feature":
        properties = tree.get("properties")
        name = properties.get("name") if isinstance(properties, dict) else None
        if tree.get("geometry") is not None:
            for geometry, _ in _geometries(tree["geometry"], depth + 1):
                yield geometry, str(name)[:80] if name is not None else ""
    elif kind == "GeometryCollection":
        for geometry in _list(tree, "geometries"):
            yield from _geometries(geometry, depth + 1)
    else:
        yield tree, ""


# Of each geometry what its parts are, and how many lists deep they lie in its coordinates.
GEOMETRIES = {
    "Point": ("points", 0),
    "MultiPoint": ("points", 1),
    "LineString": ("lines", 0),
    "MultiLineString": ("lines", 1),
    "Polygon": ("areas", 1),
    "MultiPolygon": ("areas", 2),
}


def _parts(geometry: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Lines, rings of areas and points of a geometry; each a list of positions."""
    kind, parts = str(geometry.get("type")), [_list(geometry, "coordinates")]
    if kind not in GEOMETRIES:
        raise ValueError(f"expected a GeoJSON geometry, not a type {kind[:40]!r}")
    shape, deep = GEOMETRIES[kind]
    for _ in range(deep):
        parts = [inner for part in parts for inner in part]
    yield from ((shape, [part] if shape == "points" else part) for part in parts)


def _placed(positions: Sequence[Any], frame: LocalFrame) -> Floats:
    """East and north of longitudes and latitudes at the site's height; (n, 2)."""
    try:
        longitude_deg, latitude_deg = np.array([p[:2] for p in positions], dtype=np.float64).T
    except (TypeError, ValueError, OverflowError):
        raise ValueError("coordinates: expected lists of longitude and latitude") from None
    if not (np.abs(latitude_deg) <= 90).all() or not (np.abs(longitude_deg) <= 540).all():
        raise ValueError("coordinates: expected longitudes and latitudes in degrees (WGS-84)")
    placed_m: Floats = frame.from_ecef(
        geodetic_to_ecef(latitude_deg, longitude_deg, frame.height_m)
    )[:, :2]
    return placed_m


def _list(tree: dict[str, Any], key: str) -> list[Any]:
    found = tree.get(key)
    if not isinstance(found, list) or (key == "coordinates" and not found):
        raise ValueError(f"{key}: expected a list")
    return found


TOLD_OF_UDP = ("destination", "is_multicast", "interface", "carries")


def connections(scene: Scene, urls: Mapping[str, str], *, sends_udp: bool = True) -> dict[str, Any]:
    """Brokers, and of each sensor its topics and what of it goes by UDP, as JSON.

    `urls` are addresses of the session's brokers by protocol, whatever is said after them. There is
    no word of the ledger, of control and of telemetry: they are not for a tracker.
    """
    access = scene.outgoing.mqtt.credentials_file is not None
    return {
        "brokers": [
            {"protocol": protocol, "url": url.split()[0], "needs_password": access}
            for protocol, url in urls.items()
        ],
        "sensors": {
            sensor.id: {
                "topics": [
                    {"topic": o.topic, "format": o.format, "content_type": o.content_type}
                    for o in outputs_of(scene.mqtt.prefix, sensor)
                ],
                "udp": [
                    {name: getattr(to, name) for name in TOLD_OF_UDP}
                    for to in scene.outgoing.udp
                    if sends_udp and to.takes(sensor.id) and _carries(to, sensor)
                ],
            }
            for sensor in scene.sensor
        },
    }


def _carries(to: UdpDestination, sensor: Sensor) -> bool:
    """Whether any format of a sensor goes there."""
    if to.format is not None:
        return to.format in sensor.report
    return any(REPORT_FORMATS[name].categories for name in sensor.report)
