"""The methods of every stage of a chart, some of which exist only to be compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, expit, gammaincc, gammainccinv

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.engine.emulated_sensors import with_heights
from plotfeed.feeds.formats import FORMATS, Batch, Format, MessageFormat
from plotfeed.feeds.formats.sapient.sapient_node import Groups
from plotfeed.feeds.lab import precise
from plotfeed.feeds.lab.charted import (
    FALSE_ALARMS,
    MEASURED,
    PD,
    Case,
    ChartStage,
    ErrorLaw,
    Method,
    PlacesApart,
    Rng,
    Sigmas,
    alarm_moments,
    error_law,
    passive_snrs,
    rms,
    strongest_emissions,
    wrapped,
)
from plotfeed.feeds.lab.precise import number
from plotfeed.feeds.messages.message import Message
from plotfeed.models import detection, propagation
from plotfeed.models.beam import Borders, Sector, Sectors, Timetable, meetings
from plotfeed.models.detection import draw_hits
from plotfeed.models.effects.multipath import Multipath
from plotfeed.models.frames import (
    WGS84_A_M,
    WGS84_E2,
    LocalFrame,
    aer_to_enu,
    enu_to_aer,
    geodetic_to_ecef,
    wrap_180,
)
from plotfeed.models.joined_sets import OUTSIDE
from plotfeed.models.sensors.acoustic import REFERENCE_DISTANCE_M, MicrophoneArray
from plotfeed.models.sensors.active_radar import ActiveRadar, MimoRadar
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.rf import RfDirectionFinder, emissions_of
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Bools, Floats, Ints, Plots, Signature, TruthState
from plotfeed.models.truth import Trajectories
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.utc import NS

TABLE_DB = np.linspace(-60.0, 120.0, 1441)
"""Eight nodes a decibel."""
Singles = NDArray[np.float32]
Hits = Callable[[Rng], Bools]


def table(pd_of_db: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:
    """Pd by linear interpolation over the ratio in dB; made once, (n,) in and out."""
    nodes = pd_of_db(TABLE_DB)
    return lambda snr_db: np.asarray(np.interp(snr_db, TABLE_DB, nodes))


def single_cfar_swerling1(snr: Singles, pfa: float, n_reference: int) -> Singles:
    """Equation 7 in float32."""
    alpha = np.float32(np.expm1(-np.log(pfa) / n_reference))
    mean = 1 + snr
    return np.asarray((mean / (mean + alpha)) ** np.float32(n_reference))


def single_sum_cfar(snrs: Singles, pfa: float, n_reference_total: int) -> Singles:
    """The chain of looks and samples in float32."""
    ratio = detection.threshold_noncoherent_cfar(pfa, snrs.shape[-1], n_reference_total)
    chain: Any = detection.outlasting
    return np.asarray(chain(snrs, np.float32(ratio), n_reference_total))


def single_energy(snr: Singles, pfa: float, n_samples: int) -> Singles:
    """The energy detector in float32."""
    threshold = np.float32(gammainccinv(n_samples, pfa))
    return np.asarray(gammaincc(np.float32(n_samples), threshold / (1 + snr)))


def single_logistic(snr_db: Singles, sensitivity_db: float, slope_per_db: float) -> Singles:
    """Equation 43 in float32."""
    return np.asarray(expit(np.float32(slope_per_db) * (snr_db - np.float32(sensitivity_db))))


def printed_cfar_swerling1(snr: Floats, pfa: float, n_reference: int) -> Floats:
    """Equations 6 and 7, as printed."""
    alpha = pfa ** (-1 / n_reference) - 1
    return np.asarray((1 + alpha / (1 + snr)) ** -n_reference)


def printed_sum(snrs: Floats, pfa: float) -> Floats:
    """Equations 18, 22 and 23 as printed: the mean ratio, its half, and known noise."""
    n_looks = snrs.shape[-1]
    threshold = gammainccinv(n_looks, pfa)
    return np.asarray(gammaincc(n_looks, threshold / (1 + snrs.mean(axis=-1) / 2)))


@np.errstate(over="ignore")
def printed_logistic(snr_db: Floats, sensitivity_db: float) -> Floats:
    """Equation 43 as printed, by ratio and sensitivity in dB."""
    return np.asarray(1 / (1 + np.exp(-snr_db - sensitivity_db)))


def signal_cfar(snrs: Floats, pfa: float, n_reference_total: int, rng: Rng) -> Bools:
    """Hits of looks made as signals: complex Gaussian cells, target and reference; (n, K) to (n,).

    Right in law: it is what the closed forms are the integrals of.
    """
    n, n_looks = snrs.shape
    ratio = detection.threshold_noncoherent_cfar(pfa, n_looks, n_reference_total)
    target = (1 + snrs) * (rng.standard_normal((n, n_looks, 2)) ** 2).sum(axis=-1)
    reference = (rng.standard_normal((n, n_reference_total, 2)) ** 2).sum(axis=(1, 2))
    return np.asarray(target.sum(axis=-1) > ratio * reference)


def signal_energy(snr: Floats, pfa: float, n_samples: int, rng: Rng) -> Bools:
    """Hits of an energy detector whose samples are drawn one by one; (n,)."""
    threshold = gammainccinv(n_samples, pfa)
    energy = [(rng.standard_normal(2 * n_samples) ** 2).sum() / 2 for _ in range(len(snr))]
    return np.asarray((1 + snr) * np.array(energy) > threshold)


def counted(hits: Hits, trials: int) -> Callable[[Rng], Floats]:
    """Pd by counting so many trials of hits; (n,)."""

    def pd(rng: Rng) -> Floats:
        total = hits(rng).astype(np.float64)
        for _ in range(trials - 1):
            total += hits(rng)
        return total / trials

    return pd


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


GATE = "range gate"
FREE_SPACE = "free space"
TWO_RAYS = "two rays, flat ground"
REFLECTION = -0.9
"""Of a ground that no scene describes: nearly all, and turned over, as at grazing incidence."""
LOWEST_ANTENNA_M = 1.5
"""Above that ground."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PropagationMethods:
    """Ratios by method, and Pd by them, (n,); `ours` is what the scene asks for."""

    ratios: dict[str, Callable[[], Floats]]
    pds: dict[str, Callable[[], Floats]]
    ours: str


