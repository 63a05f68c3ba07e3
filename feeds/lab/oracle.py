"""What a scene asks of its sensors, worked out a second time and apart from what a session runs.

Of looks at targets whose true places are known: the mean ratio, the probability of detection and
the rms errors of what is measured, as the scene's keys and the textbooks give them; of a scan, how
many false alarms come. Formulas are those of the paper in their right form (docs/equations.md), its
numbers (eq) beside them. Nothing here is shared with the models of a session, so that a fault in
one of these shows as a difference. What is not known here is said to be so, look by look.

Angles are degrees, azimuths clockwise from true north; places are metres east, north and up of the
sensor's antenna; powers linear where no name says dB.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from itertools import product
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, special, stats

from plotfeed.feeds.recording.recorded_horizons import FURTHER_M, STEP, read_horizons
from plotfeed.feeds.scene.fields import Location, Site
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.world_keys import HORIZONS

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

LIGHT_M_S = 299_792_458.0
BOLTZMANN_J_K = 1.380649e-23
ROOM_K = 290.0
# WGS-84: semi-major axis and the square of the first eccentricity.
EARTH_M, ECCENTRICITY2 = 6_378_137.0, 6.694379990141317e-3
# No antenna's far field is nearer, and sound spreads from there on (ISO 9613-2, 7.1).
NEAREST_M = 1.0
# A half-wave dipole over an isotropic antenna, by which a broadcast's power is stated.
DIPOLE_DB = 2.15
ONE_WIDTH_DB = 40 * np.log10(2)  # Loss of a Gaussian beam one 3 dB width off its axis, one way
STEADY = np.inf
# Terms of the series of a fluctuating target, and what is left of it that counts.
# Share of a beam that a track may lag, and what is left open of Pd that is worked out by its aim.
LAGS, OF_AIM = 0.15, 0.01
CONFIRMATION = 1  # The channel of looks that confirm what a steered beam's search, 0, has found
MOST_TERMS, LEAST, AT_ONCE = 20_000, 1e-11, 1024
# Widths of resolution beyond which two targets make one plot less often than once in 4,000 times.
APART = 3.5
# Of places by several receivers: ratios that are drawn, steps to a place, 1/m^2 of what is not
# known, and the share of right sets that a gate leaves out, and may where errors are judged.
DRAWN, STEPS, NOTHING = 24, 8, 1e-12
THREE_SIGMAS, MOST_REFUSED = 0.0027, 0.02
# Sensors of which it is known how the places err that several detections make.
JOINED = frozenset({"multistatic_mimo", "multistatic_passive"})


@dataclass(frozen=True, kw_only=True)
class TargetSignature:
    """What there is of a target to sense; NaN and () for what it lacks."""

    rcs_m2: float = np.nan
    sound_power_db: float = np.nan
    size_m: float = np.nan
    emitters: tuple[Any, ...] = ()
    swerling: int | None = None
    aspect: Any = None


@dataclass(frozen=True, kw_only=True)
class LooksGiven:
    """Looks of one sensor at targets, (n,), as a ledger has them: where each truly was, sensed.

    `drone` are names, those of what is no drone ("bird/ID-1") among them. All looks of the sensor
    belong here, as echoes of targets side by side merge. Of velocities, (n, 3), rows of NaN are not
    known; without any they follow from a target's looks before and after. `field_deg` are the
    fields of view of a camera that zooms, NaN where not known. Of places that several detections
    make it is only known how they err where `detected` says which looks were some.
    """

    t_utc_ns: Ints
    azimuth_deg: Floats
    elevation_deg: Floats
    range_m: Floats
    drone: NDArray[np.object_]
    channel: Ints
    velocity_enu_m_s: Floats | None = None
    emitted_utc_ns: Ints | None = None
    field_deg: Floats | None = None
    detected: Bools | None = None

    def __len__(self) -> int:
        return len(self.t_utc_ns)


@dataclass(frozen=True)
class JoinedErrors:
    """How places err that all detections of a target at one time make, a row a look, (n, ..., 4).

    Of range, azimuth, elevation and height, metres and degrees: `law` has the systematic error, and
    the variance and the kurtosis about that, and `stated` are the standard deviations that plots
    state; NaN where these are not known.
    """

    law: Floats
    stated: Floats


@dataclass(frozen=True)
class Asked:
    """What looks were to be, (n,); NaN for what the sensor does not measure, or is not known.

    `pd` is over all that is drawn anew (fluctuation, bursts); sigmas are rms errors of plots about
    what a sensor that stands askew or drifts reads, of a passive radar `sigma_range_m` of the
    bistatic range. `snr_db` is the mean ratio. Where not `known`, an effect is in force of which
    `why_not` tells, and the look is not to be judged; by `pd_off` Pd may be off where it is known
    but roughly.
    """

    pd: Floats
    sigma_range_m: Floats
    sigma_azimuth_deg: Floats
    sigma_elevation_deg: Floats
    sigma_range_rate_m_s: Floats
    snr_db: Floats
    known: Bools
    pd_off: Floats
    why_not: str = ""
    joined: JoinedErrors | None = None


TURNED = "how fast a target was while it turned, or when it was seen once"
SIGMAS = ("sigma_range_m", "sigma_azimuth_deg", "sigma_elevation_deg", "sigma_range_rate_m_s")


def asked(scene: Scene, sensor: Sensor, looks: LooksGiven) -> Asked:
    """What a scene asks of a sensor as it was then, of those looks."""
    if looks.velocity_enu_m_s is not None or not _needs_velocities(scene, sensor):
        return _asked(scene, sensor, looks)
    before, after = _velocities(looks, sensor.scan.period_s)
    ways = (before, after, (before + after) / 2)
    first, last, middle = (_asked(scene, sensor, replace(looks, velocity_enu_m_s=v)) for v in ways)
    steady = np.abs(first.pd - last.pd) <= 0.01 * np.maximum(middle.pd, 0.1)
    steady &= np.isfinite(ways[2]).all(axis=1)  # else it was seen once
    if (steady | ~middle.known).all():
        return middle
    why = [middle.why_not] * bool(middle.why_not) + [TURNED]
    return replace(middle, known=middle.known & steady, why_not="; ".join(why))


def _asked(scene: Scene, sensor: Sensor, looks: LooksGiven) -> Asked:
    look = _Look(scene, sensor, looks)
    found: dict[str, Any] = {n: np.full(len(looks), np.nan) for n in ("pd", "snr_db", *SIGMAS)}
    found["pd_off"] = np.zeros(len(looks))
    if sensor.type in KINDS:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
            found |= KINDS[sensor.type](look)
    else:
        look.doubt(f"sensors of type {sensor.type}")
    worse = sensor.degradation
    if worse is not None:
        found["pd"] = found["pd"] * worse.pd_factor
        found |= {name: found[name] * worse.error_factor for name in SIGMAS}
    look.doubt("what a target is, or how fast it flies", look.known & ~np.isfinite(found["pd"]))
    return Asked(**found, known=look.known, why_not="; ".join(look.doubts))


def stated_sigmas(sensor: Any, snr: Floats, channel: Ints) -> dict[str, Floats]:
    """What plots of a radar state of their errors, each by its own ratio, linear; (n,) each.

    Eqs 13 to 15 in right form, and floors in quadrature: shares of cells and beams unless stated.
    """
    noise, passive = 1 / np.sqrt(2 * snr), _is_passive(sensor)
    cell_m = _range_cells_m(sensor)[channel if passive else 0 * channel]
    stated_m = sensor.bistatic_range_floor_m if passive else sensor.range_floor_m
    found = {"sigma_range_m": np.hypot(noise * cell_m / 1.63, _or(stated_m, cell_m / 20))}
    for angle in ("azimuth", *["elevation"] * getattr(sensor, "measures_elevation", False)):
        beam_deg = getattr(sensor, f"{angle}_beamwidth_deg")
        floor_deg = _or(getattr(sensor, f"{angle}_floor_deg"), beam_deg / 10)
        found[f"sigma_{angle}_deg"] = np.hypot(noise * beam_deg / 1.6, floor_deg)
    if sensor.doppler is not None:
        cell = _rate_cells_m_s(sensor)[channel if passive else 0 * channel]
        floor = _or(sensor.doppler.floor_m_s, cell / 20)
        found["sigma_range_rate_m_s"] = np.hypot(noise * cell * np.sqrt(3) / np.pi, floor)
    return found


def _or(stated: Any, usual: Any) -> Any:
    return usual if stated is None else stated


# Places on the Earth.


def ecef(latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: ArrayLike) -> Floats:
    """Earth-centred places, (..., 3), of WGS-84 latitude, longitude and ellipsoidal height."""
    lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
    height = np.asarray(height_m, np.float64)
    across_m = EARTH_M / np.sqrt(1 - ECCENTRICITY2 * np.sin(lat) ** 2)
    out = (across_m + height) * np.cos(lat)
    along = (across_m * (1 - ECCENTRICITY2) + height) * np.sin(lat)
    return np.stack(np.broadcast_arrays(out * np.cos(lon), out * np.sin(lon), along), axis=-1)


def geodetic(place_m: Floats) -> tuple[float, float, float]:
    """Latitude, longitude and height of one Earth-centred place, by iteration."""
    x, y, z = place_m.tolist()
    out = np.hypot(x, y)
    lat = np.arctan2(z, out * (1 - ECCENTRICITY2))
    for _ in range(8):
        across_m = EARTH_M / np.sqrt(1 - ECCENTRICITY2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + ECCENTRICITY2 * across_m * np.sin(lat), out)
    across_m = EARTH_M / np.sqrt(1 - ECCENTRICITY2 * np.sin(lat) ** 2)
    # Along the normal: good at the poles, too.
    height_m = out * np.cos(lat) + z * np.sin(lat) - EARTH_M**2 / across_m
    return float(np.degrees(lat)), float(np.degrees(np.arctan2(y, x))), float(height_m)


@dataclass(frozen=True)
class LevelAxes:
    """East, north and up at a place."""

    latitude_deg: float
    longitude_deg: float
    height_m: float

    @classmethod
    def of_sensor(cls, scene: Scene, sensor: Sensor) -> Self:
        """Axes at a sensor's place."""
        return cls(*geodetic(cls.of_site(scene.scene.site).place(np.array(sensor.position_enu_m))))

    @classmethod
    def of_site(cls, site: Site) -> Self:
        """Axes of the site."""
        return cls(site.latitude_deg, site.longitude_deg, site.height_m)

    @cached_property
    def rows(self) -> Floats:
        """Unit vectors east, north and up; (3, 3)."""
        lat, lon = np.radians(self.latitude_deg), np.radians(self.longitude_deg)
        up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        east = np.array([-np.sin(lon), np.cos(lon), 0.0])
        return np.stack([east, np.cross(up, east), up])

    @cached_property
    def origin_m(self) -> Floats:
        """Where they are, Earth-centred."""
        return ecef(self.latitude_deg, self.longitude_deg, self.height_m)

    def seen(self, place_m: Floats) -> Floats:
        """Earth-centred places as they are seen from here; (..., 3)."""
        return (place_m - self.origin_m) @ self.rows.T

    def place(self, enu_m: Floats) -> Floats:
        """Earth-centred places of those east, north and up; (..., 3)."""
        return self.origin_m + enu_m @ self.rows

    def of(self, site: Site, place: Location) -> Floats:
        """A place of the scene as it is seen from here; (3,). Heights are over the ellipsoid."""
        if place.latitude_deg is not None:
            at: Any = (place.latitude_deg, place.longitude_deg, place.height_m)
        else:
            level_m = np.array([place.east_m, place.north_m, 0.0], np.float64)
            lat, lon, _ = geodetic(LevelAxes.of_site(site).place(level_m))
            at = lat, lon, site.height_m + (place.above_site_m or 0.0)
        return self.seen(ecef(*at))


