"""Altitudes of telemetry to heights above the WGS-84 ellipsoid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference

EGM96_GRIDS = ("us_nga_egm96_15.tif", "egm96_15.gtx")
"""The names that PROJ knows the EGM96 geoid by, 15 minutes of arc."""


@dataclass(frozen=True, slots=True)
class AltitudeDatum:
    """What a scene declares of its heights, metres; None where it declares nothing."""

    takeoff_height_m: float | None = None
    """Of the take-off point above the ellipsoid."""
    geoid_undulation_m: float | None = None
    """Of the geoid above the ellipsoid."""

    def height_m(self, report: PositionReport) -> float:
        """The report's height above the WGS-84 ellipsoid, metres; raises `Refused`."""
        match report.altitude_reference:
            case AltitudeReference.ELLIPSOID:
                return report.altitude_m
            case AltitudeReference.ABOVE_TAKEOFF:
                return report.altitude_m + self._takeoff_height_m()
            case AltitudeReference.MEAN_SEA_LEVEL:
                return report.altitude_m + self._undulation_m(report)

    def _takeoff_height_m(self) -> float:
        if self.takeoff_height_m is None:
            detail = "altitude is above take-off, and the scene lacks telemetry.takeoff_height_m"
            raise Refused(Reason.ALTITUDE, detail)
        return self.takeoff_height_m

    def _undulation_m(self, report: PositionReport) -> float:
        if self.geoid_undulation_m is not None:
            return self.geoid_undulation_m
        return egm96_undulation_m(report.latitude_deg, report.longitude_deg)


def egm96_undulation_m(latitude_deg: float, longitude_deg: float) -> float:
    """Height of the EGM96 geoid above the ellipsoid, from an installed grid; raises `Refused`."""
    transformer = _egm96()
    if transformer is None:
        detail = (
            "altitude is above mean sea level: set telemetry.geoid_undulation_m in the scene, or "
            "install plotfeed[geoid] and the grid us_nga_egm96_15.tif (projsync --file "
            "us_nga_egm96_15.tif)"
        )
        raise Refused(Reason.ALTITUDE, detail)
    undulation_m = float(transformer.transform(longitude_deg, latitude_deg, 0.0)[2])
    if not math.isfinite(undulation_m):
        detail = (
            f"the EGM96 grid has no value at latitude {latitude_deg:g}, longitude "
            f"{longitude_deg:g}; set telemetry.geoid_undulation_m in the scene"
        )
        raise Refused(Reason.ALTITUDE, detail)
    return undulation_m


@cache
def _egm96() -> Any | None:
    """A transformer from heights above the geoid to above the ellipsoid; None without a grid."""
    try:
        import pyproj
    except ImportError:
        return None
    pyproj.network.set_network_enabled(active=False)  # type: ignore[attr-defined]
    for grid in EGM96_GRIDS:
        pipeline = (
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
            f"+step +proj=vgridshift +grids={grid} +multiplier=1 "
            "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
        )
        try:
            return pyproj.Transformer.from_pipeline(pipeline)
        except pyproj.exceptions.ProjError:
            continue
    return None
