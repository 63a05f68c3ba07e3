"""WGS-84, Earth-centred and local frames, azimuth-elevation-range, and the folding of angles.

ECEF is Earth-centred, Earth-fixed; ENU is east-north-up on a sensor's own ellipsoidal horizontal.
Azimuth is clockwise from true north in [0, 360), elevation above the horizontal.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Bools, Floats, Ints

WGS84_A_M, WGS84_F = 6_378_137.0, 1 / 298.257223563  # m, semi-major axis, and flattening (WGS 84)
WGS84_B_M = WGS84_A_M * (1 - WGS84_F)  # m, semi-minor axis
WGS84_E2 = WGS84_F * (2 - WGS84_F)  # first eccentricity, squared
WGS84_EP2 = WGS84_E2 / (1 - WGS84_F) ** 2  # second eccentricity, squared

# Offsets across the vertical below this are rounding: float64 in ECEF steps by some 1e-9 m.
RESOLUTION_M = 5e-9
# How often Bowring's is repeated: one step is enough for heights, two leave latitudes rounding.
BOWRING_STEPS = 2
FEW = 300  # Numbers on which a call of NumPy costs more than its arithmetic
# Closer to the Earth's centre than 43 km, a point has several geodetic latitudes.
MIN_GEOCENTRIC_M = 100e3
DEG, RAD = 180.0 / np.pi, np.pi / 180.0
# Distances from the Earth's axis and along it, sines and cosines of latitudes: floats or (...).
Meridian = tuple[Any, ...]


@nan_without_warnings
def wrap_180(angle_deg: ArrayLike) -> Floats:
    """Angle folded into [-180, 180), degrees, as a difference of azimuths or longitudes needs."""
    angle = np.array(angle_deg, dtype=np.float64)
    # One turn more or less is exact; adding 180 would cost an angle its last digits.
    angle += 360.0 * np.subtract(angle < -180.0, angle >= 180.0, dtype=np.float64)
    beyond = ~((angle >= -180.0) & (angle < 180.0))
    if beyond.any():
        angle[beyond] = wrap_360(angle[beyond] + 180.0) - 180.0
    return angle


@nan_without_warnings
def wrap_360(angle_deg: ArrayLike) -> Floats:
    """Angle folded into [0, 360), degrees."""
    angle = np.array(angle_deg, dtype=np.float64)
    angle += 0.0  # no zero has a sign
    outside = ~((angle >= 0.0) & (angle < 360.0))
    if outside.any():
        turned = np.mod(angle[outside], 360.0)
        angle[outside] = np.where(turned == 360.0, 0.0, turned)  # what -1e-17 is rounded to
    return angle


@nan_without_warnings
def geodetic_to_ecef(
    latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: ArrayLike
) -> Floats:
    """ECEF position, metres, (..., 3), of WGS-84 latitude, longitude and ellipsoidal height."""
    sin_lat, cos_lat = _sin_cos_deg(latitude_deg)
    sin_lon, cos_lon = _sin_cos_deg(longitude_deg)
    height = as_floats(height_m)
    normal_m = WGS84_A_M / np.sqrt(1 - WGS84_E2 * sin_lat**2)  # prime-vertical radius
    axis_m = (normal_m + height) * cos_lat
    polar_m = (normal_m * (1 - WGS84_F) ** 2 + height) * sin_lat
    return _stack(axis_m * cos_lon, axis_m * sin_lon, polar_m)


@nan_without_warnings
def ecef_to_geodetic(ecef_m: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Latitude and longitude, degrees, and ellipsoidal height, metres, each (...), of (..., 3).

    Bowring (1976), repeated until it is good to rounding, in a form that is even at the poles.
    The longitude of a pole is 0. NaN near the Earth's centre, where latitude is ambiguous.
    """
    x, y, z = np.moveaxis(as_floats(ecef_m), -1, 0)
    p = np.hypot(x, y)
    north, out = _unit(z, (1 - WGS84_F) * p)  # of the parametric latitude
    for _ in range(BOWRING_STEPS):
        sin_lat, cos_lat = _unit(
            z + WGS84_EP2 * WGS84_B_M * (north * north * north),
            p - WGS84_E2 * WGS84_A_M * (out * out * out),
        )
        north, out = _unit((1 - WGS84_F) * sin_lat, cos_lat)
    height = p * cos_lat + z * sin_lat - WGS84_A_M * np.sqrt(1 - WGS84_E2 * sin_lat**2)
    defined = np.hypot(p, z) >= MIN_GEOCENTRIC_M
    return (
        np.where(defined, np.degrees(np.arctan2(sin_lat, cos_lat)), np.nan),
        np.where(defined, np.degrees(np.arctan2(y, x)), np.nan),
        np.where(defined, height, np.nan),
    )


