"""Places on and over the ellipsoid, and detours by way of a target, for make_reference.py."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

from mpmath import mp

Row = dict[str, Any]
F = mp.mpf
SITES = {
    "gulf of Guinea": (0.0, 0.0, 0.0),
    "Madrid": (40.4168, -3.7038, 650.0),
    "Svalbard": (78.2232, 15.6267, 30.0),
    "Quito": (-0.1807, -78.4678, 2850.0),
    "Fiji": (-17.5, 179.9999, 3.0),
    "Aleutians": (51.0, -179.9999, 3.0),
    "North Pole": (90.0, 0.0, 10.0),
    "beside the South Pole": (-89.9999, -123.0, 2800.0),
}
OFFSETS_DEG = (
    *((0.0, 0.0), (1e-9, -1e-9), (0.002, 0.0), (-0.013, 0.021), (0.11, -0.07), (0.0, 0.15)),
    *((-0.0015, -0.001), (0.04, 0.05), (-0.09, -0.002)),
)
HEIGHTS_M = (1.5, 120.0)


def ecef(latitude_deg: Any, longitude_deg: Any, height_m: Any) -> Any:
    """The place at a height over the point of the ellipsoid whose normal has those angles."""
    a, b = axes()
    up = outwards(latitude_deg, longitude_deg)
    # The ellipsoid's point is where the gradient of x2/a2 + y2/a2 + z2/b2 is along the normal.
    foot = mp.matrix([a**2 * up[0], a**2 * up[1], b**2 * up[2]])
    scale = mp.sqrt((a * up[0]) ** 2 + (a * up[1]) ** 2 + (b * up[2]) ** 2)
    return foot / scale + F(height_m) * up


def axes() -> tuple[Any, Any]:
    """The half axes of WGS 84, metres."""
    a = F(6_378_137)
    return a, a * (1 - 1 / F("298.257223563"))


def outwards(latitude_deg: Any, longitude_deg: Any) -> Any:
    """The normal, a unit vector; exact at whole right angles."""
    lat, lon = F(latitude_deg) / 180, F(longitude_deg) / 180
    cos_lat = mp.cospi(lat)
    return mp.matrix([cos_lat * mp.cospi(lon), cos_lat * mp.sinpi(lon), mp.sinpi(lat)])


def frame(latitude_deg: Any, longitude_deg: Any) -> tuple[Any, Any, Any]:
    """East, north and up; at a pole as the limit along its meridian."""
    lon = F(longitude_deg) / 180
    east = mp.matrix([-mp.sinpi(lon), mp.cospi(lon), 0])
    up = outwards(latitude_deg, longitude_deg)
    return east, cross(up, east), up


def cross(a: Any, b: Any) -> Any:
    """The vector product."""
    turns = ((1, 2), (2, 0), (0, 1))
    return mp.matrix([a[i] * b[j] - a[j] * b[i] for i, j in turns])


def dot(a: Any, b: Any) -> Any:
    """The scalar product."""
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


def local() -> Iterator[Row]:
    """Targets as a sensor has them."""
    for (site, here), (lat, lon), h in itertools.product(SITES.items(), OFFSETS_DEG, HEIGHTS_M):
        wrapped = (here[1] + lon + 180) % 360 - 180 if lon else here[1]
        there = (here[0] - lat if here[0] > 89 else here[0] + lat, wrapped, here[2] + h)
        enu = [dot(axis, ecef(*there) - ecef(*here)) for axis in frame(*here[:2])]
        if straight_up := there[0] == here[0] and (not lon or here[0] == 90):
            enu[:2] = F(0), F(0)
        yield {
            "site": site,
            **dict(zip(("sensor_lat", "sensor_lon", "sensor_h"), here, strict=True)),
            **dict(zip(("target_lat", "target_lon", "target_h"), there, strict=True)),
            **dict(zip(("east_m", "north_m", "up_m"), enu, strict=True)),
            **directions(enu, straight_up=straight_up),
        }


def directions(enu: Sequence[Any], *, straight_up: bool = False) -> Row:
    """Azimuth, elevation and range; straight above there is no azimuth."""
    east, north, up = enu
    ground = F(0) if straight_up else mp.sqrt(east**2 + north**2)
    azimuth = mp.nan if straight_up else mp.degrees(mp.atan2(east, north))
    return {
        "azimuth_deg": azimuth + 360 if azimuth < 0 else azimuth,
        "elevation_deg": mp.degrees(mp.atan2(up, ground)),
        "slant_range_m": mp.sqrt(ground**2 + up**2),
    }


def inverse() -> Iterator[Row]:
    """Where measurements are, by Newton's method for latitude and height along the normal."""
    measured = itertools.product((0.0, 137.0, 301.5), (-4.0, 0.0, 35.0), (60.0, 19_000.0))
    for (site, here), (azimuth, elevation, slant) in itertools.product(SITES.items(), measured):
        az, el = F(azimuth) / 180, F(elevation) / 180
        enu = (
            mp.cospi(el) * mp.sinpi(az) * slant,
            mp.cospi(el) * mp.cospi(az) * slant,
            mp.sinpi(el) * slant,
        )
        place = ecef(*here)
        for axis, length in zip(frame(*here[:2]), enu, strict=True):
            place += axis * length
        lat, h = foot(mp.sqrt(place[0] ** 2 + place[1] ** 2), place[2])
        yield {
            "site": site,
            **dict(zip(("sensor_lat", "sensor_lon", "sensor_h"), here, strict=True)),
            "azimuth_deg": azimuth,
            "elevation_deg": elevation,
            "slant_range_m": slant,
            "lat_deg": lat,
            "lon_deg": mp.degrees(mp.atan2(place[1], place[0])),
            "h_m": h,
        }