def propagation_stage(case: Case) -> ChartStage | None:
    """The errors are differences in Pd from what the scene asks for: what others would change.

    None for a sensor that asks for no more than a gate.
    """
    antenna_m = case.sensor.position_enu_m[2]
    timed = propagation_methods(case.model, case.seen_targets(), antenna_m)
    judged = propagation_methods(case.model, case.anywhere_targets(), antenna_m)
    if timed is None or judged is None:
        return None
    share = case.model.pd_factor
    true = judged.pds[judged.ours]() * share
    places_m = case.seen_targets().position_enu_m
    gate = Method(
        name=GATE,
        run=partial(_within, places_m, case.sensor.range_max_m),
        units=len(case.seen),
        errors={PD: rms(1 - true)},
        gives_ratio=False,
    )
    others = [
        Method(
            name=name,
            run=run,
            units=len(case.seen),
            errors={PD: rms(judged.pds[name]() * share - true)},
            ours=name == timed.ours,
        )
        for name, run in timed.ratios.items()
    ]
    return ChartStage(
        name="propagation", question="How strong a signal arrives", methods=(gate, *others)
    )


def _within(places_m: Floats, range_max_m: float) -> object:
    """Whoever is near enough."""
    return np.einsum("ij,ij->i", places_m, places_m) <= range_max_m**2


@singledispatch
def propagation_methods(
    model: SensorModel, targets: Targets, antenna_m: float
) -> PropagationMethods | None:
    """Methods for a sensor whose antenna is so high above the site.

    One that is known by no more than what it predicts has them if its model knows of a ground.
    """
    if not hasattr(model, "multipath"):
        return None
    return _over_ground(
        model,
        antenna_m,
        lambda sensor: sensor.predict(targets).snr,
        lambda sensor: replace(sensor, degradation=None).predict(targets).pd,
    )