def _height_m(p2: Floats, z: Floats) -> Floats:
    """Height of `ecef_to_geodetic`, by squared distance from the Earth's axis, and along it; (...).

    At a fraction of its cost: one step, no angles.
    """
    p, squashed = np.sqrt(p2), z / (1 - WGS84_F)
    length = np.sqrt(p2 + squashed * squashed)
    north, out = squashed / length, p / length
    sin_part = z + WGS84_EP2 * WGS84_B_M * (north * north * north)
    cos_part = p - WGS84_E2 * WGS84_A_M * (out * out * out)
    length = np.sqrt(sin_part * sin_part + cos_part * cos_part)
    sin_lat, cos_lat = sin_part / length, cos_part / length
    height = p * cos_lat + z * sin_lat - WGS84_A_M * np.sqrt(1 - WGS84_E2 * (sin_lat * sin_lat))
    deep = p2 + z * z < MIN_GEOCENTRIC_M**2
    return np.where(deep, np.nan, height) if np.any(deep) else height


@nan_without_warnings
def axes_enu(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> Floats:
    """East, north and up at places, each as a unit vector in ECEF; (...) in, (3, 3, ...) out."""
    sin_lat, cos_lat = _sin_cos_deg(latitude_deg)
    sin_lon, cos_lon = _sin_cos_deg(longitude_deg)
    return np.array(
        [
            [-sin_lon, cos_lon, np.zeros_like(sin_lon)],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ],
        dtype=np.float64,
    )


class Axes:
    """East, north and up at places on WGS-84: offsets and rotations from ECEF.

    Those of several places broadcast against what they are given, one a row. To the last bit, each
    row is what its own place alone makes of it.
    """

    def __init__(
        self, origin_ecef_m: Floats, rotation_from_ecef: Floats, meridian: Meridian
    ) -> None:
        """Where the axes stand, metres, (..., 3), and unit vectors, one a row, (..., 3, 3)."""
        self.origin_ecef_m = origin_ecef_m
        self.rotation_from_ecef = rotation_from_ecef
        # Distance from the Earth's axis and along it, sine and cosine of the latitude; (...).
        self.meridian = meridian

    @classmethod
    def of(cls, places: Sequence[Axes]) -> Axes:
        """Stack places, one a row; a single one is itself, for it broadcasts against any rows."""
        if len(places) == 1:
            return places[0]
        meridians = zip(*(place.meridian for place in places), strict=True)
        return cls(
            np.array([place.origin_ecef_m for place in places]),
            np.array([place.rotation_from_ecef for place in places]),
            tuple(np.array(part) for part in meridians),
        )

    def rows(self, which: NDArray[Any], /) -> Axes:
        """Axes at those indices, of any shape (...), which may recur; of one place, as they are."""
        if self.origin_ecef_m.ndim == 1:
            return self
        meridian = tuple(part[which] for part in self.meridian)
        return Axes(self.origin_ecef_m[which], self.rotation_from_ecef[which], meridian)

    @nan_without_warnings
    def from_ecef(self, ecef_m: ArrayLike) -> Floats:
        """East, north, up of ECEF positions, metres; (..., 3) in, (..., 3) out.

        Straight above and below the place, east and north are exactly zero.
        """
        enu_m = _rotate(self.rotation_from_ecef, as_floats(ecef_m) - self.origin_ecef_m)
        vertical = _is_vertical(enu_m[..., 0], enu_m[..., 1])
        if vertical.any():
            enu_m[..., :2][vertical] = 0.0
        return enu_m

    @nan_without_warnings
    def azimuths_deg(self, ecef_m: Floats) -> Floats:
        """Azimuths alone of ECEF positions, to the last bit those of their ENU; (..., 3) to (...).

        NaN straight above and below.
        """
        level_m = _rotate(self.rotation_from_ecef[..., :2, :], ecef_m - self.origin_ecef_m)
        east, north = level_m[..., 0], level_m[..., 1]
        azimuth_deg = _azimuth_deg(east, north)
        vertical = _is_vertical(east, north)
        return np.where(vertical, np.nan, azimuth_deg) if vertical.any() else azimuth_deg

    def has_within(self, ecef_m: Floats, distance_m: float | Floats) -> Bools:
        """Whether ECEF positions are as near, or a hair further; (..., 3) in, (...) out."""
        x, y, z = _components(ecef_m - self.origin_ecef_m)
        return np.asarray(x * x + y * y + z * z <= (distance_m * (1 + 1e-9)) ** 2)

    def to_ecef(self, enu_m: ArrayLike) -> Floats:
        """ECEF of east, north, up positions, metres; (..., 3) in, (..., 3) out."""
        return self.origin_ecef_m + self.rotate_to_ecef(enu_m)

    @nan_without_warnings
    def heights_m(
        self, azimuth_deg: ArrayLike, elevation_deg: ArrayLike, range_m: ArrayLike
    ) -> Floats:
        """Ellipsoidal heights, metres, of places by azimuth, elevation and slant range; (...).

        In the plane of the meridian, by one sine and one cosine. That of the azimuth is in single
        precision, ten times as fast: it only moves the place along its circle about the sensor, on
        which the Earth's curvature varies by 0.7 %: at 100 km, 2 micrometres.
        """
        out_m, along_m, sin_lat, cos_lat = self.meridian
        slant_m = as_floats(range_m)
        up = slant_m * np.sin(as_floats(elevation_deg) * RAD)
        ground2 = np.maximum(slant_m * slant_m - up * up, 0.0)
        azimuth_rad = (as_floats(azimuth_deg) * RAD).astype(np.float32)
        north = np.where(ground2 == 0.0, 0.0, np.sqrt(ground2) * np.cos(azimuth_rad))
        out = out_m + (up * cos_lat - north * sin_lat)
        along = along_m + (up * sin_lat + north * cos_lat)
        return _height_m(out * out + (ground2 - north * north), along)

    def to_geodetic(self, enu_m: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Latitude and longitude, degrees, and height, metres, each (...), of ENU (..., 3)."""
        return ecef_to_geodetic(self.to_ecef(enu_m))

    def rotate_from_ecef(self, vector_ecef: ArrayLike) -> Floats:
        """Components along east, north, up of ECEF vectors such as velocities; (..., 3)."""
        return _rotate(self.rotation_from_ecef, as_floats(vector_ecef))

    def rotate_to_ecef(self, vector_enu: ArrayLike) -> Floats:
        """ECEF components of vectors given along east, north, up; (..., 3)."""
        return _rotate(np.swapaxes(self.rotation_from_ecef, -1, -2), as_floats(vector_enu))


@dataclass(frozen=True)
class LocalFrame(Axes):
    """East, north and up at a place on WGS-84."""

    latitude_deg: float
    longitude_deg: float
    height_m: float

    @cached_property
    def origin_ecef_m(self) -> Floats:  # type: ignore[override]
        """Where the frame stands, ECEF, metres; (3,)."""
        return geodetic_to_ecef(self.latitude_deg, self.longitude_deg, self.height_m)

    @cached_property
    def rotation_from_ecef(self) -> Floats:  # type: ignore[override]
        """East, north and up as unit vectors in ECEF, one a row; (3, 3)."""
        return axes_enu(self.latitude_deg, self.longitude_deg)

    @cached_property
    def meridian(self) -> Meridian:  # type: ignore[override]
        """Distance from the Earth's axis and along it, sine and cosine of the latitude."""
        x, y, z = self.origin_ecef_m.tolist()
        sin_lat, cos_lat = _sin_cos_deg(self.latitude_deg)
        return float(np.hypot(x, y)), z, float(sin_lat), float(cos_lat)


def distance_m(vector_m: Floats) -> Floats:
    """Lengths of vectors; (..., 3) in, (...) out."""
    x, y, z = _components(vector_m)
    return np.sqrt(x * x + y * y + z * z)


@nan_without_warnings
def enu_to_aer(enu_m: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Azimuth and elevation, degrees, and slant range, metres, each (...), of ENU (..., 3).

    Azimuth is NaN straight above and below, elevation too at no distance at all.
    """
    east, north, up = _components(as_floats(enu_m))
    ground2 = east * east + north * north
    ground_m, range_m = np.sqrt(ground2), np.sqrt(ground2 + up * up)
    azimuth_deg, elevation_deg = _azimuth_deg(east, north), np.arctan2(up, ground_m) * DEG
    vertical = ground_m == 0
    if vertical.any():
        azimuth_deg = np.where(vertical, np.nan, azimuth_deg)
        elevation_deg = np.where(range_m == 0, np.nan, elevation_deg)
    return azimuth_deg, elevation_deg, range_m


@nan_without_warnings
def aer_to_enu(azimuth_deg: ArrayLike, elevation_deg: ArrayLike, range_m: ArrayLike) -> Floats:
    """East, north, up, metres, (..., 3), by azimuth, elevation (at ±90, any), and slant range."""
    sin_az, cos_az = _sin_cos_deg(azimuth_deg)
    sin_el, cos_el = _sin_cos_deg(elevation_deg)
    slant_m = as_floats(range_m)
    ground_m = slant_m * cos_el
    east, north = (np.where(ground_m == 0.0, 0.0, ground_m * each) for each in (sin_az, cos_az))
    return _stack(east, north, slant_m * sin_el)


def _sin_cos_deg(angle_deg: ArrayLike) -> tuple[Floats, Floats]:
    """Sine and cosine of degrees, exact at multiples of 90.

    Reduced to an eighth of a turn before it becomes radians: the rounding of pi times the Earth's
    radius would show.
    """
    angle = as_floats(angle_deg)
    quarters = np.round(angle / 90.0)
    rest_rad = np.radians(angle - 90.0 * quarters)
    sine, cosine = np.sin(rest_rad), np.cos(rest_rad)
    quadrant = np.mod(quarters, 4.0)
    odd = np.mod(quadrant, 2.0) == 1.0
    sign_sin = np.where(quadrant >= 2.0, -1.0, 1.0)
    sign_cos = np.where((quadrant == 1.0) | (quadrant == 2.0), -1.0, 1.0)
    # Adding zero makes -0.0 an ordinary zero, so that no azimuth turns round with its sign.
    return (
        sign_sin * np.where(odd, cosine, sine) + 0.0,
        sign_cos * np.where(odd, sine, cosine) + 0.0,
    )


@nan_without_warnings
def _rotate(matrix: Floats, vector: Floats) -> Floats:
    """Matrix times each vector; (k, 3) or (..., k, 3), and (..., 3) in, (..., k) out.

    Spelt out, because a matrix product may round differently with the number of rows, and the
    same drone must give the same bytes in whatever company: all k components at once of few
    vectors, one after the other of many, each as one piece of memory.
    """
    if vector.size < FEW:
        x, y, z = vector[..., 0:1], vector[..., 1:2], vector[..., 2:3]
        together: Floats = x * matrix[..., 0] + y * matrix[..., 1] + z * matrix[..., 2]
        return together
    x, y, z = _components(vector)
    rotated = np.empty((matrix.shape[-2], *np.broadcast_shapes(x.shape, matrix.shape[:-2])))
    for i in range(len(rotated)):
        component = rotated[i, ...]
        a, b, c = _components(matrix[..., i, :])
        np.multiply(x, a, out=component)
        component += y * b
        component += z * c
    return np.moveaxis(rotated, 0, -1)


def _is_vertical(east: Floats, north: Floats) -> Bools:
    """Whether there is nothing across the vertical but rounding."""
    return east * east + north * north < RESOLUTION_M**2


def _azimuth_deg(east: Floats, north: Floats) -> Floats:
    """Azimuth in [0, 360); of no direction, what the arc tangent makes of two zeros."""
    azimuth_deg = np.arctan2(east, north) * DEG
    azimuth_deg = azimuth_deg + 360.0 * (azimuth_deg < 0)
    whole = azimuth_deg == 360.0  # what -1e-17 is rounded to
    return np.where(whole, 0.0, azimuth_deg) if whole.any() else azimuth_deg


def _unit(sine_part: Floats, cosine_part: Floats) -> tuple[Floats, Floats]:
    """Sine and cosine of the angle whose tangent is the ratio of the two."""
    length = np.hypot(sine_part, cosine_part)
    return sine_part / length, cosine_part / length


def _components(vector: Floats) -> tuple[Floats, Floats, Floats]:
    """The three of each vector; (..., 3) in, (...) out."""
    return vector[..., 0], vector[..., 1], vector[..., 2]


def _stack(x: Floats, y: Floats, z: Floats) -> Floats:
    """Three components, broadcast against each other, as (..., 3)."""
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


A_HAIR_M = 1.0  # More than all that is rounded


def rows_about(frames: Axes, positions_ecef_m: Floats, within_m: Floats) -> Ints:
    """Columns of positions (k, n, 3) that may be within distances (m,) of their frames, in order.

    By one sphere about all frames, which is quick; whoever is out of it, or NaN, is near none.
    """
    centre_m, radius_m = _sphere_about(frames)
    reach_m = radius_m + np.max(within_m) + A_HAIR_M
    return np.flatnonzero((distance_m(positions_ecef_m - centre_m) <= reach_m).any(axis=0))


def are_all_within(frames: Axes, positions_ecef_m: Floats, within_m: Floats) -> bool:
    """Whether all positions (..., 3) are within distances (m,) of all frames, which is quick.

    By the same sphere: where it says no, they may be.
    """
    centre_m, radius_m = _sphere_about(frames)
    furthest_m = np.max(distance_m(positions_ecef_m - centre_m), initial=0.0)
    return bool(radius_m + furthest_m + A_HAIR_M <= np.min(within_m))


def _sphere_about(frames: Axes) -> tuple[Floats, float]:
    """The centre, (3,), and the radius of a sphere that holds all origins of frames, metres."""
    origins_m = frames.origin_ecef_m.reshape(-1, 3)
    centre_m = origins_m.mean(axis=0)
    return centre_m, float(distance_m(origins_m - centre_m).max())


# Mean sea level: how high the EGM96 geoid lies above the WGS-84 ellipsoid.
#
# EGM96 is the Earth gravitational model of 1996 (NASA GSFC, NIMA and Ohio State University;
# NASA/TP- 1998-206861), whose geoid the US National Geospatial-Intelligence Agency publishes
# every 15'. Every second of its heights, in whole decimetres, is the grid beside this file, which
# `docs/commands/write_geoid.py` makes.
# Undulations, from 90 deg north southwards and from the meridian of Greenwich eastwards.
Decimetres = NDArray[np.int16]
GRID_FILE = "egm96-30.grid"
CELLS_A_DEG = 2
ROWS, COLUMNS = 180 * CELLS_A_DEG + 1, 360 * CELLS_A_DEG


@nan_without_warnings
def geoid_undulation_m(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> Floats:
    """Height of mean sea level above the ellipsoid, metres, at places; broadcasts; (...).

    Bilinear between the nodes of a grid of 30'. Against EGM96 every 15' that is 0.13 m rms, within
    1.3 m at 99.9 % of places and 3.9 m at all; the geoid itself reaches from -107 to 85 m.
    """
    grid_dm = _grid_dm()
    row = (90.0 - as_floats(latitude_deg)) * CELLS_A_DEG
    column = np.mod(as_floats(longitude_deg), 360.0) * CELLS_A_DEG
    i, j = _cell(row, ROWS - 2), _cell(column, COLUMNS - 1)
    south, east = row - i, column - j
    north_dm = grid_dm[i, j] + east * (grid_dm[i, j + 1] - grid_dm[i, j])
    south_dm = grid_dm[i + 1, j] + east * (grid_dm[i + 1, j + 1] - grid_dm[i + 1, j])
    undulation_m: Floats = (north_dm + south * (south_dm - north_dm)) / 10.0
    return undulation_m


def _cell(position: Floats, last: int) -> NDArray[np.int64]:
    """The cells, from 0 to the last, that positions along an axis of the grid are in; of NaN, 0."""
    return np.clip(np.nan_to_num(position), 0, last).astype(np.int64)


@cache
def _grid_dm() -> Floats:
    """The grid with its first meridian again behind the last; (ROWS, COLUMNS + 1)."""
    grid_dm = unpacked(files(__package__).joinpath(GRID_FILE).read_bytes()).astype(np.float64)
    return np.concatenate([grid_dm, grid_dm[:, :1]], axis=1)


def packed(grid_dm: Decimetres) -> bytes:
    """A grid (ROWS, COLUMNS) as it is kept: differences southwards of differences eastwards."""
    steps = np.diff(np.diff(grid_dm, axis=1, prepend=0), axis=0, prepend=0)
    return zlib.compress(steps.astype("<i2").tobytes(), 9)


def unpacked(data: bytes) -> Decimetres:
    """The grid in what `packed` made of it."""
    steps = np.frombuffer(zlib.decompress(data), "<i2").reshape(ROWS, COLUMNS)
    grid_dm: Decimetres = steps.cumsum(axis=0).cumsum(axis=1).astype(np.int16)
    return grid_dm
