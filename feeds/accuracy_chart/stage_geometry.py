"""Where drones are when a rotating beam is there, and what of them the sensor measures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.accuracy_chart.case import Case, wrapped
from plotfeed.feeds.accuracy_chart.precise import number
from plotfeed.feeds.accuracy_chart.stage import ChartStage, rms
from plotfeed.feeds.console.extras import need_extra
from plotfeed.models.beam import Sector, Sectors, Timetable
from plotfeed.models.beam_meetings import Borders, meetings
from plotfeed.models.frames import (
    WGS84_A_M,
    WGS84_E2,
    LocalFrame,
    enu_to_aer,
    geodetic_to_ecef,
    wrap_180,
)
from plotfeed.models.state import Bools, Floats, Ints, Signature, TruthState
from plotfeed.models.truth import Trajectories
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

FromGeodetic = Callable[[Floats, Floats, Floats], Floats]
EARTH_RADIUS_M = 6_371_008.8  # m, mean of the three semi-axes (IUGG)
OUR_FRAME = "ECEF and rotation"
OUR_PASSAGE = "beam passage, a turn at once"
SOME_SCAN = 1000
BISECTIONS = 70
"""They halve a scan down to the last bit of a float."""
Found = tuple[Ints, Floats]
"""Which drones the beam meets, and where they are then, (n, 3)."""


@dataclass(frozen=True, slots=True)
class ScannedFlights:
    """The seen drones flying straight on through one scan, so that they are there in its middle."""

    case: Case
    trajectories: Trajectories
    sectors: list[Sector]

    @property
    def start_ns(self) -> int:
        """When the beam is at north."""
        return self.sectors[0].start_ns

    @property
    def period_ns(self) -> int:
        """How long a turn lasts."""
        return self.sectors[-1].end_ns - self.start_ns

    @property
    def drones(self) -> Ints:
        """Every drone."""
        return np.arange(len(self.case.seen))

    def enu_m(self, t_ns: Ints | int) -> Floats:
        """Where each is at a time of its own, or of all; (n, 3)."""
        t_ns = np.broadcast_to(t_ns, len(self.drones))
        state = self.trajectories.state_at(t_ns, self.drones)
        return self.case.frame.from_ecef(state.position_ecef_m)

    def azimuths_deg(self, t_ns: Ints | int) -> Floats:
        """Azimuths of those places; (n,)."""
        return enu_to_aer(self.enu_m(t_ns))[0]


def beam_stage(case: Case) -> ChartStage | None:
    """Against the instant at which the beam meets each drone; None for a sensor that stares."""
    if not case.sensor.scan.rotates:
        return None
    flights = _flights(case)
    passed, true_enu_m = crossings(flights)
    calls: dict[str, Callable[[], Found]] = {
        "instant of the scan": partial(_at_the_end, flights),
        "instant of the sector": partial(_at_sector_ends, flights),
        "one step from north": partial(_from_north, flights, 1),
        "three steps from north": partial(_from_north, flights, 3),
        "beam passage, sector by sector": partial(_sector_by_sector, flights),
        OUR_PASSAGE: partial(_passages, flights),
    }
    return ChartStage.of(
        "beam timing",
        "How to find where drones are when the beam is there",
        [
            (name, call, _passage_errors(case, call(), passed, true_enu_m))
            for name, call in calls.items()
        ],
        units=len(case.seen),
        ours=OUR_PASSAGE,
    )


def crossings(flights: ScannedFlights) -> tuple[Bools, Floats]:
    """Which drones the beam meets once within the scan, and where they are then, by bisection."""
    period_s = flights.period_ns / NS
    start_enu_m = flights.enu_m(flights.start_ns)
    velocity_m_s = flights.case.velocity_enu_m_s
    start_deg = enu_to_aer(start_enu_m)[0]

    def ahead_deg(t_s: Floats) -> Floats:
        azimuth_deg = enu_to_aer(start_enu_m + t_s[:, None] * velocity_m_s)[0]
        return start_deg + wrap_180(azimuth_deg - start_deg) - 360 * t_s / period_s

    low, high = np.zeros(len(start_deg)), np.full(len(start_deg), period_s)
    passed = (ahead_deg(low) >= 0) & (ahead_deg(high) < 0)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        later = ahead_deg(middle) > 0
        low, high = np.where(later, middle, low), np.where(later, high, middle)
    return passed, start_enu_m + low[:, None] * velocity_m_s


def _flights(case: Case) -> ScannedFlights:
    period_ns, n = case.sensor.scan.period_ns, case.sensor.scan.sectors
    sectors = [Timetable(period_ns, n).sector(SOME_SCAN, i) for i in range(n)]
    middle_ns = sectors[0].start_ns + period_ns // 2
    reach_m = case.seen.velocity_ecef_m_s * (2 * period_ns / NS)
    times_ns = [middle_ns - 2 * period_ns, middle_ns + 2 * period_ns]
    trajectories = Trajectories(stale_after_s=1.0)
    for row, (place_m, far_m) in enumerate(zip(case.seen.ecef_m, reach_m, strict=True)):
        knots_m = np.stack([place_m - far_m, place_m + far_m])
        trajectories.add_path(f"drone-{row}", times_ns, knots_m, signature=Signature(rcs_m2=1.0))
    return ScannedFlights(case, trajectories, sectors)


def _passage_errors(
    case: Case, found: Found, passed: Bools, true_enu_m: Floats
) -> dict[str, float]:
    drone, first = np.unique(found[0], return_index=True)
    rows = drone[passed[drone]]
    measured = case.measured(found[1][first][passed[drone]], rows)
    true = case.measured(true_enu_m[rows], rows)
    return {name: rms(wrapped(name, measured[name] - value)) for name, value in true.items()}


def _at_the_end(flights: ScannedFlights) -> Found:
    """All at the end of the scan."""
    return flights.drones, flights.enu_m(flights.start_ns + flights.period_ns)


def _at_sector_ends(flights: ScannedFlights) -> Found:
    """Each at the end of the sector that it was in when the scan began."""
    n = len(flights.sectors)
    index = np.nan_to_num(flights.azimuths_deg(flights.start_ns) * n / 360).astype(np.int64) % n
    ends_ns = np.array([sector.end_ns for sector in flights.sectors])
    return flights.drones, flights.enu_m(ends_ns[index])


def _from_north(flights: ScannedFlights, steps: int) -> Found:
    """Each when the beam is where the drone was a step before, first of all at the scan's start."""
    t_ns = np.full(len(flights.drones), flights.start_ns)
    for _ in range(steps):
        share = np.nan_to_num(flights.azimuths_deg(t_ns)) / 360
        t_ns = flights.start_ns + np.rint(share * flights.period_ns).astype(np.int64)
    return flights.drones, flights.enu_m(t_ns)