@propagation_methods.register
def _(model: PolarRadar, targets: Targets, antenna_m: float) -> PropagationMethods:
    return _over_ground(
        model,
        antenna_m,
        lambda sensor: sensor.look_snrs(targets),
        lambda sensor: sensor.pd(sensor.look_snrs(targets), sensor.orders(targets)),
    )


@propagation_methods.register
def _(model: PassiveRadar, targets: Targets, antenna_m: float) -> PropagationMethods:
    return _over_ground(
        model,
        antenna_m,
        lambda sensor: passive_snrs(sensor, targets),
        lambda sensor: sensor.pd(passive_snrs(sensor, targets).max(axis=1), sensor.orders(targets)),
    )


@propagation_methods.register
def _(model: RfDirectionFinder, targets: Targets, antenna_m: float) -> PropagationMethods:
    emissions = emissions_of(targets)

    def ratios(sensor: RfDirectionFinder) -> Floats:
        return sensor.received_snr(emissions, targets, enu_to_aer(targets.position_enu_m)[2])

    def pd(sensor: RfDirectionFinder) -> Floats:
        missed = np.ones(len(targets))
        detected = np.nan_to_num(sensor.pd(emissions, ratios(sensor)))
        np.multiply.at(missed, emissions.target, 1 - detected)
        return 1 - missed

    plain = FREE_SPACE if model.path_loss_exponent == 2 else "log-distance"
    return _over_ground(model, antenna_m, ratios, pd, plain)


@propagation_methods.register
def _(model: MicrophoneArray, targets: Targets, _antenna_m: float) -> PropagationMethods:
    place_enu_m, power_level_db = targets.position_enu_m, targets.sound_power_db()

    def in_the_open() -> Floats:
        range_m = np.maximum(enu_to_aer(place_enu_m)[2], REFERENCE_DISTANCE_M)
        lost_db = propagation.sound_divergence_db(range_m) + model.absorption_db_per_m * range_m
        level_db = propagation.sound_level_db(power_level_db, model.directivity_db, lost_db)
        return level_db + model.array_gain_db - model.noise_db

    def all_in_all() -> Floats:
        return model.snr_db(power_level_db, place_enu_m)

    ours = "air, ground and barriers"
    ratios = {"spreading and air": in_the_open, ours: all_in_all}
    pds = {
        "spreading and air": lambda: model.pd(in_the_open()),
        ours: lambda: model.pd(all_in_all()),
    }
    return PropagationMethods(ratios=ratios, pds=pds, ours=ours)


@propagation_methods.register
def _(model: PlacesApart, targets: Targets, antenna_m: float) -> PropagationMethods:
    place_m, rcs_m2 = targets.true_position_enu_m, targets.rcs_m2()
    return _over_ground(
        model,
        antenna_m,
        lambda radar: radar.odds(place_m, rcs_m2)[0],
        lambda radar: radar.place_pd(radar.odds(place_m, rcs_m2)[1]),
    )


def _over_ground(
    model: Any,
    antenna_m: float,
    ratios: Callable[[Any], Floats],
    pd: Callable[[Any], Floats],
    plain: str = FREE_SPACE,
) -> PropagationMethods:
    """Methods without a ground and over one, that of the scene if it names one."""
    high_m = max(antenna_m, LOWEST_ANTENNA_M)
    ground = model.multipath or Multipath(reflection=REFLECTION, antenna_height_m=high_m)
    sensors = {plain: _over(model, None), TWO_RAYS: _over(model, ground)}
    return PropagationMethods(
        ratios={name: partial(ratios, sensor) for name, sensor in sensors.items()},
        pds={name: partial(pd, sensor) for name, sensor in sensors.items()},
        ours=plain if model.multipath is None else TWO_RAYS,
    )


