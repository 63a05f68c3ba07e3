"""Frames: from where a drone is on Earth to what of it is measured from the sensor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.accuracy_chart.case import Case, wrapped
from plotfeed.feeds.accuracy_chart.precise import number
from plotfeed.feeds.accuracy_chart.stage import ChartStage, rms
from plotfeed.models.frames import (
    WGS84_A_M,
    WGS84_E2,
    LocalFrame,
    enu_to_aer,
    geodetic_to_ecef,
    wrap_180,
)
from plotfeed.models.state import Floats
from plotfeed.proto.errors import PlotfeedError

FromGeodetic = Callable[[Floats, Floats, Floats], Floats]

EARTH_RADIUS_M = 6_371_008.8  # m, mean of the three semi-axes (IUGG)
OURS = "ECEF and rotation"


def frames_stage(case: Case) -> ChartStage:
    """Range and angles from truth as each method keeps it, geodetic or ECEF."""
    n = min(case.effort.references, len(case.seen))
    true = [case.measured_precisely(row) for row in range(n)]

    def errors(places: Callable[[], Floats]) -> dict[str, float]:
        return _errors(case.measured(places()[:n], np.arange(n)), true)

    return ChartStage.of(
        "frames",
        "How to turn places on Earth into range and angles",
        [
            (name, partial(_to_angles, places), errors(places))
            for name, places in frame_methods(case).items()
        ],
        units=len(case.seen),
        ours=OURS,
    )


def _to_angles(places: Callable[[], Floats]) -> object:
    return enu_to_aer(places())


def _errors(measured: dict[str, Floats], true: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Rms errors by quantity; each difference is taken before it is rounded to a float."""
    errors = {}
    for name, values in measured.items():
        pairs = zip(values.tolist(), true, strict=True)
        differences = np.array([float(number(value) - exact[name]) for value, exact in pairs])
        errors[name] = rms(wrapped(name, differences))
    return errors


def frame_methods(case: Case) -> dict[str, Callable[[], Floats]]:
    """East, north and up of the seen places, (n, 3), by the name of the method."""
    here, seen = case.frame, case.seen
    geodetic = (seen.latitude_deg, seen.longitude_deg, seen.height_m)
    ecef_m = seen.ecef_m
    found: dict[str, Callable[[], Floats]] = {
        "flat Earth": partial(flat_earth(here), *geodetic),
        "flat, ellipsoidal": partial(ellipsoidal_flat(here), *geodetic),
        "second order": partial(second_order(here), *geodetic),
        "ECEF in float32": partial(single_ecef(here), ecef_m.astype(np.float32)),
        OURS: partial(here.from_ecef, ecef_m),
        "geodetic, by ECEF": lambda: here.from_ecef(geodetic_to_ecef(*geodetic)),
    }
    try:
        return found | {"pyproj": partial(by_pyproj(here), *geodetic)}
    except PlotfeedError:
        return found


def flat_earth(here: LocalFrame) -> FromGeodetic:
    """A sphere, unrolled: north and east as arcs, up as the difference of heights."""
    return _arcs(here, EARTH_RADIUS_M, EARTH_RADIUS_M)


def ellipsoidal_flat(here: LocalFrame) -> FromGeodetic:
    """An unrolled Earth with the ellipsoid's two radii of curvature at the sensor's height."""
    meridian_m, normal_m = _radii_m(here.latitude_deg)
    return _arcs(here, meridian_m + here.height_m, normal_m + here.height_m)


def second_order(here: LocalFrame) -> FromGeodetic:
    """ECEF and rotation by derivatives at the sensor, to second order in all three differences."""
    meridian_m, normal_m = _radii_m(here.latitude_deg)
    meridian_m, normal_m = meridian_m + here.height_m, normal_m + here.height_m
    sine, cosine = _sine_cosine(here.latitude_deg)
    lengthening_m = _meridian_growth_m(here.latitude_deg)

    def enu_m(latitude_deg: Floats, longitude_deg: Floats, height_m: Floats) -> Floats:
        north, east, up_m = _differences(here, latitude_deg, longitude_deg, height_m)
        return np.stack(
            [
                east * (normal_m * cosine - meridian_m * sine * north + cosine * up_m),
                north * (meridian_m + lengthening_m * north / 2 + up_m)
                + normal_m * sine * cosine * east**2 / 2,
                up_m - meridian_m * north**2 / 2 - normal_m * cosine**2 * east**2 / 2,
            ],
            axis=-1,
        )

    return enu_m


def single_ecef(here: LocalFrame) -> Callable[[NDArray[np.float32]], Floats]:
    """Our rotation, of ECEF positions in float32, (n, 3), by numbers in float32."""
    origin_ecef_m = here.origin_ecef_m.astype(np.float32)
    rotation = here.rotation_from_ecef.astype(np.float32)

    def enu_m(ecef_m: NDArray[np.float32]) -> Floats:
        return np.asarray((ecef_m - origin_ecef_m) @ rotation.T, dtype=np.float64)

    return enu_m


def by_pyproj(here: LocalFrame) -> FromGeodetic:
    """PROJ's geocentric and topocentric conversions; raises `PlotfeedError` without pyproj."""
    try:
        from pyproj import Transformer
    except ImportError:
        raise PlotfeedError("pip install 'plotfeed[geoid]' to compare with pyproj") from None
    transform = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        "+step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lat_0={here.latitude_deg!r} +lon_0={here.longitude_deg!r} +h_0={here.height_m!r}"
    ).transform

    def enu_m(latitude_deg: Floats, longitude_deg: Floats, height_m: Floats) -> Floats:
        return np.stack(transform(longitude_deg, latitude_deg, height_m), axis=-1)

    return enu_m


def _arcs(here: LocalFrame, meridian_m: float, normal_m: float) -> FromGeodetic:
    parallel_m = normal_m * _sine_cosine(here.latitude_deg)[1]

    def enu_m(latitude_deg: Floats, longitude_deg: Floats, height_m: Floats) -> Floats:
        north, east, up_m = _differences(here, latitude_deg, longitude_deg, height_m)
        return np.stack([parallel_m * east, meridian_m * north, up_m], axis=-1)

    return enu_m


def _differences(
    here: LocalFrame, latitude_deg: Floats, longitude_deg: Floats, height_m: Floats
) -> tuple[Floats, Floats, Floats]:
    """Latitude and longitude less those of the sensor, radians, and height less its own."""
    return (
        np.radians(latitude_deg - here.latitude_deg),
        np.radians(wrap_180(longitude_deg - here.longitude_deg)),
        height_m - here.height_m,
    )


def _radii_m(latitude_deg: float) -> tuple[float, float]:
    """Radii of curvature: along the meridian, and across it."""
    w2 = 1 - WGS84_E2 * _sine_cosine(latitude_deg)[0] ** 2
    return float(WGS84_A_M * (1 - WGS84_E2) / w2**1.5), float(WGS84_A_M / w2**0.5)


def _meridian_growth_m(latitude_deg: float) -> float:
    """Change of the meridian's radius with latitude, metres a radian."""
    sine, cosine = _sine_cosine(latitude_deg)
    w2 = 1 - WGS84_E2 * sine**2
    return float(3 * WGS84_A_M * (1 - WGS84_E2) * WGS84_E2 * sine * cosine / w2**2.5)


def _sine_cosine(angle_deg: float) -> tuple[float, float]:
    angle = np.radians(angle_deg)
    return float(np.sin(angle)), float(np.cos(angle))