def directions(place_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Azimuths, elevations and distances of places, (..., 3)."""
    east, north, up = np.moveaxis(place_m, -1, 0)
    ground_m = np.hypot(east, north)
    azimuth_deg = np.degrees(np.arctan2(east, north)) % 360
    return azimuth_deg, np.degrees(np.arctan2(up, ground_m)), np.hypot(ground_m, up)


def places(azimuth_deg: ArrayLike, elevation_deg: ArrayLike, range_m: ArrayLike) -> Floats:
    """Places of those directions and distances; (..., 3)."""
    az, el = np.radians(azimuth_deg), np.radians(elevation_deg)
    r = np.asarray(range_m, np.float64)
    parts = r * np.cos(el) * np.sin(az), r * np.cos(el) * np.cos(az), r * np.sin(el)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def length(vector_m: Floats) -> Floats:
    """Lengths of vectors; (..., 3)."""
    return np.asarray(np.linalg.norm(vector_m, axis=-1))


def folded_180(angle_deg: ArrayLike) -> Floats:
    """Differences of azimuths from -180 to 180."""
    return np.asarray((np.asarray(angle_deg) + 180) % 360 - 180)


def linear(db: ArrayLike) -> Floats:
    """A ratio of powers."""
    return np.asarray(10 ** (np.asarray(db, np.float64) / 10))


# Detection: a sum of N looks against a threshold from M samples of noise, and 1/x of what crosses.


@cache
def _unit_interval(n: int) -> tuple[Floats, Floats]:
    """Gauss and Legendre's nodes and weights from 0 to 1."""
    node, weight = np.polynomial.legendre.leggauss(n)
    return (node + 1) / 2, weight / 2


def cfar_ratio(pfa: float, looks: int, samples: int) -> float:
    """Threshold over the sum of the samples: a ratio of gamma variables is a beta prime (eq 6)."""
    share = float(special.betaincinv(samples, looks, pfa))
    return 1 / share - 1


def fluctuating(
    snr: Floats, order: float, pfa: float, looks: int, samples: int
) -> tuple[Floats, Floats]:
    """Pd of targets of that mean ratio a look, and the mean of 1/x of their detections; (n,).

    The strength is a gamma variable of that order (Swerling 0 to 4: infinite, 1, N, 2, 2N), so that
    x, the power of all looks, is a mixture of gamma variables of orders N + k, k negative binomial
    or, of a steady target, Poisson (eqs 7, 23). Of order a, 1/x of what crosses is 1/(a - 1) times
    the chance of order a - 1 to cross.
    """
    if looks == 1 and order == 1:
        return unequal(snr[:, None], pfa, samples)
    ratio, mean = cfar_ratio(pfa, looks, samples), looks * snr
    most = ratio * (samples + 14 * np.sqrt(samples) + 80) + 80
    if most > MOST_TERMS:
        return np.full(len(snr), np.nan), np.full(len(snr), np.nan)
    k = np.arange(int(most), dtype=np.float64)
    crosses = special.betainc(samples, looks + k, 1 / (1 + ratio))
    missed = special.betainc(looks + k, samples, ratio / (1 + ratio))
    fewer = np.maximum(looks + k - 1, 1)
    inverse = special.betainc(samples, fewer, 1 / (1 + ratio)) / fewer
    unseen = special.betainc(fewer, samples, ratio / (1 + ratio)) / fewer
    if looks == 1:
        inverse[0] = pfa * unequal(np.zeros((1, 1)), pfa, samples)[1][0]
        unseen[0] = -inverse[0]
    pd, found = np.empty((2, len(snr)))
    for first in range(0, len(snr), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        some = mean[part, None]
        if order == STEADY:
            log = special.xlogy(k, some) - some - special.gammaln(k + 1)
        else:
            log = special.gammaln(k + order) - special.gammaln(order) - special.gammaln(k + 1)
            ends = some / (order + some)
            log = log + order * np.log1p(-ends) + special.xlogy(k, ends)
        weight = np.exp(log)
        strong = 1 - weight.sum(axis=1) > LEAST
        pd[part] = np.where(strong, 1 - weight @ missed, weight @ crosses)
        every = _mean_inverse(some[:, 0], order, looks) if strong.any() else 0.0
        found[part] = np.where(strong, every - weight @ unseen, weight @ inverse)
    return pd, found / pd


def _mean_inverse(mean: Floats, order: float, looks: int) -> Floats:
    """Mean of 1/(N + k - 1) over all k, of one look over all above 0; (n,).

    By the generating function of k, whose integral over z^(N-2) it is.
    """
    node, step = _unit_interval(400)
    y = np.exp(45 * (node - 1))
    step = step * 45 * y

    def generating(one_less_z: Floats) -> Floats:
        lost = np.multiply.outer(mean, one_less_z)
        return np.exp(-lost) if order == STEADY else np.exp(-order * np.log1p(lost / order))

    if looks > 1:
        return np.asarray((generating(y) * (1 - y) ** (looks - 2)) @ step)
    none = generating(np.ones(1))
    return np.asarray(((generating(y) - none) / (1 - y)) @ step)


def of_unequal(means: Floats, ratio: float, samples: int) -> Floats:
    """Chance that a sum of exponentials of those means, (n, K), exceeds the samples' sum, scaled.

    While one sample lasts, some of the looks end: a chain from look to look, a step a sample, and
    the sum is larger if a look still lasts after the last of them (eq 18, right form).
    """
    lasts = means / (ratio + means)
    looks = means.shape[1]
    if looks == 1:
        return np.asarray(lasts[:, 0] ** samples)
    step = np.zeros((len(means), looks, looks))
    for i in range(looks):
        way = np.ones(len(means))
        for j in range(i, looks):
            step[:, i, j] = way * lasts[:, j]
            way = way * (ratio / (ratio + means[:, j]))
    return np.asarray(np.linalg.matrix_power(step, samples)[:, 0].sum(axis=1))


def unequal(snrs: Floats, pfa: float, samples: int) -> tuple[Floats, Floats]:
    """Pd of the sum of looks that fluctuate each by itself, (n, K), and 1/x of its detections.

    The mean of 1/x is the integral over u of that of e^(-ux), which makes each exponential shorter;
    over the logarithm of u the trapezoid rule errs by less than 1e-10.
    """
    looks, means = snrs.shape[1], 1 + snrs
    ratio = cfar_ratio(pfa, looks, samples)
    pd = of_unequal(means, ratio, samples)
    inverse, step = np.zeros(len(means)), 0.5
    low = -24.0 - float(np.log(np.max(means, initial=1.0, where=np.isfinite(means))))
    high = 1.0 + 24.0 / (samples + looks - 1) - min(float(np.log(ratio)), 0.0)
    for u in np.exp(np.arange(low, high, step)):
        shorter = 1 / (1 + u * means)
        inverse += step * u * shorter.prod(axis=1) * of_unequal(means * shorter, ratio, samples)
    return pd, inverse / pd


def at_least(pd: Floats, needed: int) -> Floats:
    """Chance that so many of independent trials succeed, (n, N) in: the binomial's, unequal."""
    law = np.zeros((len(pd), pd.shape[1] + 1))
    law[:, 0] = 1.0
    for p in pd.T:
        law[:, 1:] = law[:, 1:] * (1 - p[:, None]) + law[:, :-1] * p[:, None]
        law[:, 0] *= 1 - p
    return np.asarray(law[:, needed:].sum(axis=1))


# Targets.


def signature_of(scene: Scene, name: str) -> TargetSignature | None:
    """What there is of a target by its name in a ledger; None of one that the scene has not."""
    kind, _, own = name.rpartition("/")
    whole = own.rpartition("-")[0]
    found: list[TargetSignature] = []
    if kind in {"bird", "vehicle"}:
        movers: Sequence[Any] = scene.birds if kind == "bird" else scene.road
        found = [TargetSignature(rcs_m2=m.rcs_m2, size_m=m.size_m) for m in movers if m.id == whole]
    elif kind == "turbine":
        for mill in scene.turbine:
            if mill.id == own:
                found.insert(0, TargetSignature(rcs_m2=mill.tower_rcs_m2, size_m=mill.radius_m))
            elif mill.id == whole:
                found.append(TargetSignature(rcs_m2=mill.blade_rcs_m2, size_m=1.0))
    elif not kind:
        drones: Sequence[Any] = scene.fleet.kinds
        for drone in drones:
            if name in (getattr(drone, "names", None) or [drone.id]):
                echoes = (t for t in scene.target if t.target_class == drone.target_class)
                echo: Any = next(echoes, TargetSignature())
                told = {"aspect": echo.aspect, "swerling": _or(drone.swerling, echo.swerling)}
                for each in ("rcs_m2", "sound_power_db", "size_m"):
                    told[each] = _or(getattr(drone, each), getattr(scene.telemetry, each))
                found.append(TargetSignature(emitters=drone.emitters, **told))
    return found[0] if found else None


# Of the scenes that were asked for last, by identity: those are compared in no time.
_SIGNATURES: dict[int, tuple[Scene, dict[str, TargetSignature | None]]] = {}
_SCENES_KEPT = 16


def _velocities(looks: LooksGiven, period_s: float) -> tuple[Floats, Floats]:
    """Velocities since a target's look before, and until the one after, (n, 3); NaN of none."""
    place_m = places(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
    t_ns = looks.t_utc_ns if looks.emitted_utc_ns is None else np.where(
        looks.emitted_utc_ns > 0, looks.emitted_utc_ns, looks.t_utc_ns
    )  # fmt: skip
    before, after = np.full((2, len(looks), 3), np.nan)
    for name in set(looks.drone.tolist()):
        mine = np.flatnonzero(looks.drone == name)
        times, first, which = np.unique(t_ns[mine], return_index=True, return_inverse=True)
        if len(times) < 2:
            continue
        step_s = np.diff(times) / 1e9
        speed = np.diff(place_m[mine[first]], axis=0) / step_s[:, None]
        speed[step_s > 2.5 * period_s] = np.nan
        before[mine] = np.vstack([speed[:1] * np.nan, speed])[which]
        after[mine] = np.vstack([speed, speed[:1] * np.nan])[which]
    return before, after


# One look: what is known of it, and what is on the way.


def _about_up(azimuth_deg: float) -> Floats:
    """What adds to azimuths; (3, 3)."""
    c, s = np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


class _Look:
    """Looks of one sensor, and what all kinds have to know of them; (n,) or (n, 3)."""

    def __init__(self, scene: Scene, sensor: Sensor, looks: LooksGiven) -> None:
        self.scene, self.sensor, self.looks = scene, sensor, looks
        self.axes = LevelAxes.of_sensor(scene, sensor)
        self.place_m = places(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
        self.range_m = np.asarray(looks.range_m, np.float64)
        self.channel = looks.channel
        self.known = np.ones(len(looks), np.bool_)
        self.doubts: list[str] = []
        unknown = np.full((len(looks), 3), np.nan)
        self.velocity = unknown if looks.velocity_enu_m_s is None else looks.velocity_enu_m_s
        self.names, self.of = np.unique(looks.drone.astype(str), return_inverse=True)
        if _SIGNATURES.get(id(scene), (None,))[0] is not scene:
            if len(_SIGNATURES) >= _SCENES_KEPT:
                _SIGNATURES.clear()
            _SIGNATURES[id(scene)] = scene, {}
        known = _SIGNATURES[id(scene)][1]
        for name in {*self.names.tolist()} - known.keys():
            known[name] = signature_of(scene, name)
        found = [known[n] for n in self.names.tolist()]
        strange = np.array([each is None for each in found])
        self.doubt("drones that the scene does not name", strange[self.of])
        self.signatures = [TargetSignature() if each is None else each for each in found]
        has_some = scene.terrain is not None and scene.encloses(HORIZONS)
        self.horizons = _horizons(scene.file(HORIZONS)) if has_some else []
        if scene.terrain is not None and not self.horizons:
            self.doubt("ground and buildings, whose horizons are not there")

    def doubt(self, why: str, where: Bools | bool = True) -> None:
        """Have an effect that is not known here be in force, at those looks."""
        if np.any(where):
            self.known = self.known & ~np.asarray(where)
            if why not in self.doubts:
                self.doubts.append(why)

    def each(self, name: str) -> Floats:
        """A number of the targets' signatures, a row a look."""
        return np.array([getattr(s, name) for s in self.signatures], np.float64)[self.of]

    @cached_property
    def own_m(self) -> Floats:
        """Places along the axes that the sensor takes for east, north and up."""
        bias = self.sensor.bias
        if bias is None or not (bias.tilt_deg or bias.azimuth_offset_deg):
            return self.place_m
        # Its vertical leans: about the level axis right of where to, then about itself.
        to, turn = bias.tilt_azimuth_deg, bias.azimuth_offset_deg - bias.tilt_azimuth_deg
        tilt = np.radians(bias.tilt_deg)
        lean = [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
        return np.asarray(self.place_m @ (_about_up(turn) @ lean @ _about_up(to)).T)

    def offset_m(self, place: Location) -> Floats:
        """A place of the scene as it is seen from the sensor; (3,)."""
        return self.axes.of(self.scene.scene.site, place)

    @cached_property
    def sent_m(self) -> Floats:
        """Places of transmitters from the sensor, (K, 3); none where it itself transmits."""
        sent = getattr(self.sensor, "transmitters", ())
        return np.array([self.offset_m(getattr(t, "place", t)) for t in sent]).reshape(-1, 3)

    def rate_m_s(self, start_m: ArrayLike = 0.0) -> Floats:
        """How fast targets recede from a place."""
        away_m = self.place_m - np.asarray(start_m)
        return np.asarray((away_m * self.velocity).sum(axis=1) / length(away_m))

    def way(
        self, place_m: Floats, wavelength_m: Any, start_m: ArrayLike, station_m: Floats
    ) -> Floats:
        """Share of power that is left one way, by the ground's reflection and towers; (n,).

        Places are seen from a station, which is where that is of the sensor.
        """
        start_m = np.broadcast_to(np.asarray(start_m, np.float64), place_m.shape)
        found: Floats = np.ones(len(place_m))
        keys = getattr(self.sensor, "multipath", None)
        if keys is not None:
            low_m = np.maximum(keys.antenna_height_m + start_m[:, 2], 0)
            high_m = np.maximum(keys.antenna_height_m + place_m[:, 2], 0)
            ground_m = np.hypot(*(place_m - start_m)[:, :2].T)
            longer = np.hypot(ground_m, high_m - low_m) + np.hypot(ground_m, high_m + low_m)
            phase = 2 * np.pi / wavelength_m * 4 * low_m * high_m / np.where(longer, longer, 1)
            found = np.abs(1 + keys.reflection * np.exp(1j * phase)) ** 2
        found = found * self.behind(place_m + station_m, wavelength_m, start_m[0] + station_m)
        for mill in self.scene.turbine:
            if mill.tower_width_m:
                top_m = self.offset_m(mill) - station_m
                tower = top_m, mill.tower_width_m, wavelength_m
                found = found * past_tower(place_m, start_m, *tower)
        return found

    def behind(self, place_m: Floats, wavelength_m: Any, start_m: Any = 0.0) -> Floats:
        """Share of power that ground and buildings leave one way, of places seen from the sensor.

        Slopes rise by what an Earth of another radius does to bent rays; behind the highest edge a
        wave loses what ITU-R P.526, 4.1 says, or all.
        """
        keys = self.scene.terrain
        if keys is None or not self.horizons:
            return np.ones(len(place_m))
        end_m = self.axes.place(np.zeros(3) + start_m)
        horizon = min(self.horizons, key=lambda each: float(length(each.origin_m - end_m)))
        if length(horizon.origin_m - end_m) > 1.0:
            self.doubt("a horizon that the recording has not")
        azimuth_deg, elevation_deg, range_m = directions(horizon.seen(self.axes.place(place_m)))
        ground_m = np.maximum(range_m * np.cos(np.radians(elevation_deg)), 1e-3)
        edge_m, slope = horizon.highest(azimuth_deg, ground_m)
        bent = (1 - 1 / keys.earth_radius_factor) / (2 * 6_371_000)
        over = slope - np.tan(np.radians(elevation_deg)) - bent * ground_m
        if not keys.diffraction:
            return np.where(over > 0, 1e-20, 1.0)
        nu = edge_m * over * np.sqrt(2 / wavelength_m * (1 / edge_m + 1 / (ground_m - edge_m)))
        lost_db = 6.9 + 20 * np.log10(np.sqrt((nu - 0.1) ** 2 + 1) + nu - 0.1)
        return np.where(nu > -0.78, linear(-lost_db), 1.0)


def _needs_velocities(scene: Scene, sensor: Any) -> bool:
    """Whether how fast targets are changes anything of what is asked."""
    pulses = getattr(sensor, "pulses", None)
    filters = pulses is not None and (pulses.canceller is not None or pulses.notch_m_s > 0)
    sides = sensor.type in RADARS and any(target.aspect for target in scene.target)
    is_pair = sensor.type == "acoustic_pair"
    return filters or sides or is_pair or getattr(sensor, "doppler", None) is not None


def past_tower(
    place_m: Floats, start_m: Floats, top_m: Floats, width_m: float, wavelength_m: Any
) -> Floats:
    """Share of power past an upright strip: Fresnel's integral over what it leaves of the wave."""
    along_m = place_m - start_m
    ground_m = np.hypot(along_m[:, 0], along_m[:, 1])
    ray = along_m[:, :2] / ground_m[:, None]
    to_m = top_m[:2] - start_m[:, :2]
    before_m = (to_m * ray).sum(axis=1)
    beside_m = to_m[:, 0] * ray[:, 1] - to_m[:, 1] * ray[:, 0]
    behind_m = ground_m - before_m
    height_m = start_m[:, 2] + along_m[:, 2] * before_m / ground_m
    stands = (before_m > 1) & (behind_m > 1) & (height_m < top_m[2])
    scale = np.sqrt(2 / wavelength_m * ground_m / np.where(stands, before_m * behind_m, 1))
    (s1, c1), (s2, c2) = (
        special.fresnel(scale * (beside_m + side * width_m / 2)) for side in (-1, 1)
    )
    shadow = (1 + 1j) / 2 * ((c2 - c1) - 1j * (s2 - s1))
    return np.where(stands, np.abs(1 - shadow) ** 2, 1.0)


@dataclass(frozen=True)
class _Horizon(LevelAxes):
    """Slopes of ground and walls about a place: each step is the highest from there on."""

    parts: int  # Of the circle
    steps: NDArray[Any]

    def highest(self, azimuth_deg: Floats, ground_m: Floats) -> tuple[Floats, Floats]:
        """Distance and slope of the highest edge before places; -inf where there is none."""
        part = np.floor(azimuth_deg * self.parts / 360) % self.parts
        number = np.searchsorted(self._keys, part + ground_m / FURTHER_M)
        before = self.steps[np.maximum(number - 1, 0)] if number.any() else np.zeros(1, STEP)
        found = (number > 0) & (before["azimuth"] == part)
        return np.where(found, before["distance_m"], 1.0), np.where(found, before["slope"], -np.inf)

    @cached_property
    def _keys(self) -> Floats:
        """Azimuths and distances of steps on one axis; (n,)."""
        return np.asarray(self.steps["azimuth"] + self.steps["distance_m"].astype("f8") / FURTHER_M)


@lru_cache(maxsize=1)
def _horizons(path: Path) -> list[_Horizon]:
    return [_Horizon(*each) for each in read_horizons(path)]


# What weather takes and sends back: ITU-R P.838-3 and P.676-10, Marshall and Palmer.

# a, b and c of each bell of P.838-3, tables 1 to 4, then the line's slope and offset.
RAIN_K = {
    "horizontal": "-5.3398 -.10008 1.13098 -.35351 1.2697 .454 -.23789 .86036 .15354 -.94158 "
    ".64552 .16817 -.18961 .71147",
    "vertical": "-3.80595 .56934 .81061 -3.44965 -.22911 .51059 -.39902 .73042 .11899 .50167 "
    "1.07319 .27195 -.16398 .63297",
}
RAIN_ALPHA = {
    "horizontal": "-.14318 1.82442 -.55187 .29591 .77564 .19822 .32177 .63773 .13164 -5.3761 "
    "-.9623 1.47828 16.1721 -3.2998 3.4399 .67849 -1.95537",
    "vertical": "-.07771 2.3384 -.76284 .56727 .95545 .54039 -.20238 1.1452 .26809 -48.2991 "
    ".791669 .116226 48.5833 .791459 .116479 -.053739 .83433",
}


def rain_db_km(frequency_hz: Floats, rain_mm_h: float, polarisation: str) -> Floats:
    """Loss in rain one way, dB/km (ITU-R P.838-3), of level paths."""
    x = np.log10(frequency_hz / 1e9)

    def total(told: str) -> Floats:
        *bells, slope, offset = map(float, told.split())
        rows = np.array(bells).reshape(-1, 3)
        humps = sum(a * np.exp(-(((x - b) / c) ** 2)) for a, b, c in rows)
        return np.asarray(slope * x + offset + humps)

    k, alpha = ({p: total(told[p]) for p in told} for told in (RAIN_K, RAIN_ALPHA))
    k = {p: 10**log for p, log in k.items()}
    k["circular"] = (k["horizontal"] + k["vertical"]) / 2
    weighed = k["horizontal"] * alpha["horizontal"] + k["vertical"] * alpha["vertical"]
    alpha["circular"] = weighed / (2 * k["circular"])
    return np.asarray(k[polarisation] * rain_mm_h ** alpha[polarisation])


def gases_db_km(frequency_hz: Floats, vapour_g_m3: float) -> Floats:
    """Loss in gases at 1013 hPa and 15 C, dB/km (ITU-R P.676-10, annex 2); none from 54 GHz on."""
    f, w = frequency_hz / 1e9, vapour_g_m3
    eta1, eta2 = 0.955 + 0.006 * w, 0.735 + 0.0353 * w
    oxygen = (7.2 / (f * f + 0.34) + 0.62 / ((54 - f) ** 1.16 + 0.83)) * f * f / 1000
    water = np.zeros_like(f)
    # Strength, eta, line in GHz, width, and whether the factor of its far wing applies.
    for strength, eta, line, width, centre in (
        (3.98, eta1, 22.235, 9.42 * eta1**2, 22),
        (11.96, eta1, 183.31, 11.14 * eta1**2, 0),
        (0.081, eta1, 321.226, 6.29 * eta1**2, 0),
        (3.66, eta1, 325.153, 9.22 * eta1**2, 0),
        (25.37, eta1, 380, 0, 0),
        (17.4, eta1, 448, 0, 0),
        (844.6, eta1, 557, 0, 557),
        (290, eta1, 752, 0, 752),
        (8.3328e4, eta2, 1780, 0, 1780),
    ):
        wing = 1 + ((f - centre) / (f + centre)) ** 2 if centre else 1
        water = water + strength * eta / ((f - line) ** 2 + width) * wing
    return np.where(f < 54, oxygen + water * f * f * w / 1e4, 0.0)


# Radars.

RADARS = frozenset(
    {"active_radar", "mimo_radar", "passive_radar", "multistatic_mimo", "multistatic_passive"}
)


def _is_passive(sensor: Any) -> bool:
    return sensor.type in {"passive_radar", "multistatic_passive"}


def _signals_hz(sensor: Any) -> tuple[Floats, Floats]:
    """Carriers and bandwidths, (K,) of a passive radar, else (1,)."""
    if _is_passive(sensor):
        told = [(t.frequency_hz, t.bandwidth_hz) for t in sensor.transmitters]
    else:
        told = [(sensor.frequency_hz, LIGHT_M_S / (2 * sensor.range_resolution_m))]
    frequency_hz, bandwidth_hz = np.array(told, np.float64).T
    return frequency_hz, bandwidth_hz


def _range_cells_m(sensor: Any) -> Floats:
    """Cells of what is measured of range: of a sum of ways c/B, by channel."""
    hz = _signals_hz(sensor)[1]
    return LIGHT_M_S / hz if _is_passive(sensor) else np.array([sensor.range_resolution_m])


def _rate_cells_m_s(sensor: Any) -> Floats:
    """Doppler cells: wavelength/2T, of a bistatic range, by channel, wavelength/T."""
    legs = 1 if _is_passive(sensor) else 2
    return np.asarray(LIGHT_M_S / _signals_hz(sensor)[0] / (legs * sensor.integration_s))


def _folding_prf_hz(sensor: Any) -> float | None:
    """The pulse frequency after which rates and ranges look alike; None if none does."""
    pulses = getattr(sensor, "pulses", None)
    if pulses is not None:
        return float(pulses.prf_hz[0]) if len(set(pulses.prf_hz)) == 1 else None
    return getattr(sensor.doppler, "prf_hz", None) if sensor.doppler is not None else None


def _gain_rx_db(sensor: Any) -> float:
    """The stated gain, or that of a beam of its widths (eqs 2, 3, 19, 27)."""
    if sensor.gain_rx_dbi is not None:
        return float(sensor.gain_rx_dbi)
    beam_deg2 = sensor.azimuth_beamwidth_deg * sensor.elevation_beamwidth_deg
    gain = 41253 * sensor.antenna_efficiency / beam_deg2
    cut = sensor.antenna and sensor.antenna.receive and sensor.antenna.receive.elevation
    if cut is not None and cut.kind == "cosecant-squared":
        # Skolnik: the beam spends 2 - e1 cot e2 times what its lower part alone would.
        gain /= 2 - np.radians(cut.from_deg) / np.tan(np.radians(cut.to_deg))
    return float(10 * np.log10(gain))


# Man-made noise of ITU-R P.372, c and d of c - d lg f/MHz, and up to where it is given.
MAN_MADE = {
    "city": (76.8, 27.7),
    "residential": (72.5, 27.7),
    "rural": (67.2, 27.7),
    "quiet-rural": (53.6, 28.6),
}


def _external_db(sensor: Any, transmitter: Any) -> float:
    """Noise that an antenna collects, over k T0 B: stated, or man-made and galactic by P.372."""
    for stated in (transmitter.external_noise_db, sensor.external_noise_db):
        if stated is not None:
            return float(stated)
    mhz = transmitter.frequency_hz / 1e6
    c, d = MAN_MADE[sensor.noise_environment]
    total = linear(c - d * np.log10(mhz))
    if 10 <= mhz <= 100:
        total = total + linear(52 - 23 * np.log10(mhz))
    return float(10 * np.log10(total))


def _noise_w(look: _Look, receiver_m: Floats) -> Floats:
    """What disturbs a receiver: in a hertz (eqs 5, 21), of a passive radar in each channel's band.

    That is what is left of the broadcast itself, and radio noise (eqs 28 to 31).
    """
    sensor: Any = look.sensor
    if not _is_passive(sensor):
        return np.array([thermal_w_hz(sensor.noise_figure_db)])
    own = linear(sensor.line_loss_db + sensor.antenna_loss_db + sensor.receiver_noise_figure_db)
    heard_db = DIPOLE_DB + _gain_rx_db(sensor) + sensor.sidelobe_db + sensor.cancellation_db
    found = []
    for source, place_m in zip(sensor.transmitters, look.sent_m - receiver_m, strict=True):
        wavelength_m = LIGHT_M_S / source.frequency_hz
        spread = (wavelength_m / (4 * np.pi * length(place_m))) ** 2
        way = look.way(place_m[None], wavelength_m, 0.0, receiver_m)[0]
        external = linear(_external_db(sensor, source)) - 1
        thermal_w = BOLTZMANN_J_K * ROOM_K * source.bandwidth_hz * (external + own)
        found.append(source.erp_w * linear(heard_db) * spread * way + thermal_w)
    return np.array(found)


def thermal_w_hz(noise_figure_db: float) -> Floats:
    """Density of a receiver's own noise (eq 5)."""
    return BOLTZMANN_J_K * ROOM_K * linear(noise_figure_db)


def radar_equation(
    power_w: Any, gains_db: Any, wavelength_m: Any, rcs_m2: Any, ways_m2: Any
) -> Floats:
    """Power of echoes by the product of their ways; gains are less all losses (eqs 1, 17, 24)."""
    spread = (4 * np.pi) ** 3 * np.square(ways_m2)
    return np.asarray(power_w * linear(gains_db) * wavelength_m**2 * rcs_m2 / spread)


def _echoes(look: _Look, receiver_m: Floats) -> Floats:
    """Ratios of echoes by the radar equation, of passive radar before the correlator; (n, K).

    Eqs 1, 17, 24; integration counts where there is no correlator. Transmitters are seen from the
    sensor; without any it is the sensor itself that transmits.
    """
    sensor: Any = look.sensor
    noise_w, frequency_hz = _noise_w(look, receiver_m), _signals_hz(sensor)[0]
    back_m = look.place_m - receiver_m
    starts_m = look.sent_m - receiver_m if len(look.sent_m) else np.zeros((1, 3))
    found = np.empty((len(back_m), len(starts_m)))
    for k, start_m in enumerate(starts_m):
        source = sensor.transmitters[k] if len(look.sent_m) else sensor
        wavelength_m = LIGHT_M_S / np.resize(frequency_hz, k + 1)[k]
        if _is_passive(sensor):
            power_w, gain_db = source.erp_w, DIPOLE_DB
        else:
            gain_db = sensor.gain_tx_dbi if source.gain_tx_dbi is None else source.gain_tx_dbi
            power_w = source.power_w * sensor.integration_s
        gain_db = gain_db + _gain_rx_db(sensor) - sensor.loss_db
        out_m, in_m = (np.maximum(length(m), NEAREST_M) for m in (back_m - start_m, back_m))
        rcs_m2 = look.each("rcs_m2")
        echo = radar_equation(power_w, gain_db, wavelength_m, rcs_m2, out_m * in_m)
        echo = echo * look.way(back_m, wavelength_m, 0.0, receiver_m)
        echo = echo * look.way(back_m, wavelength_m, start_m, receiver_m)
        found[:, k] = echo / np.resize(noise_w, k + 1)[k]
    return found


def _cut_db(
    cut: Any, angle_deg: Floats, width_deg: float, low_deg: float, high_deg: float
) -> Floats:
    """Loss of one cut of an antenna, dB; its own width, or the sensor's."""
    middle_deg = (low_deg + high_deg) / 2
    if cut.kind in {"gaussian", "table"} and cut.boresight_deg is not None:
        middle_deg = cut.boresight_deg
    if cut.kind == "table":
        off_deg = folded_180(angle_deg - middle_deg)
        return np.asarray(-np.interp(off_deg, cut.angle_deg, cut.gain_db))
    width_deg = cut.beamwidth_deg or width_deg
    if cut.kind == "cosecant-squared":
        inside = np.clip(angle_deg, cut.from_deg, cut.to_deg)
        rise = np.sin(np.radians(inside)) / np.sin(np.radians(cut.from_deg))
        off_deg, rise_db = angle_deg - inside, 20 * np.log10(rise)
    else:
        off_deg, rise_db = folded_180(angle_deg - middle_deg), 0.0
        if cut.kind == "beams":
            beams = (high_deg - low_deg) / (cut.spacing_deg or width_deg)
            count = max(int(np.ceil(beams - 1e-9)), 1)
            middles = low_deg + (np.arange(count) + 0.5) * (high_deg - low_deg) / count
            apart = np.abs(folded_180(np.subtract.outer(angle_deg, middles)))
            off_deg = apart.min(axis=1)
    return np.asarray(ONE_WIDTH_DB * (off_deg / width_deg) ** 2 + rise_db)


def _pattern(sensor: Any, keys: Any, azimuth_deg: Floats, elevation_deg: Floats) -> Floats:
    """Gain of an antenna over its peak; nowhere below its side lobes."""
    low_deg, high_deg = sensor.elevation_min_deg, sensor.elevation_max_deg
    lost_db = np.zeros(len(azimuth_deg))
    if keys.azimuth is not None:
        cover = sensor.azimuth_min_deg, sensor.azimuth_max_deg
        lost_db = lost_db + _cut_db(keys.azimuth, azimuth_deg, sensor.azimuth_beamwidth_deg, *cover)
    if keys.elevation is not None:
        width_deg = sensor.elevation_beamwidth_deg or high_deg - low_deg
        lost_db = lost_db + _cut_db(keys.elevation, elevation_deg, width_deg, low_deg, high_deg)
    return linear(-np.minimum(lost_db, keys.sidelobe_db))


def _on_the_way(look: _Look, receiver_m: Floats) -> Floats:
    """What is left of echoes by beams, cells, weather, jammers and aspect; (n, 1) or (n, K)."""
    sensor: Any = look.sensor
    azimuth_deg, elevation_deg, _ = directions(look.own_m)
    left = np.ones((len(look.range_m), 1))
    antenna, straddling, weather = sensor.antenna, sensor.straddling, sensor.weather
    sent_m = look.sent_m
    frequency_hz = _signals_hz(sensor)[0]
    if antenna is not None and antenna.receive is not None:
        left = left * _pattern(sensor, antenna.receive, azimuth_deg, elevation_deg)[:, None]
    if antenna is not None and antenna.transmit is not None:
        sights = [directions(look.place_m - each)[:2] for each in sent_m]
        sights = sights or [(azimuth_deg, elevation_deg)]
        out = [_pattern(sensor, antenna.transmit, *each) for each in sights]
        left = left * np.stack(out, axis=-1)
    ways_m = np.stack([length(look.place_m - m) for m in sent_m] or [look.range_m], axis=-1)
    ways_m = ways_m + look.range_m[:, None]
    if straddling is not None:
        told_m, rates = look.range_m[:, None], look.rate_m_s()[:, None]
        if _is_passive(sensor):
            told_m = ways_m - length(sent_m)
            rates = rates + np.stack([look.rate_m_s(m) for m in sent_m], axis=-1)
        if straddling.range is not None:
            left = left * _in_cell(straddling.range, told_m / _range_cells_m(sensor))
        if straddling.doppler is not None:
            left = left * _in_cell(straddling.doppler, rates / _rate_cells_m_s(sensor))
    if weather is not None:
        db_km = np.zeros(len(frequency_hz))
        if weather.rain_mm_h:
            db_km = db_km + rain_db_km(frequency_hz, weather.rain_mm_h, weather.polarisation)
        if weather.vapour_g_m3 is not None:
            db_km = db_km + gases_db_km(frequency_hz, weather.vapour_g_m3)
        left = left * linear(-ways_m / 1000 * db_km)
        if weather.rain_echo and weather.rain_mm_h and sensor.type == "active_radar":
            left = left / (1 + _rain_over_noise(look, weather, float(db_km[0])))[:, None]
    if sensor.jamming:
        left = left / (1 + _jamming(look))
    return left * _aspects(look, receiver_m)


def _jamming(look: _Look) -> Floats:
    """Noise of jammers over a radar's own, by the beam that looks at each target; (n, K)."""
    sensor: Any = look.sensor
    azimuth_deg, elevation_deg, _ = directions(look.own_m)
    frequency_hz, bandwidth_hz = _signals_hz(sensor)
    noise_w_hz = _noise_w(look, np.zeros(3))
    if _is_passive(sensor):
        noise_w_hz = noise_w_hz / bandwidth_hz
    over = np.zeros((len(azimuth_deg), len(frequency_hz)))
    for jammer in sensor.jamming.values():
        from_deg, above_deg, far_m = directions(look.offset_m(jammer))
        off = (folded_180(azimuth_deg - from_deg) / sensor.azimuth_beamwidth_deg) ** 2
        if sensor.elevation_beamwidth_deg is not None:
            off = off + ((elevation_deg - above_deg) / sensor.elevation_beamwidth_deg) ** 2
        gain = np.maximum(linear(-ONE_WIDTH_DB * off), linear(jammer.sidelobe_db))
        told = float(far_m), _gain_rx_db(sensor), frequency_hz, bandwidth_hz
        gain = gain * look.behind(look.offset_m(jammer)[None], LIGHT_M_S / jammer.frequency_hz)
        over += gain[:, None] * _jammer_over(jammer, *told) / noise_w_hz
    return over


def _in_cell(shape: str, place: Floats) -> Floats:
    """What is left of a power off the middle of a cell, by the amplitude of its shape."""
    off = place - np.round(place)
    amplitude = 1 - np.abs(off) if shape == "triangle" else np.sinc(off)
    return np.asarray((amplitude / (1 - off * off) if shape == "hann" else amplitude) ** 2)


def _rain_over_noise(look: _Look, weather: Any, db_km: float) -> Floats:
    """Echo of the rain in a target's cell over noise: eta V, V of a two-way Gaussian beam."""
    sensor: Any = look.sensor
    wavelength_m = LIGHT_M_S / sensor.frequency_hz
    eta = np.pi**5 * 0.93 * 200 * weather.rain_mm_h**1.6 * 1e-18 / wavelength_m**4
    beams = np.radians(sensor.azimuth_beamwidth_deg) * np.radians(sensor.elevation_beamwidth_deg)
    range_m = np.maximum(look.range_m, NEAREST_M)
    volume_m3 = np.pi / (8 * np.log(2)) * range_m**2 * beams * sensor.range_resolution_m
    gains_db = sensor.gain_tx_dbi + _gain_rx_db(sensor) - sensor.loss_db
    power_w = sensor.power_w * sensor.integration_s * linear(-2 * db_km * range_m / 1000)
    echo = radar_equation(power_w, gains_db, wavelength_m, eta * volume_m3, range_m**2)
    return echo / thermal_w_hz(sensor.noise_figure_db)


def _jammer_over(
    jammer: Any, far_m: float, gain_db: float, frequency_hz: Floats, bandwidth_hz: Floats
) -> Floats:
    """Density of a jammer's noise at a receiver, by the share of its band that that lies in."""
    half = jammer.bandwidth_hz / 2
    low = np.maximum(frequency_hz - bandwidth_hz / 2, jammer.frequency_hz - half)
    high = np.minimum(frequency_hz + bandwidth_hz / 2, jammer.frequency_hz + half)
    share = np.clip((high - low) / bandwidth_hz, 0, 1)
    spread = (LIGHT_M_S / frequency_hz / (4 * np.pi * max(far_m, NEAREST_M))) ** 2
    return np.asarray(share * jammer.eirp_w / jammer.bandwidth_hz * linear(gain_db) * spread)


def _aspects(look: _Look, receiver_m: Floats) -> Floats:
    """Cross-sections by the side that is seen; between receiver and transmitter, if they part."""
    left = np.ones((len(look.range_m), max(len(look.sent_m), 1)))
    course_deg = np.degrees(np.arctan2(look.velocity[:, 0], look.velocity[:, 1]))
    ways = [np.asarray(end_m) - look.place_m for end_m in (receiver_m, *look.sent_m)]
    back, *out = [way / length(way)[:, None] for way in ways]
    for number, signature in enumerate(look.signatures):
        mine = look.of == number
        if signature.aspect is None or not mine.any():
            continue
        aspect = signature.aspect
        for k, side in enumerate([back + way for way in out] or [back]):
            # Degrees right of the nose.
            angle_deg = np.degrees(np.arctan2(side[mine, 0], side[mine, 1])) - course_deg[mine]
            if aspect.kind == "lobes":
                # The mean power of A cos 4a dB is I0 of A in nepers.
                mean_db = 10 * np.log10(special.i0(aspect.depth_db * np.log(10) / 10))
                over_db = aspect.depth_db * np.cos(np.radians(4 * angle_deg)) - mean_db
            else:
                over_db = np.interp(angle_deg, aspect.angle_deg, aspect.gain_db, period=360)
            left[mine, k] = linear(over_db)
    return left


def _intervals_of(sensor: Any) -> int:
    return int(sensor.pulses.intervals or len(sensor.pulses.prf_hz))


def _intervals(look: _Look) -> Floats:
    """What is left of echoes in each interval of pulses; (n, N), (n, 1) without them."""
    sensor: Any = look.sensor
    pulses = getattr(sensor, "pulses", None)
    if pulses is None:
        return np.ones((len(look.range_m), 1))
    count = _intervals_of(sensor)
    prf_hz = np.resize(np.array(pulses.prf_hz), count)
    left = np.ones((len(look.range_m), count))
    pulse_m = LIGHT_M_S / (2 * prf_hz)
    since_m = look.range_m[:, None] % pulse_m
    if pulses.pulse_s:
        heard = np.minimum(since_m, pulse_m - since_m) / (pulse_m * pulses.pulse_s * prf_hz)
        left = left * np.clip(heard, 0, 1) ** 2
    if pulses.stc_range_m:
        left = left * np.minimum(since_m / pulses.stc_range_m, 1) ** pulses.stc_exponent
    wavelength_m, rate = LIGHT_M_S / sensor.frequency_hz, look.rate_m_s()[:, None]
    turns = 2 * rate / wavelength_m / prf_hz
    turns = turns - np.round(turns)
    if pulses.canceller is not None:
        sine = np.sin(np.pi * turns)
        left = left * (2 * sine**2 if pulses.canceller == "single" else 8 / 3 * sine**4)
    if pulses.notch_m_s:
        seen_m_s = turns * wavelength_m * prf_hz / 2
        left = left * -np.expm1(-((seen_m_s / pulses.notch_m_s) ** 2))
    if pulses.beam_passes:
        # The beam's middle meets a target within one interval of a clock of their own.
        step_deg = 360 * sensor.integration_s / sensor.scan.period_s
        clock_ns = max(round(sensor.integration_s * 1e9), 1)
        into = (look.looks.t_utc_ns % clock_ns) / clock_ns
        middle_deg = step_deg * (np.arange(count) - count // 2 + 0.5 - into[:, None])
        slope = np.sqrt(2 * np.log(2)) / sensor.azimuth_beamwidth_deg  # amplitude e^-(slope a)^2
        ends = [special.erf(slope * (middle_deg + s * step_deg / 2)) for s in (-1, 1)]
        mean = np.sqrt(np.pi) / 2 * (ends[1] - ends[0]) / (slope * step_deg)
        left = left * mean**2
    return left


def _detected(look: _Look, snrs: Floats, transmitters: int) -> tuple[Floats, Floats]:
    """Pd of echoes, (n, K), and the mean of 1/x of detections of power x a signal, by fluctuation.

    Of one signal a target is Swerling 1 unless it states otherwise, of several 2, each with its own
    ratio; a stated case is of the mean ratio.
    """
    sensor: Any = look.sensor
    pd, inverse = np.full((2, len(snrs)), np.nan)
    samples = sensor.n_reference * transmitters
    for case in {s.swerling for s in look.signatures}:
        mine = np.array([s.swerling == case for s in look.signatures])[look.of]
        if case is None:
            pd[mine], inverse[mine] = unequal(snrs[mine], sensor.pfa, samples)
        else:
            law = _order(case, transmitters), sensor.pfa, transmitters, samples
            pd[mine], inverse[mine] = fluctuating(snrs[mine].mean(axis=1), *law)
    return pd, inverse * transmitters


def _order(case: int | None, looks: int) -> float:
    """The order of the gamma variable of Swerling's cases, over looks whose powers are summed."""
    orders: Mapping[int | None, float] = {0: STEADY, 2: looks, 3: 2.0, 4: 2.0 * looks}
    return orders.get(case, 1.0)


def _passed(look: _Look, rate_m_s: Floats, wavelength_m: Floats) -> Floats:
    """Share of Pd that the notch leaves, of rates as they fold or are told apart."""
    keys = look.sensor.doppler  # type: ignore[attr-defined]
    prf_hz = None if _is_passive(look.sensor) else _folding_prf_hz(look.sensor)
    seen = rate_m_s
    if prf_hz is not None:
        span = wavelength_m * prf_hz / 2
        seen = rate_m_s - span * np.round(rate_m_s / span)
    left: Floats = np.ones(len(seen))
    if keys.notch_m_s:
        left = -np.expm1(-((seen / keys.notch_m_s) ** 2))
    return left if prf_hz is not None else np.where(np.abs(seen) <= keys.rate_max_m_s, left, 0.0)


def _merged(look: _Look) -> None:
    """Doubt looks whose echo may merge with that of another target near by."""
    sensor: Any = look.sensor
    if getattr(sensor, "merging", None) is None:
        return
    keys = sensor.merging
    azimuth_deg, elevation_deg, _ = directions(look.own_m)
    order = np.argsort(look.looks.t_utc_ns, kind="stable")
    near = np.zeros(len(order), np.bool_)
    for step in range(1, len(order)):
        a, b = order[:-step], order[step:]
        soon = look.looks.t_utc_ns[b] - look.looks.t_utc_ns[a] <= sensor.scan.period_s * 5e8
        if not soon.any():
            break
        a, b = a[soon], b[soon]
        apart2 = np.zeros(len(a))
        if not _is_passive(sensor):  # whose ways may be as long at any distance
            width_m = keys.range_m or sensor.range_resolution_m
            apart2 = ((look.range_m[a] - look.range_m[b]) / width_m) ** 2
        off_deg = folded_180(azimuth_deg[a] - azimuth_deg[b])
        apart2 = apart2 + (off_deg / (keys.azimuth_deg or sensor.azimuth_beamwidth_deg)) ** 2
        if getattr(sensor, "measures_elevation", False):
            width_deg = keys.elevation_deg or sensor.elevation_beamwidth_deg
            apart2 = apart2 + ((elevation_deg[a] - elevation_deg[b]) / width_deg) ** 2
        close = (apart2 <= APART**2) & (look.channel[a] == look.channel[b])
        close &= look.looks.drone[a] != look.looks.drone[b]
        near[a[close]] = near[b[close]] = True
    look.doubt("merging with another target", near)


def _radar(look: _Look) -> dict[str, Floats]:
    """A radar (eqs 1 to 36), by the sum of its signals or by each of them, a channel a signal.

    Of several receivers each pair with a transmitter detects alone, and places are made of that.
    """
    sensor: Any = look.sensor
    is_passive, is_steered = _is_passive(sensor), sensor.scan.kind == "electronic"
    pulses, several = getattr(sensor, "pulses", None), getattr(sensor, "receivers", None)
    ends_m = [np.zeros(3), *map(look.offset_m, several or ())]
    snrs = np.concatenate([_echoes(look, m) * _on_the_way(look, m) for m in ends_m], axis=1)
    rows, frequency_hz = np.arange(len(snrs)), _signals_hz(sensor)[0]
    channel = look.channel if is_passive else 0 * look.channel
    if is_passive:  # behind the correlator, where an echo disturbs itself: BT is the most (eq 25)
        samples = sensor.integration_s * np.tile(_signals_hz(sensor)[1], len(ends_m))
        snrs = samples / (1 + 1 / snrs)
    if is_passive or several is not None:
        snrs = snrs[rows, look.channel][:, None]
    every = _intervals(look)[:, :, None] * snrs[:, None]
    n, count, signals = every.shape
    if getattr(sensor, "mount", None) is not None and (sensor.antenna or sensor.jamming):
        look.doubt("where a mount turns an antenna")
    if is_steered:
        searched = every * _search_gain(look)[:, None, None]
        steered = _steered(look, every[:, 0, 0], searched[:, 0, 0])
        every = searched
    found = [_detected(look, every[:, i], signals) for i in range(count)]
    each, inverse = (np.stack(column, axis=1) for column in zip(*found, strict=True))
    needed = 1 if pulses is None else pulses.needed
    pd = at_least(each, needed)
    if count > 1:
        inverse = inverse * _first_hits(each, needed)
    if sensor.doppler is not None:
        rate_m_s = look.rate_m_s()
        if is_passive:
            of_sent = np.stack([look.rate_m_s(m) for m in look.sent_m], axis=-1)
            rate_m_s = rate_m_s + of_sent[rows, channel]
        pd = pd * _passed(look, rate_m_s, (LIGHT_M_S / frequency_hz)[channel])
    told = {"snr_db": 10 * np.log10(every.reshape(n, -1).mean(axis=1))}
    if is_steered:
        pd = np.where(look.channel == 0, pd, steered)
        told["pd_off"] = OF_AIM * (look.channel > CONFIRMATION)
    _merged(look)
    if several is None:
        # Of errors that go as 1/x, the mean square is that at the mean of 1/x.
        told |= stated_sigmas(sensor, 1 / inverse.sum(axis=1), look.channel)
    elif look.looks.detected is not None:
        told["joined"] = _joined(look, np.array(ends_m), snrs)
    return told | {"pd": pd}


def _joined(look: _Look, ends_m: Floats, snr: Floats) -> JoinedErrors:
    """How places of several receivers err: of least squares over the pairs that detected, (n, 1).

    Heights that the sensor expects are one more measurement, with an error that stays: so places
    are off, and err about that by less than they state. Nothing is known of targets whose
    detections may not be taken for those of one, and of what the expected height decides.
    """
    sensor: Any = look.sensor
    number, channel = np.divmod(look.channel, len(look.sent_m))
    detected = np.asarray(look.looks.detected, np.float64)
    weight = detected[:, None, None] / _drawn_variances(sensor, snr, channel[:, None])
    together = np.stack([look.looks.t_utc_ns, look.of])
    _, first, of = np.unique(together, axis=1, return_index=True, return_inverse=True)
    order = np.argsort(of := of.reshape(-1), kind="stable")
    begins = np.searchsorted(of[order], np.arange(len(first)))

    def summed(rows: Floats) -> Floats:
        """Sums of rows over the looks at each target."""
        return np.asarray(np.add.reduceat(rows[order], begins))

    true_m, known = look.place_m[first], weight.mean(axis=1)
    expects = np.diag([NOTHING, NOTHING, sensor.sigma_height_m**-2])
    stations_m, measures = (look.sent_m[channel], ends_m[number]), known.shape[1]
    true, place_m = _measured(look.place_m, stations_m)[0][:, :measures], true_m.copy()
    for _ in range(STEPS):  # by Gauss and Newton
        told, slope = (each[:, :measures] for each in _measured(place_m[of], stations_m))
        off = true - told
        off[:, 1:] = np.radians(folded_180(np.degrees(off[:, 1:])))
        lower_m = sensor.expected_height_m - place_m[:, 2]
        matrix = summed(np.einsum("nq,nqi,nqj->nij", known, slope, slope)) + expects
        pull = summed(np.einsum("nq,nq,nqi->ni", known, off, slope))
        pull += lower_m[:, None] * expects[2]
        place_m += np.linalg.solve(matrix, pull[..., None])[..., 0]
    square = summed((known * off**2).sum(axis=1)) + (lower_m / sensor.sigma_height_m) ** 2
    # Of each draw: how uncertain places are, and how much of that is noise.
    by_noise = summed(np.einsum("nsq,nqi,nqj->nsij", weight, slope, slope))
    stated = np.linalg.inv(by_noise + expects)
    by_height = stated[..., 2].mean(axis=1) - np.linalg.inv(matrix)[..., 2]
    lower_m = sensor.expected_height_m - true_m[:, 2]
    place_m += by_height * (lower_m / sensor.sigma_height_m**2)[:, None]
    axes = _polar_axes(place_m)
    noise, stated = (
        np.einsum("gai,gsij,gaj->gsa", axes, each, axes)
        for each in (stated @ by_noise @ stated, stated)
    )
    variance, shift = noise.mean(axis=1), _polar(place_m) - _polar(true_m)
    shift[:, 1] = folded_180(shift[:, 1])
    pairs = summed(detected)
    free = np.maximum(pairs * measures + 1 - 3, 1)
    gate = stats.chi2.isf(THREE_SIGMAS, free)
    errs2 = 1.0 if sensor.degradation is None else sensor.degradation.error_factor**2
    refused = stats.ncx2.sf(gate / errs2, free, square / errs2)
    is_usual = np.array([_order(each.swerling, 1) == 1 for each in look.signatures])[look.of]
    doubted = (pairs < sensor.fewest_pairs) | (refused > MOST_REFUSED)
    doubted |= summed(1.0 - (look.known & is_usual)) > 0
    unknown = doubted[:, None] | (shift**2 > variance)
    kurtosis = 3 * (noise**2).mean(axis=1) / variance**2
    told = np.sqrt(stated.mean(axis=1))
    errs, told = (np.where(unknown, np.nan, each) for each in (variance * errs2, told))
    return JoinedErrors(np.stack([shift, errs, kurtosis], axis=1)[of], told[of])


def _drawn_variances(sensor: Any, snr: Floats, channel: Ints) -> Floats:
    """Variances of what pairs measure, by some ratios of detections that are drawn; (n, S, 2 or 3).

    Of the sum of ranges, m2, azimuth and, where it is measured, elevation, rad2. The power of an
    exponential law over a threshold, which is a gamma variable scaled (eq 6).
    """
    rng, shape = np.random.default_rng(0), (len(snr), DRAWN)
    ratio, mean = cfar_ratio(sensor.pfa, 1, sensor.n_reference), 1 + snr
    threshold = rng.gamma(sensor.n_reference, ratio / (1 + ratio / mean), shape)
    sigmas = stated_sigmas(sensor, threshold + mean * rng.exponential(size=shape), channel)
    range_m, *angles_deg = sigmas.values()
    if not _is_passive(sensor):  # whose own is of the distance, half of the sum
        range_m = 2 * range_m
    return np.stack([range_m, *np.radians(angles_deg)], axis=-1) ** 2


def _measured(place_m: Floats, stations_m: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """What pairs of transmitter and receiver measure of places, (n, 3), and its slopes, (n, 3, 3).

    The sum of both distances, m, and azimuth and elevation from the receiver, rad.
    """
    out_m, back_m = (place_m - each for each in stations_m)
    sent_m, received_m = length(out_m), length(back_m)
    ground_m = np.hypot(back_m[:, 0], back_m[:, 1])
    azimuth, elevation = np.arctan2(back_m[:, 0], back_m[:, 1]), np.arctan2(back_m[:, 2], ground_m)
    axes = _polar_axes(back_m)
    slopes = [axes[:, 0] + out_m / sent_m[:, None], *np.radians(np.moveaxis(axes[:, 1:3], 1, 0))]
    told = np.stack([sent_m + received_m, azimuth, elevation], axis=1)
    return told, np.stack(slopes, axis=1)


def _polar(place_m: Floats) -> Floats:
    """Range, azimuth, elevation and height of places; (n, 4)."""
    azimuth_deg, elevation_deg, range_m = directions(place_m)
    return np.stack([range_m, azimuth_deg, elevation_deg, place_m[:, 2]], axis=1)


def _polar_axes(place_m: Floats) -> Floats:
    """How range, azimuth, elevation (degrees) and height change with places; (n, 4, 3)."""
    range_m, ground_m = length(place_m)[:, None], np.hypot(place_m[:, 0], place_m[:, 1])[:, None]
    along, up = place_m / range_m, np.broadcast_to([0.0, 0.0, 1.0], place_m.shape)
    right = np.stack([place_m[:, 1], -place_m[:, 0], 0 * place_m[:, 2]], axis=1) / ground_m
    above = np.cross(right, along)
    return np.stack([along, np.degrees(right / ground_m), np.degrees(above / range_m), up], axis=1)


def _first_hits(pd: Floats, needed: int) -> Floats:
    """Chance of each trial to be the first that succeeds, where at least so many do."""
    found, missed = np.empty_like(pd), np.ones(len(pd))
    for i in range(pd.shape[1]):
        found[:, i] = missed * pd[:, i] * at_least(pd[:, i + 1 :], needed - 1)
        missed = missed * (1 - pd[:, i])
    return found / at_least(pd, needed)[:, None]


def _search_gain(look: _Look) -> Floats:
    """What search leaves of echoes: two ways of the beam in whose part of the cover they are.

    Looks at tracks point to where the radar itself took a target to be.
    """
    sensor: Any = look.sensor
    azimuth_deg, elevation_deg, _ = directions(look.own_m)
    low, high = sensor.elevation_min_deg, sensor.elevation_max_deg
    span = min(sensor.azimuth_max_deg - sensor.azimuth_min_deg, 360.0)
    level = np.cos(np.radians(elevation_deg))
    off2: Any = 0.0
    for angle, cover, width, level_or_1 in (
        ((azimuth_deg - sensor.azimuth_min_deg) % 360, span, sensor.azimuth_beamwidth_deg, level),
        (elevation_deg - low, high - low, sensor.elevation_beamwidth_deg, 1.0),
    ):
        beams = max(int(np.ceil(cover / (sensor.scan.beam_spacing * width) - 1e-9)), 1)
        step = cover / beams
        nearest = np.clip(np.floor(angle / step), 0, beams - 1)
        off2 = off2 + ((angle - (nearest + 0.5) * step) * level_or_1 / width) ** 2
    return linear(-2 * ONE_WIDTH_DB * off2)


def _steered(look: _Look, aimed: Floats, searched: Floats) -> Floats:
    """Pd of looks that confirm what search found, and of those at the radar's own tracks; (n,).

    Looks confirm the very echo that was detected, at the place where that was measured; tracks are
    straight lines through the last ten plots. Within a period a target is as strong as it is: Pd is
    the mean over strengths, weighed by how often search detects them, and over errors of the aim.
    Ratios are those of a beam on the target, and of the one that searches it.
    """
    sensor: Any = look.sensor
    grid_db = np.arange(-30.0, 80.0, 0.05)
    table = fluctuating(linear(grid_db), STEADY, sensor.pfa, 1, sensor.n_reference)

    def of_steady(snr: Floats) -> tuple[Floats, Floats]:
        pd, inverse = (np.interp(10 * np.log10(snr), grid_db, column) for column in table)
        return pd, inverse

    node, weight = _unit_interval(32)
    node, weight = 1 - node**3, 3 * node**2 * weight  # closer where targets are strong
    orders = [_order(each.swerling, 1) for each in look.signatures]
    of_order = {k: special.gammaincinv(k, node) / k for k in {*orders} - {STEADY}}
    strength = np.array([of_order.get(k, np.ones(len(node))) for k in orders])[look.of]
    confirms = (look.channel == CONFIRMATION)[:, None]
    found, inverse = of_steady(np.where(confirms, searched[:, None], aimed[:, None]) * strength)
    before = np.where(confirms, found, 1.0)
    spread = np.where(confirms[:, 0], 1.0, np.sqrt(_aim_variance(look)))[:, None]
    if sensor.degradation is not None:
        spread = spread * sensor.degradation.error_factor
    sigmas = stated_sigmas(sensor, 1 / inverse, 0 * look.channel[:, None])
    level = np.cos(np.radians(directions(look.own_m)[1]))[:, None]
    across = spread * level * sigmas["sigma_azimuth_deg"] / sensor.azimuth_beamwidth_deg
    upwards = spread * sigmas["sigma_elevation_deg"] / sensor.elevation_beamwidth_deg
    after: Floats = np.zeros_like(before)
    off, share = np.polynomial.hermite_e.hermegauss(5)
    for (x, a), (y, b) in product(zip(off, share, strict=True), repeat=2):
        left = linear(-2 * ONE_WIDTH_DB * ((x * across) ** 2 + (y * upwards) ** 2))
        after += a * b / (2 * np.pi) * of_steady(aimed[:, None] * strength * left)[0]
    return np.asarray(((before * after) @ weight) / (before @ weight))


def _aim_variance(look: _Look) -> Floats:
    """Variance of where tracks are expected over that of their plots, along each axis; (n,).

    Of a line through n plots, one step on, 2 (2n + 1)/(n (n - 1)); from ten on, of a filter of the
    gains a and b, (2a^2 + 2b + ab)/(a (4 - 2a - b)) (Kalata 1984), which lags acceleration by T^2/b
    of it.
    """
    sensor: Any = look.sensor
    found, t_s = np.ones(len(look.channel)), look.looks.t_utc_ns / 1e9
    at_tracks = look.channel > CONFIRMATION
    _, at, together = np.unique(t_s[at_tracks], return_inverse=True, return_counts=True)
    doubted = at_tracks.copy()
    doubted[at_tracks] = (together > 1)[at]  # which of them the beam was aimed at
    for number in np.unique(look.of[at_tracks]).tolist():
        mine = np.flatnonzero((look.of == number) & at_tracks)
        mine = mine[np.argsort(t_s[mine], kind="stable")]
        rows, step_s = np.arange(len(mine)), np.diff(t_s[mine], prepend=-np.inf)
        begins = np.maximum.accumulate(np.where(step_s > 3 * np.median(step_s), rows, 0))
        n = np.clip(rows - begins + 1, 2, 10)
        a, b = 2 * (2 * n - 1) / (n * (n + 1)), 6 / (n * (n + 1))
        settled = (2 * a * a + 2 * b + a * b) / (a * (4 - 2 * a - b))
        found[mine] = np.where(n < 10, 2 * (2 * n + 1) / (n * (n - 1)), settled)
        speed = np.diff(look.place_m[mine], axis=0, prepend=np.nan) / step_s[:, None]
        lag_m = length(np.diff(speed, axis=0, prepend=np.nan)) * step_s / b
        most_m = ndimage.maximum_filter1d(np.nan_to_num(lag_m), 19)
        lag_deg = np.degrees(most_m / look.range_m[mine])
        doubted[mine] |= (n < 4) | (lag_deg > LAGS * sensor.azimuth_beamwidth_deg)
    look.doubt("where a steered beam pointed", doubted)
    return found


# Microphones.


def _sound(sensor: Any, place_m: Floats, power_db: Floats) -> Floats:
    """Signal-to-noise ratio behind an array, dB, of sounds from places (eqs 37 to 42)."""
    range_m = np.maximum(length(place_m), NEAREST_M)
    kelvin, pressure = sensor.temperature_c + 273.15, sensor.pressure_kpa / 101.325
    if sensor.absorption_db_per_km is not None:
        absorbed_db_m = sensor.absorption_db_per_km / 1000
    else:  # ISO 9613-1
        f, warmth = sensor.frequency_hz, kelvin / 293.15
        saturated = 10 ** (-6.8346 * (273.16 / kelvin) ** 1.261 + 4.6151)
        h = sensor.humidity_pct * saturated / pressure
        oxygen_hz = pressure * (24 + 4.04e4 * h * (0.02 + h) / (0.391 + h))
        nitrogen = 9 + 280 * h * np.exp(-4.17 * (warmth ** (-1 / 3) - 1))
        nitrogen_hz = pressure * warmth**-0.5 * nitrogen
        relaxed = 0.01275 * np.exp(-2239.1 / kelvin) / (oxygen_hz + f * f / oxygen_hz)
        relaxed += 0.1068 * np.exp(-3352 / kelvin) / (nitrogen_hz + f * f / nitrogen_hz)
        absorbed_db_m = 8.686 * f * f * (1.84e-11 / pressure * warmth**0.5 + warmth**-2.5 * relaxed)
    own_m = sensor.height_above_ground_m
    mean_m = (np.maximum(place_m[:, 2] + own_m, 0) + own_m) / 2
    ground_db = np.maximum(4.8 - 2 * mean_m / range_m * (17 + 300 / range_m), 0)
    lost_db = 20 * np.log10(range_m) + 11 + absorbed_db_m * range_m + ground_db
    level_db = power_db + sensor.directivity_db - lost_db - sensor.barrier_db - sensor.misc_db
    gain_db = sensor.array_gain_db
    if gain_db is None:
        gain_db = 10 * np.log10(sensor.microphones)
    noise = linear(sensor.noise_db)
    if sensor.weather is not None and sensor.weather.wind_m_s:
        wind = sensor.weather.wind_m_s  # in a third of an octave (Strasberg 1988)
        strouhal = sensor.frequency_hz * sensor.windscreen_m / wind
        noise = noise + linear(40 * np.log10(wind) - 23 * np.log10(strouhal) + 15)
    return np.asarray(level_db + gain_db - 10 * np.log10(noise))


def _sound_speed_m_s(sensor: Any) -> float:
    return float(343.2 * np.sqrt((sensor.temperature_c + 273.15) / 293.15))


def _bearing_sigmas(sensor: Any, snr_db: Floats, place_m: Floats) -> tuple[Floats, Floats]:
    """Errors of azimuth and elevation of an array, by beams or by where its microphones lie."""
    share = 1 / np.sqrt(2 * linear(snr_db))
    tells_elevation = sensor.elevation_beamwidth_deg is not None
    if sensor.layout is None:
        noise_az = share * sensor.azimuth_beamwidth_deg / 1.6
        noise_el = share * (sensor.elevation_beamwidth_deg or np.nan) / 1.6
    else:
        noise_az, noise_el = _layout_sigmas(sensor, share, place_m)
    azimuth = np.hypot(noise_az, sensor.azimuth_floor_deg)
    elevation = np.hypot(noise_el, sensor.elevation_floor_deg)
    return azimuth, elevation if tells_elevation else np.full(len(azimuth), np.nan)


def _layout_sigmas(sensor: Any, share: Floats, place_m: Floats) -> tuple[Floats, Floats]:
    """The Cramer-Rao bound of one plane wave at microphones that lie level."""
    keys, n = sensor.layout, sensor.microphones
    if keys.shape == "circle":
        turn = 2 * np.pi * np.arange(n) / n
        spots = (
            np.stack([np.cos(turn), np.sin(turn)], -1) * keys.spacing_m / (2 * np.sin(np.pi / n))
        )
    else:
        rows = 1
        if keys.shape == "rectangle":
            rows = max(d for d in range(1, int(np.sqrt(n)) + 1) if n % d == 0)
        spots = np.stack(np.divmod(np.arange(n), rows), -1) * keys.spacing_m
        spots = spots - spots.mean(axis=0)
    axis = np.radians(keys.azimuth_deg)
    ahead, right = np.array([np.sin(axis), np.cos(axis)]), np.array([np.cos(axis), -np.sin(axis)])
    spots = spots @ np.stack([ahead, right])  # east and north
    wave = 2 * np.pi * sensor.frequency_hz / _sound_speed_m_s(sensor)
    azimuth_deg, elevation_deg, _ = directions(place_m)
    az, el = np.radians(azimuth_deg), np.radians(elevation_deg)
    if keys.shape == "line":
        spread = share / (wave * np.sqrt(np.mean((spots @ ahead) ** 2)))
        sine2 = 1 - (np.cos(el) * np.cos(az - axis)) ** 2
        return np.degrees(spread / np.sqrt(sine2 + spread)), np.full(len(az), np.nan)
    spread2 = np.linalg.inv(wave**2 * spots.T @ spots / n)
    along, across = (
        share * np.sqrt(np.einsum("in,ij,jn->n", v, spread2, v))
        for v in (np.stack([np.sin(az), np.cos(az)]), np.stack([np.cos(az), -np.sin(az)]))
    )
    upwards = along / np.sqrt(np.sin(el) ** 2 + along)
    return np.degrees(across / np.hypot(np.cos(el), across)), np.degrees(upwards)


def _heard(sensor: Any, snr_db: Floats) -> Floats:
    over_db = snr_db - sensor.sensitivity_db
    return np.asarray(special.expit(sensor.slope_per_db * over_db))  # eq 43


def _array(
    look: _Look, place_m: Floats, own_m: Floats, base_m: Any = 0.0
) -> tuple[Floats, Floats, Floats]:
    """What an array off the sensor by `base_m` hears of places that are seen from it.

    The ratio, dB, and the errors of azimuth and elevation along its own axes.
    """
    sensor: Any = look.sensor
    snr_db = _sound(sensor, place_m, look.each("sound_power_db"))
    wavelength_m = _sound_speed_m_s(sensor) / sensor.frequency_hz
    snr_db = snr_db + 10 * np.log10(look.behind(place_m + base_m, wavelength_m, base_m))
    return snr_db, *_bearing_sigmas(sensor, snr_db, own_m)


def _acoustic(look: _Look) -> dict[str, Floats]:
    """A microphone array: a drone is heard where it was when its sound left it."""
    snr_db, azimuth, elevation = _array(look, look.place_m, look.own_m)
    return {
        "pd": _heard(look.sensor, snr_db),
        "snr_db": snr_db,
        "sigma_azimuth_deg": azimuth,
        "sigma_elevation_deg": elevation,
    }


def _pair(look: _Look) -> dict[str, Floats]:
    """Two arrays, both of which have to hear; bearings cross over the ground."""
    sensor: Any = look.sensor
    found = _acoustic(look)
    base_m = look.offset_m(sensor.second_array)
    there_m = look.place_m - base_m
    # The sound for the second array left earlier or later, by t: |there + v t| = c (T - t).
    speed = _sound_speed_m_s(sensor)
    wait_s = length(look.place_m) / speed
    square = (look.velocity**2).sum(axis=1) - speed**2
    half = (there_m * look.velocity).sum(axis=1) + speed**2 * wait_s
    rest = (there_m**2).sum(axis=1) - (speed * wait_s) ** 2
    later_s = (half - np.sqrt(half**2 - square * rest)) / -square
    later_s = np.where(np.isfinite(later_s), later_s, rest / (-2 * half))
    there_m = there_m + look.velocity * later_s[:, None]
    snr_db, second, _ = _array(look, there_m, there_m, base_m)
    one, other = (np.radians(directions(m)[0]) for m in (look.place_m, there_m))
    sine = np.sin(one - other)
    near_m = (base_m[0] * np.cos(other) - base_m[1] * np.sin(other)) / sine
    far_m = (base_m[0] * np.cos(one) - base_m[1] * np.sin(one)) / sine
    along = near_m * np.radians(found["sigma_azimuth_deg"]) / np.tan(one - other)
    worse = 1.0 if sensor.degradation is None else sensor.degradation.pd_factor
    return found | {
        "pd": found["pd"] * _heard(sensor, snr_db) * worse,
        "sigma_range_m": np.hypot(along, far_m * np.radians(second) / sine),
        "sigma_elevation_deg": np.full(len(sine), np.nan),
    }


# Receivers of emissions.

# 10.1109/LWC.2014.2342736: a and b of the chance of sight, losses in dB with it and without.
CITIES = {
    "suburban": (4.88, 0.43, 0.1, 21),
    "urban": (9.61, 0.16, 1, 20),
    "dense-urban": (12.08, 0.11, 1.6, 23),
    "high-rise": (27.23, 0.08, 2.3, 34),
}


def _rf(look: _Look) -> dict[str, Floats]:
    """An energy detector and an interferometer, a channel an emitter."""
    sensor: Any = look.sensor
    emitted = np.full((3, len(look.range_m)), np.nan)
    for number, signature in enumerate(look.signatures):
        for channel, emitter in enumerate(signature.emitters):
            mine = (look.of == number) & (look.channel == channel)
            told = [emitter.frequency_hz, emitter.bandwidth_hz, emitter.eirp_dbm]
            emitted[:, mine] = np.array(told)[:, None]
    frequency_hz, width_hz, eirp_dbm = emitted
    low_hz, high_hz = sensor.frequency_min_hz, sensor.frequency_max_hz
    within_hz = np.minimum(frequency_hz + width_hz / 2, high_hz)
    within_hz = within_hz - np.maximum(frequency_hz - width_hz / 2, low_hz)
    share = np.where(width_hz > 0, np.clip(within_hz / width_hz, 0, 1), within_hz >= 0)
    snr = share * _emission_snr(look, frequency_hz, eirp_dbm)
    samples = max(round(sensor.channel_bandwidth_hz * sensor.integration_s), 1)
    at_once_hz = sensor.instantaneous_bandwidth_hz or high_hz - low_hz
    tuned = np.minimum(at_once_hz / np.maximum(within_hz, 1e-9), 1)
    missed = (1 - sensor.duty_cycle * tuned) ** sensor.bursts_per_dwell
    threshold = float(special.gammainccinv(samples, sensor.pfa))
    crossed = special.gammaincc(samples, threshold / (1 + snr))
    found = {"pd": (1 - missed) * crossed, "snr_db": 10 * np.log10(snr)}
    if not sensor.measures_azimuth:
        return found
    turns_m = LIGHT_M_S / frequency_hz / (2 * np.pi)
    turns_m = turns_m * np.sqrt(_phase_variance(snr, samples, threshold))
    noise_deg = np.degrees(turns_m / sensor.baseline_m)
    found["sigma_azimuth_deg"] = np.hypot(noise_deg, sensor.azimuth_floor_deg)
    if sensor.elevation_baseline_m is not None:
        sine = turns_m / sensor.elevation_baseline_m
        level = np.cos(np.radians(directions(look.own_m)[1]))
        noise_deg = np.degrees(sine / np.hypot(level, sine))
        found["sigma_elevation_deg"] = np.hypot(noise_deg, sensor.elevation_floor_deg)
    return found


def _emission_snr(look: _Look, frequency_hz: Floats, eirp_dbm: Floats) -> Floats:
    """Ratio of a sample of emissions, to the receiver's noise and jammers."""
    sensor: Any = look.sensor
    wavelength_m, path = LIGHT_M_S / frequency_hz, sensor.path_loss
    straight_m, beyond_db = look.range_m, np.zeros(len(frequency_hz))
    if path.kind == "log-distance":
        straight_m = np.minimum(look.range_m, path.reference_m)
        beyond_db = 10 * path.exponent * np.log10(look.range_m / straight_m)
    lost_db = np.maximum(20 * np.log10(4 * np.pi * straight_m / wavelength_m) + beyond_db, 0)
    if path.kind == "city":
        a, b, in_sight_db, hidden_db = CITIES[path.environment]
        chance = special.expit(b * (directions(look.place_m)[1] - a) - np.log(a))
        lost_db = lost_db + np.where(chance > 0.5, in_sight_db, hidden_db)
        drawn = np.minimum(chance, 1 - chance) > 1e-9
        look.doubt("whether houses hide a drone", drawn | bool(path.shadowing_db))
    heard_w = linear(eirp_dbm - 30 + sensor.gain_rx_dbi - sensor.loss_db - lost_db)
    density_w_hz: Any = thermal_w_hz(sensor.noise_figure_db)
    for jammer in sensor.jamming.values():
        far_m, at_hz = float(length(look.offset_m(jammer))), np.array([jammer.frequency_hz])
        over = _jammer_over(jammer, far_m, sensor.gain_rx_dbi, at_hz, np.ones(1))
        over = over * look.behind(look.offset_m(jammer)[None], LIGHT_M_S / at_hz)
        beside_hz = np.abs(frequency_hz - jammer.frequency_hz)
        density_w_hz = density_w_hz + np.where(beside_hz <= jammer.bandwidth_hz / 2, over, 0)
    way = look.way(look.place_m, wavelength_m, 0.0, np.zeros(3))
    return np.asarray(heard_w * way / (density_w_hz * sensor.channel_bandwidth_hz))


def _phase_variance(snr: Floats, samples: int, threshold: float) -> Floats:
    """Mean variance of the phase between two channels, by the ratio that each detection shows.

    (1 + 1/2S)/(S M) for M samples of S times the noise, over the energies that cross.
    """
    known = np.isfinite(snr) & (snr > 0)
    found = np.full(len(snr), np.nan)
    if not known.any():
        return found
    low, high = np.log(snr[known].min()), np.log(snr[known].max())
    grid = np.exp(np.linspace(low, max(high, low + 1e-9), 65 if known.sum() > 65 else known.sum()))
    at = grid if known.sum() > 65 else snr[known]
    part, weight = _unit_interval(64)
    tail = special.gammaincc(samples, threshold / (1 + at))[:, None]
    energy = (1 + at)[:, None] * special.gammainccinv(samples, (1 - part**3) * tail)
    shown = np.maximum(np.maximum(energy, threshold) / samples - 1, 1e-12)
    mean = ((1 + 0.5 / shown) / (shown * samples)) @ (3 * part**2 * weight)
    if known.sum() > 65:
        from scipy.interpolate import CubicSpline

        mean = np.exp(CubicSpline(np.log(grid), np.log(mean))(np.log(snr[known])))
    found[known] = mean
    return found


# Cameras and range gates.


def _camera(look: _Look) -> dict[str, Floats]:
    """Pixels on a target, half as many cycles, and how often these suffice (Johnson)."""
    sensor: Any = look.sensor
    field_deg, mount = sensor.horizontal_fov_deg, sensor.mount
    if mount is not None and zooms(sensor):
        field_deg = look.looks.field_deg
        field_deg = np.full(len(look.range_m), np.nan) if field_deg is None else field_deg
        look.doubt("the zoom of a mount", np.isnan(field_deg))
    pixel = 2 * np.tan(np.radians(field_deg) / 2) / sensor.pixels_across
    if sensor.horizontal_fov_deg > 120:
        pixel = np.radians(sensor.horizontal_fov_deg) / sensor.pixels_across
    size_m, range_m = look.each("size_m"), look.range_m
    cycles = size_m / (range_m * pixel) / 2
    visible = np.exp(-np.log(20) * range_m / (sensor.visibility_m or 1e9))
    contrast = sensor.day_contrast
    if sensor.night and sensor.night_contrast is not None:
        contrast = sensor.night_contrast
    if contrast is not None or sensor.visibility_m is not None:
        left = np.log((contrast or 1.0) * visible / sensor.threshold_contrast)
        steps = np.log(sensor.nyquist_contrast / sensor.threshold_contrast)
        cycles = cycles * np.clip(left / steps, 0, 1)
    x = cycles / sensor.detect_cycles
    power = x ** (2.7 + 0.7 * x)
    pd = np.where(np.isfinite(power), power / (1 + power), 1.0)
    if sensor.hotter_k is not None:
        filled = np.minimum((size_m / (range_m * pixel)) ** 2, 1)
        ratio = sensor.hotter_k * visible * filled / (sensor.netd_mk / 1000)
        pfa = sensor.false_alarms_per_frame / (sensor.pixels_across * sensor.pixels_down)
        pd = stats.norm.sf(stats.norm.isf(pfa) - ratio)
    pd = np.where(np.isnan(size_m), np.nan, pd)
    blur = np.degrees(sensor.pixel_error * pixel)
    level = np.cos(np.radians(directions(look.own_m)[1]))
    found = {"pd": pd}
    if mount is None:
        found["sigma_azimuth_deg"] = np.hypot(blur / level, sensor.pointing_error_deg)
        found["sigma_elevation_deg"] = np.full(len(pd), np.hypot(blur, sensor.pointing_error_deg))
    return found


def zooms(sensor: Any) -> bool:
    """Whether a camera has several fields of view."""
    mount = getattr(sensor, "mount", None)
    ends = () if mount is None else (mount.fov_min_deg, mount.fov_max_deg)
    return bool({*ends} - {None, getattr(sensor, "horizontal_fov_deg", None)})


def field_of_view_deg(sensor: Any, sigma_elevation_deg: Floats) -> Floats:
    """Fields of view of a camera at which plots state those errors; (n,)."""
    blur2 = sigma_elevation_deg**2 - sensor.pointing_error_deg**2
    pixel = np.radians(np.sqrt(np.maximum(blur2, 0))) / sensor.pixel_error
    return np.asarray(2 * np.degrees(np.arctan(pixel * sensor.pixels_across / 2)))


def _gate(look: _Look) -> dict[str, Floats]:
    """All within range, with as much noise east, north and up: errors to first order."""
    sigma_m = look.sensor.sigma_m  # type: ignore[attr-defined]
    across = np.degrees(sigma_m / look.range_m)
    level = np.cos(np.radians(directions(look.own_m)[1]))
    return {
        "pd": np.ones(len(across)),
        "sigma_range_m": np.full(len(across), sigma_m),
        "sigma_azimuth_deg": across / level,
        "sigma_elevation_deg": across,
    }


KINDS: dict[str, Callable[[_Look], dict[str, Floats]]] = {
    "acoustic": _acoustic,
    "acoustic_pair": _pair,
    "active_radar": _radar,
    "camera": _camera,
    "mimo_radar": _radar,
    "multistatic_mimo": _radar,
    "multistatic_passive": _radar,
    "passive_radar": _radar,
    "range_gate": _gate,
    "rf": _rf,
}


# False alarms.


def false_alarms_per_scan(scene: Scene, sensor: Any) -> tuple[float, str]:
    """Mean number of plots of nothing in a scan (eq 9); NaN, and why, where that is not known.

    Cells of what a sensor resolves times the chance that one alarms. Plots of a scene's clutter and
    of side lobes are of something, and not counted.
    """
    why = ""
    if sensor.type in {"acoustic_pair", "multistatic_mimo", "multistatic_passive"}:
        why = "ghosts: detections that are joined wrongly"
    elif sensor.type not in KINDS:
        why = f"sensors of type {sensor.type}"
    elif sensor.type == "range_gate" or sensor.scan.kind == "electronic":  # which confirms none
        return 0.0, ""
    elif getattr(sensor, "mount", None) is not None:
        why = "scans in which a mount turns"
    if why:
        return np.nan, why
    worse = 1.0 if sensor.degradation is None else sensor.degradation.false_alarm_factor
    return _alarms(scene, sensor) * worse, ""


def _alarms(scene: Scene, sensor: Any) -> float:
    """False alarms of a scan of a sensor as it was built."""
    kind = sensor.type
    if kind == "camera":
        return float(sensor.false_alarms_per_frame)
    span_deg = min(sensor.azimuth_max_deg - sensor.azimuth_min_deg, 360.0)
    beams = max(span_deg / (sensor.azimuth_beamwidth_deg or span_deg), 1)
    if kind == "acoustic":  # from horizon to zenith
        return float(sensor.pfa * beams * max(90 / (sensor.elevation_beamwidth_deg or 90), 1))
    if kind == "rf":  # channels that are received at once
        band_hz = sensor.frequency_max_hz - sensor.frequency_min_hz
        width_hz = sensor.instantaneous_bandwidth_hz or band_hz
        beams = beams if sensor.measures_azimuth else 1.0
        return float(sensor.pfa * beams * max(width_hz / sensor.channel_bandwidth_hz, 1))
    if kind == "passive_radar":
        return float(beams * sensor.doppler_cells * _passive_alarms(scene, sensor, span_deg))
    far_m, pfa = sensor.range_max_m, sensor.pfa
    if sensor.pulses is not None:
        prf_hz, count = _folding_prf_hz(sensor), _intervals_of(sensor)
        far_m = far_m if prf_hz is None else min(far_m, LIGHT_M_S / (2 * prf_hz))
        pfa = float(stats.binom.sf(sensor.pulses.needed - 1, count, pfa))
    height_deg = sensor.elevation_max_deg - sensor.elevation_min_deg
    cells = beams * max(height_deg / sensor.elevation_beamwidth_deg, 1) * sensor.doppler_cells
    return float(pfa * cells * max((far_m - sensor.range_min_m) / sensor.range_resolution_m, 1))


def _passive_alarms(scene: Scene, sensor: Any, span_deg: float) -> float:
    """Alarms of a beam in cells of bistatic range that have a place within range on the ground."""
    axes, most_m, total = LevelAxes.of_sensor(scene, sensor), sensor.range_max_m, 0.0
    azimuth_deg = sensor.azimuth_min_deg + (np.arange(36_000) + 0.5) / 36_000 * span_deg
    for source in sensor.transmitters:
        sent_m = axes.of(scene.scene.site, source.place)
        low_m, high_m = (
            np.minimum(length(place_m - sent_m) + length(place_m) - length(sent_m), most_m).mean()
            for place_m in (places(azimuth_deg, 0.0, r) for r in (sensor.range_min_m, most_m))
        )
        cells = max(most_m * source.bandwidth_hz / LIGHT_M_S, 1)
        total += sensor.pfa * cells * (high_m - low_m) / most_m
    return float(total)


# Links: netem's laws of delay, and its chains of loss.


def delays_ms(link: Any, share: Floats) -> Floats:
    """The delays that those shares of messages do not exceed; (n,)."""
    if link.delays_ms is not None:
        return np.asarray(link.latency_ms + np.quantile(link.delays_ms, share))
    normal = np.clip(stats.norm.ppf(share), -4, 4)
    pareto = np.minimum((stats.pareto.ppf(share, 3) - 1.5) * 4 / 3, 4)  # as iproute2 scales it
    shapes = {"normal": normal, "uniform": 2 * share - 1, "pareto": pareto}
    shapes["paretonormal"] = normal / 4 + pareto * 3 / 4
    found_ms = link.latency_ms + link.jitter_ms * shapes[link.distribution]
    return np.asarray(np.maximum(found_ms, 0.0))


def losses(loss: Any) -> tuple[float, float]:
    """The share of messages that are lost, and how many in a row on average, NaN where none is.

    Bursts are as many as messages that are lost after one that is not.
    """
    if loss is None:
        return 0.0, np.nan
    if loss.kind == "random":
        p, c = loss.probability, loss.correlation
        steps = [[p + c * (1 - p), (1 - p) * (1 - c)], [p * (1 - c), 1 - p * (1 - c)]]
        often, lost = [p, 1 - p], [1.0, 0.0]
    elif loss.kind == "gilbert-elliott" and loss.mean_loss is not None:
        return loss.mean_loss, loss.mean_burst if loss.mean_loss else np.nan
    elif loss.kind == "gilbert-elliott":
        steps, often = [[1 - loss.r, loss.r], [loss.p, 1 - loss.p]], [loss.p, loss.r]
        lost = [_or(loss.bad_loss, 1.0), _or(loss.good_loss, 0.0)]
    else:  # lost within a burst and alone, passed within a burst and else
        ends = _or(loss.p31, 1 - loss.p13)
        steps = [
            [1 - ends - loss.p32, 0.0, loss.p32, ends],
            [0.0, 0.0, 0.0, 1.0],
            [loss.p23, 0.0, 1 - loss.p23, 0.0],
            [loss.p13, loss.p14, 0.0, 1 - loss.p13 - loss.p14],
        ]
        often = [loss.p13, loss.p14 * ends, loss.p13 * loss.p32 / loss.p23, ends]
        lost = [1.0, 1.0, 0.0, 0.0]
    of, chance = np.array(often) / sum(often), np.array(lost)
    share, begins = float(of @ chance), float((of * (1 - chance)) @ steps @ chance)
    return share, share / begins if begins else np.inf if share else np.nan