def _over(model: Any, ground: Multipath | None) -> Any:
    """A sensor over that ground, all of its receivers too."""
    if isinstance(model, PlacesApart):
        return model.over(ground)
    return replace(model, multipath=ground)


OURS = "closed form"
MOST_NUMBERS = 1 << 20
"""That one call of a Monte Carlo may draw."""
MOST_SAMPLES = 1 << 21
"""Signals of more samples a look are not drawn sample by sample."""
AnyFloats = NDArray[np.floating[Any]]
"""Of whatever precision."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionLaw:
    """Pd of some looks by several methods, (n,) each, ours among them; and of one look exactly.

    `hits` draws what a receiver would decide, signal by signal, in `signals` numbers a look; None
    where there is no signal behind the law.
    """

    ours: Callable[[], Floats]
    exact: Callable[[int], Any]
    others: Mapping[str, Callable[[], AnyFloats]] = field(default_factory=dict)
    hits: Hits | None = None
    signals: int = 0


def detection_stage(case: Case) -> ChartStage | None:
    """Pd and a draw by it, or signals and a threshold; None for a sensor that always detects."""
    law = detection_law(case.model, case.seen_targets())
    judged = detection_law(case.model, case.anywhere_targets(case.effort.references))
    if law is None or judged is None:
        return None
    n = min(case.effort.references, len(case.anywhere))
    exact = np.array([float(judged.exact(row)) for row in range(n)])
    found = [_by_pd(OURS, law.ours, _error(judged.ours(), exact), case, ours=True)]
    for name, pd in law.others.items():
        found.append(_by_pd(name, pd, _error(judged.others[name](), exact), case))
    everyone = Method(
        name="every target",
        run=lambda: None,
        units=len(case.seen),
        errors={PD: rms(1 - case.pd_anywhere)},
    )
    return ChartStage(
        name="detection",
        question="How to decide what is detected",
        methods=(*found, *_by_signals(case, judged.signals, exact), everyone),
    )


def _error(pd: AnyFloats, exact: Floats) -> dict[str, float]:
    return {PD: rms(np.asarray(pd, dtype=np.float64) - exact)}


def _by_pd(
    name: str,
    pd: Callable[[], AnyFloats],
    errors: dict[str, float],
    case: Case,
    *,
    ours: bool = False,
) -> Method:
    rng = case.rng
    return Method(
        name=name,
        run=lambda: draw_hits(pd(), rng),
        units=len(case.seen),
        errors=errors,
        ours=ours,
        needs_ratio=True,
    )


def _by_signals(case: Case, signals: int, exact: Floats) -> Iterator[Method]:
    """One trial that decides, right in law; and a Pd counted over many, if there is time for it."""
    hits, few = _hits(case, case.seen_targets, signals)
    if hits is not None:
        yield Method(
            name="signals, one trial",
            run=partial(hits, case.rng),
            units=few,
            errors={PD: 0.0},
            needs_ratio=True,
        )
    trials = case.effort.trials
    hits, few = _hits(case, case.seen_targets, signals * trials)
    judged, rows = _hits(case, case.anywhere_targets, signals * trials // 4)
    if hits is None or judged is None:
        return
    estimated, rng, pd = counted(judged, trials)(case.rng), case.rng, counted(hits, trials)
    yield Method(
        name=f"signals, {trials} trials",
        run=lambda: draw_hits(pd(rng), rng),
        units=few,
        errors=_error(estimated, exact[:rows]),
        needs_ratio=True,
    )


def _hits(case: Case, targets: Callable[[int], Targets], numbers: int) -> tuple[Hits | None, int]:
    """A draw of hits for so few targets that a call lasts no longer than a moment, and how few."""
    few = min(MOST_NUMBERS // max(numbers, 1), case.effort.references)
    some = targets(few)
    law = detection_law(case.model, some) if few else None
    return (law.hits, len(some)) if law is not None else (None, 0)


def detection_law(model: SensorModel, targets: Targets) -> DetectionLaw | None:
    """How a sensor decides; None if it detects all of those targets."""
    if model.degradation is None:
        return _law_of_kind(model, targets)
    share, plain = model.pd_factor, replace(model, degradation=None)
    law = _law_of_kind(plain, targets)
    if law is None:
        law = DetectionLaw(ours=lambda: plain.predict(targets).pd, exact=lambda _: 1.0)
    ours, hits = law.ours, law.hits

    def left_of(pd: Callable[[], AnyFloats]) -> Callable[[], AnyFloats]:
        return lambda: pd() * share

    return DetectionLaw(
        ours=lambda: ours() * share,
        exact=lambda row: law.exact(row) * share,
        others={name: left_of(pd) for name, pd in law.others.items()},
        hits=None if hits is None else lambda rng: hits(rng) & (rng.random(len(targets)) < share),
        signals=law.signals,
    )


@singledispatch
def _law_of_kind(model: SensorModel, targets: Targets) -> DetectionLaw | None:
    """How a kind of sensor decides; of one that is not known here, what it predicts is its law.

    None if it detects all of those targets.
    """
    return _predicted_law(model, targets)


def _predicted_law(model: SensorModel, targets: Targets) -> DetectionLaw | None:
    pd = model.predict(targets).pd
    if (pd == 1).all():
        return None
    return DetectionLaw(ours=lambda: model.predict(targets).pd, exact=lambda row: pd[row])


@_law_of_kind.register
def _(model: ActiveRadar, targets: Targets) -> DetectionLaw | None:
    if targets.signatures.echoes is not None or model.intervals is not None:
        return _predicted_law(model, targets)
    snr = model.look_snrs(targets)[:, 0]
    return _swerling1(lambda: model.pd(snr[:, None]), snr, model.pfa, model.n_reference)


@_law_of_kind.register
def _(model: PassiveRadar, targets: Targets) -> DetectionLaw | None:
    if targets.signatures.echoes is not None:  # by a series of its own
        return _predicted_law(model, targets)
    snr = passive_snrs(model, targets).max(axis=1)
    return _swerling1(lambda: model.pd(snr), snr, model.pfa, model.n_reference)


def _swerling1(
    ours: Callable[[], Floats], snr: Floats, pfa: float, n_reference: int
) -> DetectionLaw:
    """One look at one fluctuating target, against the mean of its neighbour cells."""
    cells = (pfa, n_reference)
    looked_up = table(lambda db: detection.pd_cfar_swerling1(10 ** (db / 10), *cells))
    singles = snr.astype(np.float32)
    return DetectionLaw(
        ours=ours,
        others={
            "table": lambda: looked_up(10 * np.log10(snr)),
            "closed form, float32": lambda: single_cfar_swerling1(singles, *cells),
            "as printed, eq 6, 7": lambda: printed_cfar_swerling1(snr, *cells),
        },
        hits=partial(signal_cfar, snr[:, None], *cells),
        signals=2 * (n_reference + 1),
        exact=lambda row: precise.pd_cfar_swerling1(float(snr[row]), *cells),
    )


@_law_of_kind.register
def _(model: MimoRadar, targets: Targets) -> DetectionLaw | None:
    if targets.signatures.echoes is not None or model.intervals is not None:
        return _predicted_law(model, targets)
    snrs = model.look_snrs(targets)
    pfa, n = model.pfa, model.n_reference_total
    singles = snrs.astype(np.float32)
    looked_up = table(
        lambda db: detection.pd_noncoherent_cfar(10 ** (db / 10), pfa, snrs.shape[1], n)
    )
    return DetectionLaw(
        ours=lambda: model.pd(snrs),
        others={
            "table by the mean ratio": lambda: looked_up(10 * np.log10(snrs.mean(axis=1))),
            "closed form, float32": lambda: single_sum_cfar(singles, pfa, n),
            "as printed, eq 18, 23": lambda: printed_sum(snrs, pfa),
        },
        hits=partial(signal_cfar, snrs, pfa, n),
        signals=2 * (n + snrs.shape[1]),
        exact=lambda row: precise.pd_sum_cfar(snrs[row].tolist(), pfa, n),
    )


@_law_of_kind.register
def _(model: MicrophoneArray, targets: Targets) -> DetectionLaw:
    snr_db = model.snr_db(targets.sound_power_db(), targets.position_enu_m)
    curve = (model.sensitivity_db, model.slope_per_db)
    looked_up = table(lambda db: detection.pd_logistic(db, *curve))
    singles = snr_db.astype(np.float32)
    return DetectionLaw(
        ours=lambda: model.pd(snr_db),
        others={
            "table": lambda: looked_up(snr_db),
            "closed form, float32": lambda: single_logistic(singles, *curve),
            "as printed, eq 43": lambda: printed_logistic(snr_db, curve[0]),
        },
        exact=lambda row: precise.pd_logistic(float(snr_db[row]), *curve),
    )


@_law_of_kind.register
def _(model: RfDirectionFinder, targets: Targets) -> DetectionLaw:
    emissions, snr = strongest_emissions(model, targets)
    pfa, n = model.pfa, model.samples
    met = model.intercept_probability(emissions.frequency_hz, emissions.bandwidth_hz)
    looked_up = table(lambda db: detection.pd_noncoherent_swerling2(10 ** (db / 10), pfa, n))
    singles = snr.astype(np.float32)

    def hits(rng: Rng) -> Bools:
        return draw_hits(met, rng) & signal_energy(snr, pfa, n, rng)

    return DetectionLaw(
        ours=lambda: model.pd(emissions, snr),
        others={
            "table": lambda: met * looked_up(10 * np.log10(snr)),
            "closed form, float32": lambda: met * single_energy(singles, pfa, n),
        },
        hits=hits if 2 * n <= MOST_SAMPLES else None,
        signals=2 * n,
        exact=lambda row: float(met[row]) * precise.pd_energy(float(snr[row]), pfa, n),
    )


@_law_of_kind.register
def _(model: PlacesApart, targets: Targets) -> DetectionLaw:
    place_m, n, fewest = targets.true_position_enu_m, len(targets), model.fewest_pairs
    snrs, _ = model.odds(place_m, targets.rcs_m2())
    signals = [model.receivers[m].signals for m, _ in model.pairs]
    left = np.array([each.pd_factor for each in signals])
    pfa, n_reference = signals[0].pfa, signals[0].n_reference

    def alike() -> Floats:
        pd = detection.pd_cfar_swerling1(snrs.mean(axis=1), pfa, n_reference) * left[0]
        return np.asarray(bdtrc(fewest - 1, len(signals), pd) * (1 - OUTSIDE))

    def hits(rng: Rng) -> Bools:
        found = [
            signal_cfar(snrs[:, [p]], pfa, n_reference, rng) & (rng.random(n) < left[p])
            for p in range(len(signals))
        ]
        return np.asarray((np.sum(found, axis=0) >= fewest) & (rng.random(n) >= OUTSIDE))

    def exact(row: int) -> Any:
        each = [precise.pd_cfar_swerling1(float(snr), pfa, n_reference) for snr in snrs[row]]
        enough = precise.at_least([p * float(f) for p, f in zip(each, left, strict=True)], fewest)
        return enough * (1 - precise.number(OUTSIDE))

    return DetectionLaw(
        ours=lambda: model.place_pd(model.odds_of(snrs)),
        others={"as if pairs were alike": alike},
        hits=hits,
        signals=2 * (n_reference + 1) * len(signals),
        exact=exact,
    )


FLUCTUATING, STEADY = "exact draw, given the hit", "by the level"
FLOOR_ONLY = "floor only"
OUR_ALARMS = "binomial over cells"
STEP_S = 1e-3
"""Over which rates of change are taken."""


def errors_stage(case: Case) -> ChartStage | None:
    """Ratios of detections, sigmas and noise; None for a sensor whose errors are always alike."""
    law = error_law(case.model, case.seen_targets())
    if law is None:
        return None
    true = law.sigmas(1 / law.inverse)
    found: dict[str, tuple[Sigmas, Callable[[Rng], Floats]]] = {}
    if law.draw is not None:
        found[FLUCTUATING] = law.sigmas, law.draw
    found[STEADY if law.draw is None else "by the mean ratio"] = law.sigmas, lambda _: law.mean_snr
    if law.printed is not None:
        found["mean ratio, as printed"] = law.printed, lambda _: law.mean_snr
    strong = np.full(len(law.mean_snr), np.inf)
    found[FLOOR_ONLY] = law.sigmas, lambda _: strong
    return ChartStage.of(
        "errors",
        "How to draw the errors of measurements",
        [
            (
                name,
                partial(_noise, sigmas, ratios, case.rng),
                _missing(sigmas(_effective(name, law, strong)), true),
            )
            for name, (sigmas, ratios) in found.items()
        ],
        units=len(case.seen),
        ours=next(iter(found)),
        need_ratio=found.keys() - {FLOOR_ONLY},
    )


def _effective(name: str, law: ErrorLaw, strong: Floats) -> Floats:
    """The ratio that gives the rms errors of a method, over many detections of each target."""
    if name == FLUCTUATING:
        return 1 / law.inverse  # right in law
    return strong if name == FLOOR_ONLY else law.mean_snr


def _missing(sigmas: Mapping[str, Floats], true: Mapping[str, Floats]) -> dict[str, float]:
    """What, in quadrature, makes the true rms errors of those of a method, or the reverse."""
    return {
        name: float(np.sqrt(np.mean(np.abs(sigmas[name] ** 2 - value**2))))
        for name, value in true.items()
    }


def _noise(sigmas: Sigmas, ratios: Callable[[Rng], Floats], rng: Rng) -> object:
    """The errors of one look at each target, by quantity."""
    return [sigma * rng.standard_normal(len(sigma)) for sigma in sigmas(ratios(rng)).values()]


class PoissonGenerator(np.random.Generator):
    """Draws Poisson numbers where it is asked for binomial ones."""

    def binomial(self, n: Any, p: Any, size: Any = None) -> Any:
        """Poisson, of the same mean."""
        return self.poisson(np.multiply(n, p), size)


def false_alarms_stage(case: Case) -> ChartStage | None:
    """A whole scan's, shared between the targets at once; None for a sensor without any."""
    mean, variance = alarm_moments(case.model)
    if mean == 0 or FALSE_ALARMS not in case.own:
        return None
    excess = float(np.sqrt(mean - variance))  # of the Poisson number over the binomial one
    scan = case.sensor.scan
    turn = replace(Timetable(scan.period_ns, 1).sector(SOME_SCAN, 0), stares=not scan.rotates)
    draw, poisson = case.model.draw_false_alarms, PoissonGenerator(np.random.Philox(case.seed))
    return ChartStage.of(
        "false alarms",
        "How to draw false alarms",
        [
            ("off", lambda: None, {FALSE_ALARMS: mean}),
            ("Poisson", partial(draw, turn, poisson), {FALSE_ALARMS: excess}),
            (OUR_ALARMS, partial(draw, turn, case.rng), {FALSE_ALARMS: 0.0}),
        ],
        units=len(case.seen),
        ours=OUR_ALARMS,
    )