def foot(axis_m: Any, z_m: Any) -> tuple[Any, Any]:
    """Latitude and height of what is so far from the axis and from the equator's plane."""
    a, b = axes()

    def missed(lat: Any, h: Any) -> list[Any]:
        c, s = mp.cos(lat), mp.sin(lat)
        scale = mp.sqrt((a * c) ** 2 + (b * s) ** 2)
        return [(a**2 / scale + h) * c - axis_m, (b**2 / scale + h) * s - z_m]

    near = mp.atan2(z_m, axis_m * (b / a) ** 2)
    lat, h = mp.findroot(missed, (near, mp.sqrt(axis_m**2 + z_m**2) - a), tol=F("1e-80"))
    return mp.degrees(lat), h


TRANSMITTERS = {
    "east": (20_000, 0, 0),
    "north-east, on a mast": (9_900, 9_900, 300),
    "west": (-5_000, 0, 80),
}
TARGETS = ((0, 3_000, 50), (2_500, 1, 120), (-700, -900, 35), (4_000, 9_000, 500), (1, 400, 0))


def bistatic() -> Iterator[Row]:
    """Detours, and the range from them by where an ellipse is in a direction from its focus."""
    for (case, transmitter), target in itertools.product(TRANSMITTERS.items(), TARGETS):
        yield detour(case, transmitter, target)
    yield detour("straight above", (20_000, 0, 0), (0, 0, 90))
    yield detour("a metre off the baseline", (20_000, 0, 0), (8_000, 1, 0))


def detour(case: str, transmitter: Sequence[int], target: Sequence[int]) -> Row:
    """One of them. The slopes are derivatives of that range, taken numerically."""
    to_tx, to_target = mp.matrix(transmitter), mp.matrix(target)
    base, r_rx = mp.norm(to_tx), mp.norm(to_target)
    r_tx = mp.norm(to_target - to_tx)
    total = r_tx + r_rx
    beta = 2 * mp.atan2(
        mp.norm(to_target / r_rx - to_tx / base), mp.norm(to_target / r_rx + to_tx / base)
    )

    def from_focus(path: Any, angle: Any) -> Any:
        """The polar equation about a focus, the other one in direction 0 at the baseline."""
        return (path**2 - base**2) / (2 * (path - base * mp.cos(angle)))

    return {
        "case": case,
        **dict(zip(("tx_e", "tx_n", "tx_u"), transmitter, strict=True)),
        **dict(zip(("t_e", "t_n", "t_u"), target, strict=True)),
        "rb": base,
        "r_tx": r_tx,
        "r_rx": r_rx,
        "bistatic_range": total - base,
        "azimuth_deg": directions(
            [F(part) for part in target], straight_up=target[0] == target[1] == 0
        )["azimuth_deg"],
        "beta_rx_deg": mp.degrees(beta),
        "r_rx_from_range_and_beta": from_focus(total, beta),
        "drrx_dsum": mp.diff(lambda path: from_focus(path, beta), total),
        "drrx_dbeta_m_per_rad": mp.diff(lambda angle: from_focus(total, angle), beta),
    }
