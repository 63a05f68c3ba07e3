"""ASTERIX as sensors speak it that track on board: categories 062 and 063."""

from __future__ import annotations

import numpy as np

from plotfeed.feeds.formats import (
    AsterixFormat,
    Blocks,
    Format,
    Sensors,
    limits_of,
    says_how_it_is,
    sources_of,
)
from plotfeed.feeds.messages.batch import Batch, of_parts
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto.asterix.cat062 import TrackEncoder062, status_063
from plotfeed.proto.asterix.codec.encode import Parts


class Asterix062(AsterixFormat):
    """Tracks of category 062 after each sector, and every ten seconds the sensor in 063.

    The system's reference point is the scene's site.
    """

    def __init__(self, scene: Scene, sensors: Sensors) -> None:
        super().__init__(scene, sensors)
        source = sources_of(sensors)
        self._encoder = TrackEncoder062(*source, max_octets=limits_of(scene, sensors))
        self._status = status_063(*source)

    def blocks(self, batch: Batch) -> list[Blocks]:
        """Blocks of category 062, then 063 where it is due."""
        tracks_of: list[list[bytes]] = [[] for _ in range(len(batch))]
        filled = np.flatnonzero(np.diff(batch.of_tracks))
        # Heights are sent, or not, for all tracks of a sensor.
        is_flat = np.isnan(batch.tracks.height_m[batch.of_tracks[filled]])
        for which in (filled[is_flat], filled[~is_flat]):
            if len(which):
                tracks, by = of_parts(batch.tracks, batch.of_tracks, which)
                parts = Parts(by, self._numbers[batch.sectors.sensor[which]])
                blocks_by = self._encoder.blocks_by(tracks, parts)
                for i, blocks in zip(which.tolist(), blocks_by, strict=True):
                    tracks_of[i] = blocks
        status = says_how_it_is(63, batch.sectors, self._numbers, self._status.one_each)
        return [(62, tracks_of), *status]


FORMAT = Format(facts=REPORT_FORMATS["asterix-062"], maker=Asterix062, plots_in=None)