def encoding_stage(case: Case) -> ChartStage | None:
    """Every format that such a sensor can report in, and that is installed."""
    seen = _seen(case)
    sent = seen.plots
    if not len(sent):
        return None
    found = []
    for name in formats_of(case):
        try:
            messages = _messages(FORMATS[name].maker(case.scene, {0: case.sensor}), seen)
        except PlotfeedError:  # an extra is missing, or the sensor measures too little for it
            continue
        read = _read_back(FORMATS[name], messages, int(seen.sectors.start_ns[0]))
        found.append(
            Method(
                name=name,
                run=partial(_messages, FORMATS[name].maker(case.scene, {0: case.sensor}), seen),
                units=len(sent),
                errors=_encoding_errors(case, sent, read),
                ours=name in case.sensor.report,
            )
        )
    return ChartStage(
        name="encoding",
        question="How to write plots down",
        methods=tuple(found),
    )


def formats_of(case: Case) -> list[str]:
    """The formats of plots that the scene could ask of such a sensor."""
    return [name for name in case.sensor.formats if not FORMATS[name].facts.tells_tracks]


def _messages(maker: MessageFormat, batch: Batch) -> list[Message]:
    return [message for messages in maker.messages(batch) for message in messages]


def _read_back(row: Format, messages: Sequence[Message], near_ns: int) -> MeasuredPlots:
    """The plots in all of those messages."""
    if row.plots_in is None:
        return MeasuredPlots.of(())
    return MeasuredPlots.joined([row.plots_in(message.payload, near_ns) for message in messages])