def _sector_by_sector(flights: ScannedFlights) -> Found:
    """The engine's search where telemetry comes in between."""
    found, borders = [], Borders(1)
    for sector in flights.sectors:
        one = Sectors.of([sector])
        found.append(meetings(one, flights.case.frame, flights.trajectories, borders).truth)
    return _places(flights, TruthState.joined(found))


def _passages(flights: ScannedFlights) -> Found:
    """The engine's search while nothing new comes in about the drones: a turn at once."""
    met = meetings(Sectors.of(flights.sectors), flights.case.frame, flights.trajectories)
    return _places(flights, met.truth)


def _places(flights: ScannedFlights, truth: TruthState) -> Found:
    return truth.drone, flights.case.frame.from_ecef(truth.position_ecef_m)


def frames_stage(case: Case) -> ChartStage:
    """Range and angles from truth as each method keeps it, geodetic or ECEF."""
    n = min(case.effort.references, len(case.seen))
    true = [case.measured_precisely(row) for row in range(n)]

    def errors(places: Callable[[], Floats]) -> dict[str, float]:
        return _frame_errors(case.measured(places()[:n], np.arange(n)), true)

    return ChartStage.of(
        "frames",
        "How to turn places on Earth into range and angles",
        [
            (name, partial(_to_angles, places), errors(places))
            for name, places in frame_methods(case).items()
        ],
        units=len(case.seen),
        ours=OUR_FRAME,
    )


def _to_angles(places: Callable[[], Floats]) -> object:
    return enu_to_aer(places())


def _frame_errors(measured: dict[str, Floats], true: Sequence[dict[str, Any]]) -> dict[str, float]:
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
        OUR_FRAME: partial(here.from_ecef, ecef_m),
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
    need_extra("pyproj", "the comparison with PROJ", "geoid")
    from pyproj import Transformer

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
