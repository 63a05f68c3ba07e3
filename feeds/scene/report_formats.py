"""What there is to know of the formats that a sensor can report in, before any message is made.

How messages are made and read stands with each format, in the table `feeds.formats.FORMATS`.
"""

from __future__ import annotations

from collections import UserDict
from collections.abc import Mapping
from importlib import import_module
from typing import Any, TypeVar

from plotfeed.proto.asterix.categories import ASTERIX_FORMATS
from plotfeed.proto.content_types import (
    COT,
    GEOJSON,
    JSON,
    PLOT_BATCH,
    SAPIENT_MESSAGE,
    TRACK_BATCH,
    json_content_type,
    protobuf_content_type,
)
from plotfeed.proto.json_schemas import JSON_SCHEMAS
from plotfeed.proto.report_format import ReportFormat

T = TypeVar("T")


class LoadedOnUse(UserDict[str, T]):
    """A mapping whose first entries are "module:name": each is loaded when it is asked for.

    Where the name is that of a mapping, the entry is what that has under the same key.
    """

    def __init__(self, homes: Mapping[str, Any]) -> None:
        super().__init__(homes)

    def __getitem__(self, key: str) -> T:
        entry: Any = self.data[key]
        if isinstance(entry, str):
            module, _, name = entry.partition(":")
            entry = getattr(import_module(module), name)
            self.data[key] = entry = entry[key] if isinstance(entry, dict) else entry
        found: T = entry
        return found


def tracks_in_json(name: str, schema: str, summary: str, kind: str = JSON) -> ReportFormat:
    """A format of tracks in JSON, by one of the schemas in `proto.json_schemas`."""
    return ReportFormat(
        name=name,
        topic=name,
        content_type=json_content_type(schema, kind),
        summary=summary,
        schema=JSON_SCHEMAS[schema],
        tells_tracks=True,
    )


# By name. `feeds.formats.register` adds to them.
REPORT_FORMATS: dict[str, ReportFormat] = {
    row.name: row
    for row in (
        *ASTERIX_FORMATS,
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


# Those that sensors of range and azimuth may report tracks in.
TRACK_FORMATS = tuple(sorted(name for name, row in REPORT_FORMATS.items() if row.tells_tracks))


CUE_TOPIC = "cue"  # End of the topics on which sensors with a mount are told where to look


def is_inbox(topic: str) -> bool:
    """Whether sensors are asked something on a topic, in the words of one of their formats."""
    if topic.endswith(f"/{CUE_TOPIC}"):
        return True
    return any(row.inbox and topic.endswith(f"/{row.inbox}") for row in REPORT_FORMATS.values())