def _seen(case: Case) -> Batch:
    """One detection of each seen target where that is to be had, spread over a few sectors."""
    targets, rng = case.seen_targets(), case.rng
    _, plots = case.model.observe(targets, rng)
    sectors = _group(case)
    start_ns, end_ns = sectors[0].start_ns, sectors[-1].end_ns
    if len(sectors) > 1:
        t_ns = np.sort(rng.integers(start_ns, end_ns, len(plots)))
    else:
        t_ns = np.full(len(plots), end_ns, np.int64)  # a sensor that stares reports when it ends
    plots = with_heights(plots.but(t_utc_ns=t_ns), case.frame)
    index = np.searchsorted([s.end_ns for s in sectors[:-1]], t_ns, side="right")
    plots_by = np.searchsorted(index, np.arange(len(sectors) + 1))
    return Batch(Sectors.of(sectors), plots, plots_by)


def _group(case: Case) -> list[Sector]:
    """The sectors that SAPIENT keeps together, so that its messages leave within them."""
    period_ns, n = case.sensor.scan.period_ns, case.sensor.scan.sectors
    size = Groups(period_ns, n).size
    sectors = [Timetable(period_ns, n).sector(size * SOME_SCAN, 0)]
    while len(sectors) < size:
        sectors.append(Timetable(period_ns, n).next_sector(sectors[-1]))
    return sectors


