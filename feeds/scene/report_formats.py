"""What there is to know of the formats that a sensor can report in, before any message is made.

How messages are made and read stands with each format, in the table `feeds.formats.FORMATS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from plotfeed.proto.asterix.cat048 import RHO_LSB_M
from plotfeed.proto.content_types import (
    COT,
    GEOJSON,
    JSON,
    PLOT_BATCH,
    SAPIENT_MESSAGE,
    TRACK_BATCH,
    asterix_content_type,
    json_content_type,
    protobuf_content_type,
)
from plotfeed.proto.tracks.json_schemas import JSON_SCHEMAS


@dataclass(frozen=True, slots=True)
class SentCategory:
    """A category of ASTERIX that a format brings, and from which of its sensors."""

    summary: str
    rotates: bool = False
    """Only of a beam that turns."""
    has_illuminators: bool = False
    """Only of a receiver of echoes whose transmitters stand elsewhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFormat:
    """A format as scenes name it, and what its messages can and cannot say."""

    name: str
    """As in a sensor's `report`."""
    topic: str
    """End of the topic of the messages that hold plots or tracks, behind prefix and sensor."""
    content_type: str
    """Of those messages."""
    summary: str
    """What they are."""
    inbox: str = ""
    """End of the topics on which sensors are asked something in it; empty for none."""
    message: str = ""
    """The protobuf message that they are; empty for ASTERIX, XML and JSON."""
    schema: Mapping[str, Any] | None = None
    """Of JSON."""
    categories: Mapping[int, SentCategory] = field(default_factory=dict)
    """Of ASTERIX: the format's own category first, then its companions, and what they bring."""
    tells_tracks: bool = False
    """It brings tracks, and no plots."""
    tells_heights: bool = False
    tells_run_lengths: bool = False
    """Over how much azimuth the beam saw the target."""
    needs_azimuth: bool = False
    range_step_m: float = 0.0
    """In which it counts ranges; 0 if that is finer than any sensor."""


def asterix(categories: Mapping[int, SentCategory], **says: Any) -> ReportFormat:
    """A format of ASTERIX: its own category, which names it, and those that come with it.

    `says` are what its messages can and cannot say, by the names of `ReportFormat`.
    """
    own = next(iter(categories))
    return ReportFormat(
        name=f"asterix-{own:03d}",
        topic=f"asterix/{own:03d}",
        content_type=asterix_content_type(own),
        summary=categories[own].summary,
        categories=categories,
        **says,
    )


def tracks_in_json(name: str, schema: str, summary: str, kind: str = JSON) -> ReportFormat:
    """A format of tracks in JSON, by one of the schemas in `proto.tracks.json_schemas`."""
    return ReportFormat(
        name=name,
        topic=name,
        content_type=json_content_type(schema, kind),
        summary=summary,
        schema=JSON_SCHEMAS[schema],
        tells_tracks=True,
    )


STATUS = SentCategory("that the sensor works, and where it stands")

REPORT_FORMATS: dict[str, ReportFormat] = {
    row.name: row
    for row in (
        asterix(
            {
                15: SentCategory("measurement plots"),
                16: SentCategory(
                    "transmitters, receivers and pairs of a passive radar", has_illuminators=True
                ),
                25: STATUS,
            }
        ),
        asterix(
            {
                48: SentCategory("target reports"),
                34: SentCategory("north marker and sector crossings", rotates=True),
            },
            tells_heights=True,
            tells_run_lengths=True,
            range_step_m=RHO_LSB_M,
        ),
        asterix(
            {62: SentCategory("tracks"), 63: SentCategory("that the sensor works")},
            tells_tracks=True,
        ),
        asterix({205: SentCategory("bearings"), 25: STATUS}, needs_azimuth=True),
        ReportFormat(
            name="plots",
            topic="plots",
            content_type=protobuf_content_type(PLOT_BATCH),
            summary="Plots of a sector at full precision; an empty batch says that there are none.",
            message=PLOT_BATCH,
            tells_heights=True,
        ),
        ReportFormat(
            name="sapient",
            topic="sapient",
            content_type=protobuf_content_type(SAPIENT_MESSAGE),
            summary="SAPIENT, BSI Flex 335 v2: detections.",
            inbox="sapient/task",
            message=SAPIENT_MESSAGE,
        ),
        ReportFormat(
            name="tracks",
            topic="tracks",
            content_type=protobuf_content_type(TRACK_BATCH),
            summary="Tracks that had a look in a sector, at full precision.",
            message=TRACK_BATCH,
            tells_tracks=True,
        ),
        ReportFormat(
            name="cot",
            topic="cot",
            content_type=COT,
            summary="Cursor on Target in XML: an event for a track.",
            tells_tracks=True,
        ),
        tracks_in_json(
            "geojson", "plotfeed.TrackFeatures", "GeoJSON: the tracks of a sector.", GEOJSON
        ),
        tracks_in_json(
            "air-traffic", "plotfeed.AirTraffic", "Observations for Flight Blender's air traffic."
        ),
        tracks_in_json("f3411", "plotfeed.F3411Flights", "Flights in the words of ASTM F3411-22a."),
        tracks_in_json(
            "foxglove-geojson", "foxglove.GeoJSON", "All living tracks, for Foxglove's map."
        ),
        tracks_in_json(
            "foxglove-location", "foxglove.LocationFix", "A place of a track, for Foxglove's map."
        ),
    )
}
"""By name. `feeds.formats.register` adds to them."""


TRACK_FORMATS = tuple(sorted(name for name, row in REPORT_FORMATS.items() if row.tells_tracks))
"""Those that sensors of range and azimuth may report tracks in."""


CUE_TOPIC = "cue"
"""End of the topics on which sensors with a mount are told where to look."""


def is_inbox(topic: str) -> bool:
    """Whether sensors are asked something on a topic, in the words of one of their formats."""
    if topic.endswith(f"/{CUE_TOPIC}"):
        return True
    return any(row.inbox and topic.endswith(f"/{row.inbox}") for row in REPORT_FORMATS.values())
