"""One sensor of a scene as a chart takes it: where targets are, and how well it measures."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import singledispatch
from typing import Any

import numpy as np

from plotfeed.feeds.engine.scene_drones import launch, trajectories_of
from plotfeed.feeds.engine.visibility import each_its_own, looked_at
from plotfeed.feeds.lab import precise
from plotfeed.feeds.scene.fields import enu_from, frame_at, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models import detection
from plotfeed.models.effects.degradation import Degradation
from plotfeed.models.effects.multipath import Multipath
from plotfeed.models.emitters import Emissions
from plotfeed.models.fluctuation import FluctuatingCfar
from plotfeed.models.frames import (
    LocalFrame,
    aer_to_enu,
    ecef_to_geodetic,
    enu_to_aer,
    geodetic_to_ecef,
    wrap_180,
)
from plotfeed.models.joined_sets import OUTSIDE, JoinedSets
from plotfeed.models.multilateration import Sightings, range_sums_m, solved
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.electronic_radar import ElectronicRadar
from plotfeed.models.sensors.multistatic import MultistaticRadar
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.rf import RfDirectionFinder, emissions_of
from plotfeed.models.sensors.sensor_model import NO_PLOTS, JointSensor, SensorModel, Targets
from plotfeed.models.state import Bools, Columns, Floats, Ints, Looks, Plots, Signatures, TruthState
from plotfeed.models.truth import FOREVER_NS

PD = "pd"
FALSE_ALARMS = "false_alarms"
MEASURED = ("range_m", "bistatic_range_m", "azimuth_deg", "elevation_deg")
"""Of everything in which a tracker can see an error, what is measured of a target."""
WORDS = {
    "range_m": "{} m",
    "bistatic_range_m": "{} m of path",
    "azimuth_deg": "{}° az",
    "elevation_deg": "{}° el",
    "pd": "Pd {}",
    "false_alarms": "{} alarms",
}
NEGLIGIBLE = 1e-12
"""Less than that is rounding."""
Call = Callable[[], object]
MOST_CALLS = 100_000
FINE_S = 1e-6
now_ns = (
    time.thread_time_ns
    if time.get_clock_info("thread_time").resolution <= FINE_S
    else time.perf_counter_ns
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How much is done: a chart for a document, or a quick one."""

    targets: int
    """Seen at once."""
    pool: int
    """Places drawn, of which the targets are some."""
    references: int
    """Places at which 50 digits are computed."""
    rounds: int
    """Turns in which every method is timed."""
    seconds: float
    """Of one method in one turn, at least."""
    trials: int
    """Of a Monte Carlo for one probability."""
    batches: tuple[int, ...]
    """Numbers of targets at once between which costs are compared."""

    @classmethod
    def usual(cls, targets: int) -> Effort:
        """Some ten seconds a sensor."""
        return cls(
            targets=targets,
            pool=20_000,
            references=300,
            rounds=9,
            seconds=0.004,
            trials=1000,
            batches=(1, 3, 10, 30, 100, 300, 1000, 3000, 10_000, 30_000),
        )

    @classmethod
    def quick(cls, targets: int) -> Effort:
        """A second or so: that everything works."""
        return cls(
            targets=min(targets, 200),
            pool=3000,
            references=40,
            rounds=3,
            seconds=0.0005,
            trials=200,
            batches=(1, 10, 100),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """A call that does `units` target-scans, and the errors that it makes.

    `errors` are rms over the scene's places, by quantity; zero for what is right by definition or
    in law. `ours` is what the engine does for this scene.
    """

    name: str
    run: Call
    units: int
    errors: Mapping[str, float]
    ours: bool = False
    gives_ratio: bool = True
    """Whether a signal-to-noise ratio comes out of it."""
    needs_ratio: bool = False
    """Whether one must come in."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartStage:
    """Methods that do the same work."""

    name: str
    question: str
    methods: tuple[Method, ...]

    @classmethod
    def of(
        cls,
        name: str,
        question: str,
        methods: Iterable[tuple[str, Call, Mapping[str, float]]],
        *,
        units: int,
        ours: str,
        need_ratio: Container[str] = (),
    ) -> ChartStage:
        """Methods of so many target-scans each, given by name, call and errors."""
        made = (
            Method(
                name=method,
                run=run,
                units=units,
                errors=errors,
                ours=method == ours,
                needs_ratio=method in need_ratio,
            )
            for method, run, errors in methods
        )
        return cls(name=name, question=question, methods=tuple(made))


@dataclass(frozen=True, slots=True)
class Time:
    """Nanoseconds per target-scan over the turns, the middle half of which is from low to high."""

    median_ns: float
    low_ns: float
    high_ns: float

    @classmethod
    def of(cls, turns_ns: Floats) -> Time:
        """Quantiles of the means of the turns."""
        low_ns, median_ns, high_ns = np.quantile(turns_ns, (0.25, 0.5, 0.75)).tolist()
        return cls(median_ns, low_ns, high_ns)


def rms(values: Floats) -> float:
    """Root of the mean square, over what is finite; 0 of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0


def share_of_own(errors: Mapping[str, float], own: Mapping[str, float]) -> float:
    """The largest error beside the sensor's own in that quantity."""
    return max((_share(error, own.get(name, 0.0)) for name, error in errors.items()), default=0.0)


def _share(error: float, own: float) -> float:
    if own > 0:
        return error / own
    return 0.0 if error == 0 else float("inf")


def errors_text(errors: Mapping[str, float]) -> str:
    """Such as: 16 m, 0.15° az, Pd 0.008; what is only rounding is not told."""
    told = {name: error for name, error in errors.items() if error > NEGLIGIBLE}
    return (
        ", ".join(WORDS.get(name, "{}").format(f"{e:.2g}") for name, e in told.items())
        or "no error"
    )


def share_text(share: float | None) -> str:
    """A share of the sensor's own error."""
    if share is None:
        return "all"
    if share >= 100:
        return f"{share:,.0f}"
    return f"{share:.2g}" if share > NEGLIGIBLE else "0"


def ns_text(ns: float) -> str:
    """Three figures."""
    return f"{ns:,.0f}" if ns >= 100 else f"{ns:.3g}"


def in_turns(calls: Sequence[Call], *, rounds: int, seconds: float) -> Floats:
    """Nanoseconds of each call, mean of a turn; (rounds, calls). A turn lasts at least `seconds`.

    Garbage is not collected meanwhile: when that happens has nothing to do with who is timed.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        counts = [_count(call, seconds) for call in calls]
        turns = [
            [_mean_ns(call, count) for call, count in zip(calls, counts, strict=True)]
            for _ in range(rounds)
        ]
    finally:
        if was_enabled:
            gc.enable()
    return np.array(turns, dtype=np.float64).reshape(rounds, len(calls))


def _count(call: Call, seconds: float) -> int:
    """How often a call goes into that time; it has then been warmed up."""
    call()
    return int(np.clip(seconds * 1e9 / max(_mean_ns(call, 1), 1.0), 1, MOST_CALLS))


def _mean_ns(call: Call, count: int) -> float:
    start_ns = now_ns()
    for _ in range(count):
        call()
    return (now_ns() - start_ns) / count


MEASURED_BY_PAIRS = ("sum_m", "azimuth_deg", "elevation_deg")


@dataclass(frozen=True, kw_only=True)
class PlacesApart(MultistaticRadar):
    """Several receivers that know whose detections are whose; a look is at a target by all pairs.

    Its plots are least squares from where the target is: what a tracker would see without ghosts.
    """

    @property
    def multipath(self) -> Multipath | None:
        """The ground that all receivers are over; None for free space."""
        return self.receivers[0].signals.multipath

    def over(self, ground: Multipath | None) -> PlacesApart:
        """Receivers as they are, over that ground."""
        receivers = tuple(
            replace(each, signals=replace(each.signals, multipath=ground))
            for each in self.receivers
        )
        return replace(self, receivers=receivers)

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Look once at each target within cover, and place those that enough pairs detect."""
        geometry = azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        rows = np.flatnonzero(self.in_cover(range_m, azimuth_deg, elevation_deg))
        place_m = targets.true_position_enu_m[rows]
        snrs, pds = self.odds(place_m, targets.rcs_m2(rows))
        hit = rng.random(snrs.shape) < pds
        detected = (hit.sum(axis=1) >= self.fewest_pairs) & (rng.random(len(rows)) >= OUTSIDE)
        looks = targets.looks(
            rows, geometry, snr=snrs.max(axis=1), pd=self.place_pd(pds), detected=detected
        )
        if not detected.any():
            return looks, NO_PLOTS
        seen, snr = self._sightings(place_m[detected], snrs[detected], hit[detected], rng)
        fit = solved(place_m[detected], seen)
        joined = JoinedSets(fit, np.nanmean(snr, axis=1), targets.drone[rows[detected]])
        return looks, self._with_truth(self._plots(joined, int(targets.t_utc_ns[0])), targets)

    def _sightings(
        self, place_m: Floats, snrs: Floats, hit: Bools, rng: np.random.Generator
    ) -> tuple[Sightings, Floats]:
        """What pairs measure of targets, a row each, NaN where they missed; and the ratios."""
        sums_m = range_sums_m(place_m, *self.stations_m)
        names = [f"{sigma}{name}" for name in MEASURED_BY_PAIRS for sigma in ("", "sigma_")]
        columns = {name: np.full(snrs.shape, np.nan) for name in (*names, "snr")}
        for p, (m, _) in enumerate(self.pairs):
            each, mine = self.receivers[m], np.flatnonzero(hit[:, p])
            signals, mean = each.signals, snrs[mine, p]
            azimuth_deg, elevation_deg, _ = enu_to_aer(place_m[mine] - np.array(each.place_enu_m))
            snr, _ = detection.draw_detected_snr_swerling1(
                mean, signals.pfa, signals.n_reference, rng
            )
            found = self._measured(p, snr, (sums_m[mine, p], azimuth_deg, elevation_deg), rng)
            for name, column in columns.items():
                column[mine, p] = getattr(found, name)
        seen = Sightings(
            transmitters_m=self.stations_m[0],
            receivers_m=self.stations_m[1],
            height_m=self.expected_height_m,
            sigma_height_m=self.sigma_height_m,
            **{name: columns[name] for name in names},
        )
        return seen, columns["snr"]


@singledispatch
def charted_model(model: SensorModel) -> SensorModel:
    """A model whose observations of thousands of places at once are those of each alone."""
    changed: Any = model
    if getattr(model, "merging", None) is not None:
        changed = replace(changed, merging=None)  # their echoes would melt into one
    return changed  # type: ignore[no-any-return]


@charted_model.register
def _(model: ElectronicRadar) -> SensorModel:
    radar = model.radar
    # A false alarm takes a dwell, and is not confirmed.
    silent = replace(radar.degradation or Degradation(), false_alarm_factor=0.0)
    return charted_model(replace(radar, degradation=silent))


@charted_model.register
def _(model: MultistaticRadar) -> SensorModel:
    held = {field.name: getattr(model, field.name) for field in fields(model)}
    return PlacesApart(**held | {"degradation": None})  # its pairs have it already


USUAL_SPEED_M_S = 20.0
"""Of drones in a scene that flies none."""
FEWEST_IN_COVER = 50
"""With fewer places in the drones' volume that it covers, a sensor gets places of its own."""
MIN_DRAWS, MAX_DRAWS = 8, 400


@dataclass(frozen=True, kw_only=True)
class Places(Columns):
    """Places of drones, as telemetry would tell them, and how they move; (n,) and (n, 3).

    `drone` is a row of the scene's signatures.
    """

    drone: Ints
    latitude_deg: Floats
    longitude_deg: Floats
    height_m: Floats
    velocity_ecef_m_s: Floats

    @property
    def ecef_m(self) -> Floats:
        """The places in ECEF; (n, 3)."""
        return geodetic_to_ecef(self.latitude_deg, self.longitude_deg, self.height_m)

    def drawn(self, which: Ints) -> Places:
        """Rows, of which some may be there more than once."""
        return self.holding({name: column[which] for name, column in vars(self).items()})

    def first(self, n: int | None) -> Places:
        """The first so many, or all."""
        return self if n is None else self.between(0, min(n, len(self)))


@dataclass(frozen=True, slots=True)
class Flown:
    """Some states of the scene's drones, and what of them can be sensed."""

    states: TruthState
    signatures: Signatures


def flown(scene: Scene, n: int, rng: np.random.Generator) -> Flown:
    """Some `n` states of the scene's drones, at random times of their flights."""
    trajectories = trajectories_of(scene)
    launch(scene, trajectories, 0)
    spans_ns, all_drones = trajectories.spans_ns, np.arange(len(trajectories.names))
    found = [trajectories.state_at(all_drones[:0], all_drones[:0])]
    if not len(all_drones):
        return Flown(found[0], _unknown(scene))
    for _ in range(int(np.clip(n // len(all_drones), MIN_DRAWS, MAX_DRAWS))):
        share = rng.random(len(all_drones))
        t_ns = spans_ns[:, 0] + (share * (spans_ns[:, 1] - spans_ns[:, 0])).astype(np.int64)
        found.append(trajectories.state_at(np.minimum(t_ns, FOREVER_NS - 1), all_drones))
    return Flown(TruthState.joined(found), trajectories.signatures)


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """A sensor of the scene, its model, and where it stands."""

    sensor: Sensor
    model: SensorModel
    frame: LocalFrame

    @classmethod
    def of(cls, scene: Scene, sensor: Sensor) -> Viewpoint:
        """Model and frame at the scene's site."""
        site = scene.scene.site
        model = charted_model(sensor.model(site))
        return cls(sensor, model, frame_at(site, sensor.position_enu_m))


def places(
    scene: Scene, viewpoint: Viewpoint, flights: Flown, n: int, rng: np.random.Generator
) -> tuple[Places, Floats]:
    """Up to `n` places at which a sensor looks, with the Pd there; uniform in a volume.

    That of the drones, or, where the sensor covers hardly any of it, of the sensor itself.
    """
    site = site_frame(scene.scene.site)
    drone, velocity_m_s = _movers(site, flights.states, n, rng)
    volumes: list[Callable[[], Floats]] = [lambda: _within_cover(viewpoint, n, rng)]
    if len(flights.states):
        volumes.insert(0, lambda: _within_flights(site, flights.states, n, rng))
    for volume in volumes:
        latitude_deg, longitude_deg, height_m = ecef_to_geodetic(volume())
        found = Places(
            drone=drone,
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            height_m=height_m,
            velocity_ecef_m_s=velocity_m_s,
        )
        targets = targets_at(found, viewpoint.frame, flights.signatures)
        pd = looked_at(viewpoint.model, targets, rng)
        covered = ~np.isnan(pd)
        if covered.sum() >= FEWEST_IN_COVER:
            break
    return found.rows(covered), pd[covered]


def targets_at(found: Places, frame: LocalFrame, signatures: Signatures) -> Targets:
    """Drones as the sensor at that frame has them before it; each place is a drone of its own."""
    enu_m = frame.from_ecef(found.ecef_m)
    n = len(found)
    return Targets(
        drone=np.arange(n),
        t_utc_ns=np.zeros(n, np.int64),
        position_enu_m=enu_m,
        true_position_enu_m=enu_m,
        velocity_enu_m_s=frame.rotate_from_ecef(found.velocity_ecef_m_s),
        signatures=each_its_own(signatures, found.drone),
    )


def _unknown(scene: Scene) -> Signatures:
    """A drone that tells nothing of itself."""
    telemetry = scene.telemetry
    return Signatures(
        rcs_m2=np.array([telemetry.rcs_m2]),
        sound_power_db=np.array([telemetry.sound_power_db]),
        emitters=[()],
        size_m=np.array([telemetry.size_m]),
    )


def _movers(
    site: LocalFrame, states: TruthState, n: int, rng: np.random.Generator
) -> tuple[Ints, Floats]:
    """Drones, and velocities that they have at some time."""
    if len(states):
        row = rng.integers(0, len(states), n)
        return states.drone[row], states.velocity_ecef_m_s[row]
    level = aer_to_enu(rng.uniform(0, 360, n), 0.0, USUAL_SPEED_M_S)
    return np.zeros(n, np.int64), site.rotate_to_ecef(level)


def _within_flights(
    site: LocalFrame, states: TruthState, n: int, rng: np.random.Generator
) -> Floats:
    """Places in the box around all that is flown, along the axes of the site."""
    enu_m = site.from_ecef(states.position_ecef_m)
    return site.to_ecef(rng.uniform(enu_m.min(axis=0), enu_m.max(axis=0), (n, 3)))


def _within_cover(viewpoint: Viewpoint, n: int, rng: np.random.Generator) -> Floats:
    """Places uniform in range and in the angles of cover; up to 60 degrees high without such."""
    sensor = viewpoint.sensor
    low_deg = max(getattr(sensor, "elevation_min_deg", 0.0), -5.0)
    high_deg = getattr(sensor, "elevation_max_deg", 60.0)
    enu_m = aer_to_enu(
        rng.uniform(
            getattr(sensor, "azimuth_min_deg", 0.0), getattr(sensor, "azimuth_max_deg", 360.0), n
        ),
        rng.uniform(min(low_deg, high_deg), high_deg, n),
        rng.uniform(getattr(sensor, "range_min_m", 0.0), sensor.range_max_m, n),
    )
    return viewpoint.frame.to_ecef(enu_m)


FEWEST_SEEN = 1e-6
"""Of a sensor that detects less than this share of its looks, there is nothing to chart."""
Rng = np.random.Generator
Sigmas = Callable[[Floats], Mapping[str, Floats]]
"""From signal-to-noise ratios of detections, linear, (n,): standard deviations by quantity."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """The sensor, `seen` places drawn as its detections come, and `anywhere` as its looks come.

    `own` has the sensor's own errors by quantity, rms: of what it measures over its detections, of
    the number of detections a look, and of that of false alarms a scan.
    """

    scene: Scene
    sensor: Sensor
    model: SensorModel
    frame: LocalFrame
    effort: Effort
    signatures: Signatures
    seen: Places
    anywhere: Places
    pd_anywhere: Floats
    transmitter_enu_m: Floats | None
    """Of a bistatic sensor that whose echo of each seen target is the strongest; (n, 3)."""
    own: Mapping[str, float]
    seed: int = 1

    def seen_targets(self, n: int | None = None) -> Targets:
        """The first of the places that are detected, or all of them."""
        return targets_at(self.seen.first(n), self.frame, self.signatures)

    def anywhere_targets(self, n: int | None = None) -> Targets:
        """The first of the places that are looked at, or all of them."""
        return targets_at(self.anywhere.first(n), self.frame, self.signatures)

    @property
    def rng(self) -> Rng:
        """A generator that draws the same whenever it is asked for."""
        return np.random.default_rng(self.seed)

    @property
    def velocity_enu_m_s(self) -> Floats:
        """Velocities of the seen targets; (n, 3)."""
        return self.frame.rotate_from_ecef(self.seen.velocity_ecef_m_s)

    def measured(self, enu_m: Floats, rows: Ints | None = None) -> dict[str, Floats]:
        """What the sensor measures of those places, (n, 3), without its errors; by quantity.

        `rows` are theirs among `seen`, if they are not all of them.
        """
        azimuth_deg, elevation_deg, range_m = enu_to_aer(enu_m)
        found = {"range_m": range_m, "azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg}
        if self.transmitter_enu_m is not None:
            there_m = self.transmitter_enu_m if rows is None else self.transmitter_enu_m[rows]
            found["bistatic_range_m"] = bistatic_range(enu_m, there_m)
        return {name: value for name, value in found.items() if name in self.own}

    def measured_precisely(self, row: int) -> dict[str, Any]:
        """Measurements of one of the seen places, in 50 digits, from its latitude and longitude."""
        site, place = self.frame, self.seen
        enu = precise.enu_m(
            (site.latitude_deg, site.longitude_deg, site.height_m),
            [float(x[row]) for x in (place.latitude_deg, place.longitude_deg, place.height_m)],
        )
        azimuth_deg, elevation_deg, range_m = precise.azimuth_elevation_range(enu)
        found = {"range_m": range_m, "azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg}
        if self.transmitter_enu_m is not None:
            there_m = self.transmitter_enu_m[row].tolist()
            found["bistatic_range_m"] = precise.bistatic_range_m(enu, there_m)
        return {name: value for name, value in found.items() if name in self.own}


def wrapped(name: str, difference: Floats) -> Floats:
    """Differences of a quantity, angles the short way round."""
    return wrap_180(difference) if name.endswith("_deg") else difference


def case_of(scene: Scene, sensor: Sensor, flights: Flown, effort: Effort, rng: Rng) -> Case | None:
    """What there is to measure of a sensor; None if it hardly ever detects any of the drones."""
    viewpoint = Viewpoint.of(scene, sensor)
    model, frame = viewpoint.model, viewpoint.frame
    found, pd = places(scene, viewpoint, flights, effort.pool, rng)
    if not len(found) or pd.mean() < FEWEST_SEEN:
        return None
    seen = found.drawn(rng.choice(len(found), effort.targets, p=pd / pd.sum()))
    some = rng.permutation(len(found))[: max(effort.targets, effort.references)]
    targets = targets_at(seen, frame, flights.signatures)
    own = _own_sigmas(model, targets)
    own[PD] = float(np.sqrt(np.mean(pd[some] * (1 - pd[some]))))
    mean, variance = alarm_moments(model)
    if mean > 0:
        own[FALSE_ALARMS] = float(np.sqrt(variance))
    return Case(
        scene=scene,
        sensor=sensor,
        model=model,
        frame=frame,
        effort=effort,
        signatures=flights.signatures,
        seen=seen,
        anywhere=found.drawn(some),
        pd_anywhere=pd[some],
        transmitter_enu_m=_transmitters(scene, viewpoint, targets),
        own=own,
    )


def alarm_moments(model: SensorModel) -> tuple[float, float]:
    """Mean and variance of the number of false alarms a scan: binomial where cells are known.

    None of a sensor that joins detections: they are no plots by themselves.
    """
    if isinstance(model, JointSensor):
        return 0.0, 0.0
    cells, pfa = (getattr(model, name, None) for name in ("alarm_cells", "alarm_pfa"))
    if cells is None or pfa is None:
        return model.false_alarms_per_scan, model.false_alarms_per_scan
    mean = float(np.sum(cells) * pfa)
    return mean, mean * (1 - pfa)


def _transmitters(scene: Scene, viewpoint: Viewpoint, targets: Targets) -> Floats | None:
    """Where the transmitter of each target's strongest look stands; None without such."""
    site, illuminators = scene.scene.site, viewpoint.sensor.illuminators
    if not illuminators:
        return None
    stand_enu_m = np.array([enu_from(viewpoint.frame, site, part.place) for part in illuminators])
    looks, _ = viewpoint.model.observe(targets, np.random.default_rng(1))
    order = np.lexsort((-looks.snr, looks.drone))
    drones, first = np.unique(looks.drone[order], return_index=True)
    channel = np.zeros(len(targets), np.int64)
    channel[drones] = looks.channel[order][first]
    return np.asarray(stand_enu_m[channel])


def _own_sigmas(model: SensorModel, targets: Targets) -> dict[str, float]:
    """Errors of what it measures: by their law, or else by what it predicts."""
    law = error_law(model, targets)
    if law is not None:
        return {name: rms(sigma) for name, sigma in law.sigmas(1 / law.inverse).items()}
    predicted = model.predict(targets)
    sigmas = {
        "range_m": predicted.sigma_range_m,
        "azimuth_deg": predicted.sigma_azimuth_deg,
        "elevation_deg": predicted.sigma_elevation_deg,
    }
    return {name: rms(sigma) for name, sigma in sigmas.items() if np.isfinite(sigma).any()}


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorLaw:
    """How the errors of a sensor's plots of targets are distributed.

    `draw` gives ratios of detections, None where they do not fluctuate; one over `inverse` is the
    ratio whose errors are the rms of theirs. `printed` has the paper's own constants.
    """

    mean_snr: Floats
    sigmas: Sigmas
    printed: Sigmas | None
    draw: Callable[[Rng], Floats] | None
    inverse: Floats


def error_law(model: SensorModel, targets: Targets) -> ErrorLaw | None:
    """The law of a sensor; None if it is not known, and the stage of errors left out."""
    law, factor = _law_of_kind(model, targets), model.error_factor
    if law is None or model.degradation is None:
        return law

    def larger(sigmas: Sigmas) -> Sigmas:
        return lambda snr: {name: sigma * factor for name, sigma in sigmas(snr).items()}

    printed = None if law.printed is None else larger(law.printed)
    return replace(law, sigmas=larger(law.sigmas), printed=printed)


@singledispatch
def _law_of_kind(_model: SensorModel, _targets: Targets) -> ErrorLaw | None:
    """The law of a kind of sensor that is not degraded."""
    return None


@_law_of_kind.register
def _(model: PolarRadar, targets: Targets) -> ErrorLaw:
    snrs, order = model.look_snrs(targets), model.orders(targets)
    names = ("range_m", "azimuth_deg", "elevation_deg")[: 3 if model.measures_elevation else 2]

    def sigmas(snr: Floats) -> dict[str, Floats]:
        return dict(zip(names, model.sigmas(snr), strict=False))

    beams = {
        "azimuth_deg": (model.azimuth_beamwidth_deg, model.azimuth_floor_deg),
        "elevation_deg": (model.elevation_beamwidth_deg, model.elevation_floor_deg),
    }
    return ErrorLaw(
        mean_snr=snrs.mean(axis=1),
        sigmas=sigmas,
        printed=_printed(sigmas, beams),
        draw=lambda rng: model.draw_detected(snrs, rng, order)[0],
        inverse=model.inverse_detected(snrs, order),
    )


@_law_of_kind.register
def _(model: PassiveRadar, targets: Targets) -> ErrorLaw:
    snrs = passive_snrs(model, targets)
    snr, best = snrs.max(axis=1), snrs.argmax(axis=1)
    resolution_m, floor_m = model.range_resolution_m[best], model.range_floors_m[best]

    def sigmas(ratio: Floats) -> dict[str, Floats]:
        names = ("bistatic_range_m", "azimuth_deg")
        return dict(zip(names, model.sigmas(ratio, resolution_m, floor_m), strict=True))

    beams = {"azimuth_deg": (model.azimuth_beamwidth_deg, model.azimuth_floor_deg)}
    cfar, order = FluctuatingCfar(model.pfa, 1, model.n_reference), model.orders(targets)

    def draw(rng: Rng) -> Floats:
        if order is not None:
            return cfar.draw_detected(snr, order, rng)[0]
        return detection.draw_detected_snr_swerling1(snr, model.pfa, model.n_reference, rng)[0]

    return ErrorLaw(
        mean_snr=snr,
        sigmas=sigmas,
        printed=_printed(sigmas, beams),
        draw=draw,
        inverse=model.inverse_detected(snr, order),
    )


@_law_of_kind.register
def _(model: MicrophoneArray, targets: Targets) -> ErrorLaw:
    snr = 10 ** (model.snr_db(targets.sound_power_db(), targets.position_enu_m) / 10)
    azimuth_deg, elevation_deg, _ = enu_to_aer(targets.position_enu_m)
    beams = {"azimuth_deg": (model.azimuth_beamwidth_deg, model.azimuth_floor_deg)}
    if model.elevation_beamwidth_deg is not None:
        beams["elevation_deg"] = (model.elevation_beamwidth_deg, model.elevation_floor_deg)

    def sigmas(ratio: Floats) -> dict[str, Floats]:
        found = model.sigmas_towards(ratio, azimuth_deg, elevation_deg)
        return dict(zip(beams, found, strict=False))

    return ErrorLaw(
        mean_snr=snr, sigmas=sigmas, printed=_printed(sigmas, beams), draw=None, inverse=1 / snr
    )


@_law_of_kind.register
def _(model: RfDirectionFinder, targets: Targets) -> ErrorLaw | None:
    if not model.measures_azimuth:
        return None
    emissions, snr = strongest_emissions(model, targets)

    def draw(rng: Rng) -> Floats:
        detected = detection.draw_detected_energy(snr, model.pfa, model.samples, rng)
        return detection.estimated_snr(detected, model.samples)

    def sigmas(ratio: Floats) -> dict[str, Floats]:
        return {"azimuth_deg": model.sigma_azimuth_deg(emissions.frequency_hz, ratio)}

    return ErrorLaw(
        mean_snr=snr,
        sigmas=sigmas,
        printed=None,
        draw=draw,
        inverse=1 / model.effective_snr(snr),
    )


def _printed(sigmas: Sigmas, beams: Mapping[str, tuple[float, float]]) -> Sigmas:
    """Equations 14 and 15 as printed, beamwidth over 2 sqrt(S), for angles; range as it is."""

    def found(snr: Floats) -> dict[str, Floats]:
        angles = {
            name: np.hypot(width_deg / (2 * np.sqrt(snr)), floor_deg)
            for name, (width_deg, floor_deg) in beams.items()
        }
        return {name: angles.get(name, sigma) for name, sigma in sigmas(snr).items()}

    return found


def passive_snrs(model: PassiveRadar, targets: Targets) -> Floats:
    """Mean ratios by channel; (n, channels)."""
    return model.mean_snr(model.look_powers_w(targets))


def strongest_emissions(model: RfDirectionFinder, targets: Targets) -> tuple[Emissions, Floats]:
    """The emission with the highest ratio of each target that emits, and that ratio."""
    emissions = emissions_of(targets)
    snr = model.received_snr(emissions, targets, enu_to_aer(targets.position_enu_m)[2])
    order = np.lexsort((-snr, emissions.target))
    _, first = np.unique(emissions.target[order], return_index=True)
    rows = order[first]
    return emissions.rows(rows), snr[rows]
