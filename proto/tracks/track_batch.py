"""Tracks as plotfeed's own protobuf."""

from __future__ import annotations

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.tracks.told_tracks import ToldTracks, TrackOrigin, one_by_one

KINDS = {"smoothed-truth": pb.SMOOTHED_TRUTH, "plain": pb.PLAIN}
_FIELDS = [
    field.name
    for field in pb.Track.DESCRIPTOR.fields
    if field.name not in {"id", "number", "time_utc_ns"}
]


def track_batch(tracks: ToldTracks, origin: TrackOrigin, scan: int, sector: int) -> bytes:
    """A serialised TrackBatch of a sector; what is not estimated is left out."""
    batch = pb.TrackBatch(sensor=origin.sensor, scan=scan, sector=sector, kind=KINDS[origin.kind])
    for told in one_by_one(tracks):
        number = told["track"]
        batch.tracks.add(
            id=origin.name_of(number),
            number=number,
            time_utc_ns=told["t_utc_ns"],
            **{name: told[name] for name in _FIELDS},
        )
    return batch.SerializeToString()
