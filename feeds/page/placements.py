"""Where a scene's sensors stand, so that the plots of all of them are placed at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plotfeed.feeds.parts import Site
from plotfeed.feeds.places import frame_at, site_frame
from plotfeed.feeds.sensors import Sensor
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
