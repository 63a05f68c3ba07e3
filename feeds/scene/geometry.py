"""Places of a scene on the Earth."""

from __future__ import annotations

import numpy as np

from plotfeed.feeds.scene.fields import Enu, Location, Site
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import Floats


def site_frame(site: Site) -> LocalFrame:
    """East, north, up of the site."""
    return LocalFrame(site.latitude_deg, site.longitude_deg, site.height_m)


def frame_at(site: Site, position_enu_m: Enu) -> LocalFrame:
    """East, north, up of a sensor that stands off the site."""
    return LocalFrame(*(float(x) for x in site_frame(site).to_geodetic(np.array(position_enu_m))))


def geodetic(site: Site, place: Location) -> Floats:
    """Latitude, longitude and height above the ellipsoid of a place; (3,)."""
    if place.latitude_deg is not None:
        return np.array([place.latitude_deg, place.longitude_deg, place.height_m])
    east_m, north_m, above_m = place.east_m, place.north_m, place.above_site_m
    latitude_deg, longitude_deg, _ = site_frame(site).to_geodetic(
        np.array([east_m, north_m, 0.0], dtype=np.float64)
    )
    return np.array([latitude_deg, longitude_deg, site.height_m + (above_m or 0.0)])


def enu_from(frame: LocalFrame, site: Site, place: Location) -> Floats:
    """A place seen from a frame, metres east, north, up; (3,)."""
    return frame.from_ecef(geodetic_to_ecef(*geodetic(site, place)))