def _encoding_errors(case: Case, sent: Plots, read: MeasuredPlots) -> dict[str, float]:
    """Errors of what is read, for where the target was at the time that is read beside it."""
    late_s = (read.t_utc_ns - sent.t_utc_ns).astype(np.float64) / NS
    rates = _rates(case, sent)
    errors = {}
    for name in MEASURED:
        if name not in case.own:
            continue
        found = _read(case, name, sent, read)
        if found is not None:
            difference = found - getattr(sent, name) - rates[name] * late_s
            errors[name] = rms(wrapped(name, difference))
    return errors


def _read(case: Case, name: str, sent: Plots, read: MeasuredPlots) -> Floats | None:
    """What is read of a quantity; None if the format has nothing to read it from."""
    found: Floats = getattr(read, name)
    if name == "elevation_deg" and np.isnan(found).all() and not np.isnan(read.altitude_m).all():
        there_enu_m = aer_to_enu(sent.azimuth_deg, sent.elevation_deg, sent.range_m)
        there = case.frame.to_geodetic(there_enu_m)[:2]
        undulation_m = case.scene.sea_level().undulation_m(*there)
        higher_m = read.altitude_m + undulation_m - sent.height_m
        level_m = sent.range_m * np.cos(np.radians(sent.elevation_deg))
        return np.asarray(sent.elevation_deg + np.degrees(higher_m / level_m))
    return None if np.isnan(found).all() else found


def _rates(case: Case, sent: Plots) -> dict[str, Floats]:
    """How fast what is measured of each plot's target changes, a second."""
    enu_m = case.seen_targets().position_enu_m
    before, after = case.measured(enu_m), case.measured(enu_m + STEP_S * case.velocity_enu_m_s)
    return {
        name: wrapped(name, after[name] - value)[sent.drone] / STEP_S
        for name, value in before.items()
    }
