"""Where a detection is: on the Earth, or in range and bearing from the sensor."""

from __future__ import annotations

from dataclasses import dataclass

from sapient_msg.bsi_flex_335_v2_0.detection_report_pb2 import DetectionReport
from sapient_msg.bsi_flex_335_v2_0.location_pb2 import Location
from sapient_msg.bsi_flex_335_v2_0.range_bearing_pb2 import RangeBearing

from plotfeed.models.state import Columns, Floats, Plots
from plotfeed.proto.sapient.checks import measured
from plotfeed.proto.sapient.node import DEG_M, ELLIPSOID, LAT_LNG, TRUE_NORTH

MAX_RANGE_M = 1e9
MAX_ERROR_DEG = 360.0
JUST_BELOW_360 = 359.99999999999994  # the last float64 before it


@dataclass(frozen=True, kw_only=True)
class Positions(Columns):
    """Where plots are on the Earth, with the errors of that; NaN for those without a place.

    A plot that has none is told as range and bearing, as far as it has these.
    """

    longitude_deg: Floats
    latitude_deg: Floats
    height_m: Floats
    sigma_longitude_deg: Floats
    sigma_latitude_deg: Floats
    sigma_height_m: Floats


class Locations:
    """The places of some plots, ready to be written one after the other."""

    def __init__(self, plots: Plots, positions: Positions | None) -> None:
        """Raises `EncodeError`."""
        self._polar = _checked(
            ("azimuth", plots.azimuth_deg, 0.0, JUST_BELOW_360),
            ("elevation", plots.elevation_deg, -90.0, 90.0),
            ("range", plots.range_m, 0.0, MAX_RANGE_M),
            ("azimuth_error", plots.sigma_azimuth_deg, 0.0, MAX_ERROR_DEG),
            ("elevation_error", plots.sigma_elevation_deg, 0.0, MAX_ERROR_DEG),
            ("range_error", plots.sigma_range_m, 0.0, MAX_RANGE_M),
        )
        self._geodetic = positions and _checked(
            ("x", positions.longitude_deg, -180.0, 180.0),
            ("y", positions.latitude_deg, -90.0, 90.0),
            ("z", positions.height_m, -MAX_RANGE_M, MAX_RANGE_M),
            ("x_error", positions.sigma_longitude_deg, 0.0, MAX_ERROR_DEG),
            ("y_error", positions.sigma_latitude_deg, 0.0, MAX_ERROR_DEG),
            ("z_error", positions.sigma_height_m, 0.0, MAX_RANGE_M),
        )

    def write(self, i: int, report: DetectionReport) -> None:
        """Give a report the place of plot i, whatever it had before."""
        if self._geodetic and self._geodetic[0][1][i] is not None:
            location = report.location
            location.coordinate_system, location.datum = LAT_LNG, ELLIPSOID
            _write(location, self._geodetic, i)
        else:
            bearing = report.range_bearing
            bearing.coordinate_system, bearing.datum = DEG_M, TRUE_NORTH
            _write(bearing, self._polar, i)


_Values = list[tuple[str, list[float | None]]]


def _checked(*columns: tuple[str, Floats, float, float]) -> _Values:
    return [(column[0], measured(*column)) for column in columns]


def _write(place: Location | RangeBearing, columns: _Values, i: int) -> None:
    for name, values in columns:
        value = values[i]
        if value is None:
            place.ClearField(name)
        else:
            setattr(place, name, value)
