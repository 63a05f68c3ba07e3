"""Messages of tracks in formats other than ASTERIX: one a sector, or one a track."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from plotfeed.feeds.formats import Format, Sensors, addresses_in
from plotfeed.feeds.formats.sensor_tracks import tracks_keys_of
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message, SectorStamp, numbered
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.proto.tracks.encode_tracks import (
    LiveFeatures,
    ToldTracks,
    TrackOrigin,
    air_traffic,
    cot_events,
    f3411_flights,
    feature_collection,
    location_fixes,
    track_batch,
)

# What makes a payload or several of the tracks of a sector, of which there is at least one.
Encoder = Callable[[ToldTracks, TrackOrigin, SectorStamp], bytes | Sequence[bytes]]


class TrackMessages:
    """Makes the messages of sectors that have tracks, each sensor's by an encoder of its own."""

    def __init__(
        self, name: str, encoder: Callable[[], Encoder], scene: Scene, sensors: Sensors
    ) -> None:
        facts = REPORT_FORMATS[name]
        self._encoders = {i: encoder() for i in sensors}
        self._origins = {i: origin_of(sensor) for i, sensor in sensors.items()}
        self._addresses = addresses_in(scene, sensors, facts)

    def messages(self, batch: Batch) -> list[list[Message]]:
        """Messages of each sector; none of one without tracks."""
        by = batch.of_tracks.tolist()
        found: list[list[Message]] = [[] for _ in range(len(batch))]
        of_sectors = zip(batch.sectors.sensor.tolist(), batch.stamps, strict=True)
        for k, (sensor, stamp) in enumerate(of_sectors):
            if by[k] < by[k + 1]:
                tracks = batch.tracks.between(by[k], by[k + 1])
                said = self._encoders[sensor](tracks, self._origins[sensor], stamp)
                payloads = [said] if isinstance(said, bytes) else said
                found[k] = numbered(self._addresses[sensor], payloads, stamp)
        return found


def origin_of(sensor: Sensor) -> TrackOrigin:
    """Whose tracks a sensor's are; they are stale when they would have ended for want of plots."""
    keys = tracks_keys_of(sensor)
    stale_after_s = (keys.drop_misses + 1) * sensor.scan.period_s
    return TrackOrigin(sensor=sensor.id, kind=keys.kind, stale_after_s=stale_after_s)


def _anywhere(encode: Callable[[ToldTracks, TrackOrigin], bytes | Sequence[bytes]]) -> Encoder:
    """An encoder that does not say of which sector tracks are."""
    return lambda tracks, origin, _: encode(tracks, origin)


ENCODERS: dict[str, Callable[[], Encoder]] = {
    "tracks": lambda: lambda tracks, origin, at: track_batch(tracks, origin, at.scan, at.index),
    "cot": lambda: _anywhere(cot_events),
    "geojson": lambda: _anywhere(feature_collection),
    "air-traffic": lambda: _anywhere(air_traffic),
    "f3411": lambda: _anywhere(f3411_flights),
    "foxglove-geojson": lambda: _anywhere(LiveFeatures().message),
    "foxglove-location": lambda: _anywhere(location_fixes),
}


# Rows of the table of formats.
TRACK_ROWS = {
    name: Format(
        facts=REPORT_FORMATS[name],
        maker=partial(TrackMessages, name, ENCODERS[name]),
        plots_in=None,
    )
    for name in ENCODERS
}
