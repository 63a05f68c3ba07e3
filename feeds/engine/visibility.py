"""Whether sensors can see what a scene flies: from when to when, with what Pd, and if not, why.

Flights are sampled: what a sensor sees for less than the time between two samples may be missed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors
from plotfeed.feeds.scene.changes import in_force
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.mount_keys import home_of, mount_of
from plotfeed.models.beam import AzimuthCover, Volume
from plotfeed.models.chance import Chance, PairDraws
from plotfeed.models.frames import distance_m, ecef_to_geodetic, enu_to_aer
from plotfeed.models.sensors.sensor_model import DwellingSensor, JointSensor, SensorModel, Targets
from plotfeed.models.state import Floats, Ints, Signatures, TruthState
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS

# Keys of cover that not all sensors have, each with what goes for those that have it not.
LIMITS = {
    "range_min_m": 0.0,
    "azimuth_min_deg": -180.0,
    "azimuth_max_deg": 180.0,
    "elevation_min_deg": -90.0,
    "elevation_max_deg": 90.0,
}
# What keeps a sensor from seeing something, in the order in which it is asked after.
HINDRANCES = (
    *("off", "range", "elevation", "direction", "ground", "horizon", "nothing to sense"),
    "too weak",
)


@dataclass(frozen=True, slots=True, order=True)
class Hindrance:
    """What keeps a sensor from seeing a flight; of two, the greater one lets more of it through."""

    step: int  # Index among `HINDRANCES`
    short_by_m: float  # How much too far away it is, below 0
    text: str  # How it is where the flight comes nearest, and what the sensor could see

    @classmethod
    def of(cls, kind: str, text: str, short_by_m: float = 0.0) -> Hindrance:
        """A hindrance of one of `HINDRANCES`."""
        return cls(HINDRANCES.index(kind), short_by_m, text)

    @property
    def kind(self) -> str:
        """Which of `HINDRANCES` it is."""
        return HINDRANCES[self.step]


def cover_of(told: Mapping[str, Any]) -> Volume:
    """The cover by a sensor's `range_max_m` and those of `LIMITS` that are told and not None."""
    low_m, low_deg, high_deg, lowest_deg, highest_deg = (
        float(usual if told.get(name) is None else told[name]) for name, usual in LIMITS.items()
    )
    return Volume(
        range_min_m=low_m,
        range_max_m=float(told["range_max_m"]),
        azimuth_cover=AzimuthCover(low_deg, high_deg),
        elevation_min_deg=lowest_deg,
        elevation_max_deg=highest_deg,
    )


def outside(cover: Volume, place_enu_m: Floats) -> Hindrance | None:
    """What keeps all places of a flight, (n, 3), out of a cover; None if one of them lies within.

    Each place is asked for after what the hindrance before has let through.
    """
    azimuth_deg, elevation_deg, range_m = enu_to_aer(place_enu_m)
    lowest_deg, highest_deg = cover.elevation_min_deg, cover.elevation_max_deg
    every = range_m <= cover.range_max_m
    nearest = int(np.argmin(range_m))
    if not every.any():
        near_m = float(range_m[nearest])
        text = f"{shown_m(near_m)} away at its nearest, it sees to {shown_m(cover.range_max_m)}"
        return Hindrance.of("range", text, cover.range_max_m - near_m)
    every &= (range_m >= cover.range_min_m) & (range_m > 0)
    if not every.any():
        text = f"{shown_m(range_m[nearest])} away, it sees from {shown_m(cover.range_min_m)} on"
        return Hindrance.of("range", text)
    high = every & (elevation_deg >= lowest_deg) & (elevation_deg <= highest_deg)
    if not high.any():
        off_deg = np.maximum(lowest_deg - elevation_deg, elevation_deg - highest_deg)
        best_deg = elevation_deg[int(np.argmin(np.where(every, off_deg, np.inf)))]
        looks = f"it looks from {lowest_deg:.0f}° to {highest_deg:.0f}°"
        return Hindrance.of("elevation", f"{best_deg:.0f}° high at best, {looks}")
    inside = high & (cover.azimuth_cover.holds(azimuth_deg) | np.isnan(azimuth_deg))
    if inside.any():
        return None
    at_deg = azimuth_deg[int(np.argmin(np.where(high, range_m, np.inf)))]
    low_deg, high_deg = (
        float(deg) % 360 for deg in (cover.azimuth_cover.min_deg, cover.azimuth_cover.max_deg)
    )
    text = f"at {at_deg:.0f}° where it is nearest, it looks from {low_deg:.0f}° to {high_deg:.0f}°"
    return Hindrance.of("direction", text)


def shown_m(distance_m: float) -> str:
    """A distance to read, such as 1.86e+03 km."""
    return f"{distance_m / 1000:.3g} km" if distance_m >= 1000 else f"{distance_m:.0f} m"


SEEN_PD = 0.01  # A sensor that detects fewer than one look in a hundred at a drone does not see it
MOST_TIMES, FEWEST_TIMES = 64, 8  # Samples of a flight
MOST_ROWS = 200_000  # Samples of flights, each counted for every sensor, that are worked out
# Drones that are looked at closely, of more every so manyth; and of how many that nobody sees it is
# said why.
MOST_DRONES, MOST_EXPLAINED = 40, 8
# By which a flight may be below the ground, where it is known, and else below the site.
SUNK_M, CANYON_M = 5.0, 300.0
EMITS_NOTHING = "emits nothing"
LONGEST_NS = 86_400 * NS  # Of a flight without end


@dataclass(frozen=True, slots=True)
class Sightline:
    """What a sensor sees of a drone: when, after the start, and with what Pd; or what hinders it.

    `pd` are the lowest and the highest while it sees the drone.
    """

    drone: str
    sensor: str
    spans_s: tuple[tuple[float, float], ...] = ()
    pd: tuple[float, float] = (0.0, 0.0)
    hindrance: Hindrance | None = None


class Outlook:
    """The drones that a scene flies before its sensors, before anything has begun."""

    def __init__(
        self, scene: Scene, sensors: EmulatedSensors, trajectories: Trajectories, start_ns: int = 0
    ) -> None:
        self._sensors, self._trajectories, self._start_ns = sensors, trajectories, start_ns
        self._site, self._number = scene.scene.site, len(sensors.sensors)
        self._end_ns = _end_ns(start_ns, scene.scene.duration_s)
        rows = {name: row for row, name in enumerate(trajectories.names)}
        self._rows = {name: rows[name] for name in scene.fleet.names}
        self._pairs = PairDraws([Chance(scene.scene.seed, s.id) for s in sensors.sensors])
        self._changed: dict[tuple[int, ...], tuple[Sensor, SensorModel]] = {}

    @property
    def drones(self) -> list[str]:
        """Names of those that are looked at closely: all, or some from first to last."""
        names = list(self._rows)
        return names[:: -(-len(names) // MOST_DRONES) or 1]

    def times(self, drones: int) -> int:
        """How many samples are taken of each of so many flights."""
        rows = MOST_ROWS // max(drones * self._number, 1)
        return int(np.clip(rows, FEWEST_TIMES, MOST_TIMES))

    def span_s(self, drone: str) -> tuple[float, float]:
        """When a flight is looked at, after the start."""
        first_s, last_s = ((self._spans_ns([drone])[0] - self._start_ns) / NS).tolist()
        return first_s, last_s

    def sightlines(self, drones: Sequence[str]) -> Iterator[Sightline]:
        """Whether each sensor sees each drone; nothing of one that never flies."""
        states = self._sampled(drones, self.times(len(drones)))
        pds = [self._pds(i, states) for i in range(self._number)]
        for drone in drones:
            mine = np.flatnonzero(states.drone == self._rows[drone])
            for i in range(self._number if len(mine) else 0):
                yield self._view(drone, i, states.rows(mine), pds[i][mine])

    def unseen(self) -> dict[str, str]:
        """Drones that no sensor sees, and what hinders the one that comes nearest to it.

        All flights are sampled coarsely, and more closely those that nobody sees then; why is told
        of the first ones.
        """
        left = self._seen_by_none(list(self._rows), FEWEST_TIMES)
        left = self._seen_by_none(left, self.times(len(left)))
        found: dict[str, Hindrance] = {}
        for line in self.sightlines(left[:MOST_EXPLAINED]) if left else ():
            if line.hindrance is not None:
                told = replace(line.hindrance, text=f"{line.sensor}: {line.hindrance.text}")
                found[line.drone] = max(found.get(line.drone, told), told)
        return {drone: found[drone].text if drone in found else "" for drone in left}

    def foreseen(self, duration_s: float | None) -> tuple[dict[str, str], list[str]]:
        """Drones that no sensor sees until then, and why; and what looks wrong about heights."""
        self._end_ns = _end_ns(self._start_ns, duration_s)
        return self.unseen(), [*self._sensors.world.doubts, *self.doubts(self.drones)]

    def doubts(self, drones: Sequence[str]) -> list[str]:
        """What looks wrong about the heights of flights: those that go below the ground.

        Where no ground is known, that is far below the site.
        """
        states = self._sampled(drones, FEWEST_TIMES)
        below_m, site_m = self._below_ground_m(states), self._site.height_m
        height_m = ecef_to_geodetic(states.position_ecef_m)[2]
        found = []
        for drone in drones:
            mine = states.drone == self._rows[drone]
            ground_m = np.fmax.reduce(below_m[mine], initial=-np.inf)
            site_below_m = site_m - np.min(height_m[mine], initial=np.inf)
            if ground_m > SUNK_M:
                found.append(f"drone {drone!r} is {ground_m:.0f} m below the ground at its lowest")
            elif ground_m == -np.inf and site_below_m > CANYON_M:
                found.append(
                    f"drone {drone!r} is {site_below_m:.0f} m below the site at its lowest, and no "
                    "[terrain] says that the ground is lower"
                )
        return found

    def _seen_by_none(self, drones: list[str], times: int) -> list[str]:
        states = self._sampled(drones, times) if drones else None
        for i in range(self._number):
            if states is None or not len(states):
                return []
            seen = states.drone[self._pds(i, states) >= SEEN_PD]
            states = states.rows(~np.isin(states.drone, seen))
        left = set() if states is None else set(states.drone.tolist())
        return [drone for drone in drones if self._rows[drone] in left]

    def _spans_ns(self, drones: Sequence[str]) -> Ints:
        rows = [self._rows[drone] for drone in drones]
        return np.minimum(self._trajectories.spans_ns[rows], self._end_ns)

    def _sampled(self, drones: Sequence[str], times: int) -> TruthState:
        """States at equal steps from the first to the last moment of each flight."""
        spans_ns = self._spans_ns(drones)
        share = np.linspace(0.0, 1.0, times)
        t_ns = spans_ns[:, :1] + (share * (np.diff(spans_ns) - 1)).astype(np.int64)
        rows = np.array([self._rows[drone] for drone in drones], np.int64)
        return self._trajectories.state_at(t_ns.ravel(), np.repeat(rows, times))

    def _by_time(self, i: int, states: TruthState) -> Iterator[tuple[Ints, Sensor, SensorModel]]:
        """Rows of states, and the sensor as its events have it then."""
        sensor, times_ns = self._sensors.sensors[i], states.t_utc_ns - self._start_ns
        rows_of: dict[tuple[int, ...], list[int]] = {}
        for row, after_ns in enumerate(times_ns.tolist() if sensor.event else ()):
            on = (n for n, event in enumerate(sensor.event) if in_force((event,), after_ns))
            key = (i, *on)
            rows_of.setdefault(key, []).append(row)
        if not sensor.event:
            yield np.arange(len(states)), sensor, self._sensors.models[i]
        for key, rows in rows_of.items():
            if key not in self._changed:
                other = self._sensors.as_of(i, {}, self._sensors.start_ns + int(times_ns[rows[0]]))
                self._changed[key] = other, self._sensors.world.model_of(other)
            yield np.array(rows), *self._changed[key]

    def _pds(self, i: int, states: TruthState) -> Floats:
        """Probabilities that a look at each state detects it; NaN where there is no look."""
        pd, frame = np.full(len(states), np.nan), self._sensors.sites[i].frame
        reach_m = self._sensors.models[i].range_max_m
        near = np.flatnonzero(frame.has_within(states.position_ecef_m, reach_m))
        for rows, sensor, model in self._by_time(i, states.rows(near)):
            if sensor.enabled and len(rows):
                pd[near[rows]] = self._looked_at(i, sensor, model, states.rows(near[rows]))
        return pd

    def _looked_at(self, i: int, sensor: Sensor, model: SensorModel, states: TruthState) -> Floats:
        """Probability that any look at each state detects it; NaN for those never looked at."""
        if isinstance(model, DwellingSensor):  # in each of its dwells
            model = model.among_all
        targets = self._targets(i, sensor, model, states)
        if isinstance(model, JointSensor):
            azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
            covered = cover_of(limits_of(sensor)).in_cover(range_m, azimuth_deg, elevation_deg)
            return np.where(covered, model.predict(targets).pd, np.nan)
        alone: Any = model
        if getattr(model, "merging", None) is not None:
            alone = replace(alone, merging=None)  # samples of one flight are not together there
        looks, _ = alone.observe(targets, np.random.default_rng(0))
        missed = np.full(len(states), np.nan)
        missed[looks.drone] = 1.0
        np.multiply.at(missed, looks.drone, 1.0 - np.nan_to_num(looks.pd))
        return 1.0 - missed

    def _targets(self, i: int, sensor: Sensor, model: SensorModel, states: TruthState) -> Targets:
        """Each state as a target of its own; a mount points at each, as far as it turns."""
        site, field_deg, pair_draws = self._sensors.sites[i], None, None
        true_m = site.frame.from_ecef(states.position_ecef_m)
        place_m = true_m if site.axes is site.frame else site.axes.from_ecef(states.position_ecef_m)
        mount = mount_of(sensor)
        if mount is not None:
            home = home_of(sensor)
            pan_deg, tilt_deg, _ = enu_to_aer(place_m)
            if mount.look_at is not None:
                aim = mount.look_at.aim(self._site, sensor.position_enu_m, home.field_deg)
                pan_deg, tilt_deg = np.full((2, len(states)), [[aim.pan_deg], [aim.tilt_deg]])
            tilt_deg = np.clip(tilt_deg, mount.tilt_min_deg, mount.tilt_max_deg)
            from plotfeed.models.cueing import to_mount

            place_m = to_mount(place_m, np.nan_to_num(pan_deg), tilt_deg)
            field_deg = np.full(len(states), home.field_deg)
        if model.draws_by_pair:
            whose = np.full(len(states), i)
            pair_draws = self._pairs.of(whose, states.drone, self._trajectories.names)
        return Targets(
            drone=np.arange(len(states)),
            t_utc_ns=states.t_utc_ns,
            position_enu_m=place_m,
            true_position_enu_m=true_m,
            velocity_enu_m_s=site.frame.rotate_from_ecef(states.velocity_ecef_m_s),
            signatures=each_its_own(self._trajectories.signatures, states.drone),
            field_deg=field_deg,
            pair_draws=pair_draws,
            own_axes=site.own_axes,
        )

    def _view(self, drone: str, i: int, states: TruthState, pd: Floats) -> Sightline:
        """What a sensor sees of one drone, by its samples in the order of time."""
        seen = np.concatenate([[False], np.nan_to_num(pd) >= SEEN_PD, [False]])
        name = self._sensors.sensors[i].id
        if not seen.any():
            return Sightline(drone, name, hindrance=self._hindrance(i, states, pd))
        after_s = (states.t_utc_ns - self._start_ns) / NS
        begun, over = np.flatnonzero(np.diff(seen.astype(np.int8))).reshape(-1, 2).T
        spans_s = tuple(zip(after_s[begun].tolist(), after_s[over - 1].tolist(), strict=True))
        seen_pd = pd[seen[1:-1]]
        return Sightline(drone, name, spans_s, (float(seen_pd.min()), float(seen_pd.max())))

    def _hindrance(self, i: int, states: TruthState, pd: Floats) -> Hindrance:
        """What keeps a sensor from seeing a drone at all: of its states, what does so last."""
        found = Hindrance.of("off", "it is off")
        for rows, sensor, model in self._by_time(i, states):
            if sensor.enabled:
                found = max(found, self._of_state(i, (sensor, model), states.rows(rows), pd[rows]))
        return found

    def _of_state(
        self, i: int, at_work: tuple[Sensor, SensorModel], states: TruthState, pd: Floats
    ) -> Hindrance:
        (sensor, model), site = at_work, self._sensors.sites[i]
        place_m = site.axes.from_ecef(states.position_ecef_m)

        hindrance = outside(cover_of(limits_of(sensor)), place_m)
        if hindrance is not None:
            return hindrance
        lacking = not_emitted(sensor, self._trajectories.signatures, int(states.drone[0]))
        if lacking:
            return Hindrance.of("nothing to sense", f"the drone {lacking}")
        looked = np.flatnonzero(~np.isnan(pd))
        if not len(looked):
            return Hindrance.of("direction", "never in its picture")
        true_m = site.frame.from_ecef(states.position_ecef_m[looked])
        if not model.has_sight_of(true_m).any():
            below_m = float(self._below_ground_m(states.rows(looked)).min())
            if below_m > 0:
                return Hindrance.of("ground", f"{below_m:.0f} m or more below the ground")
            return Hindrance.of("horizon", "hidden behind the ground or buildings")
        best = looked[int(np.argmax(pd[looked]))]
        far = shown_m(float(distance_m(place_m[best])))
        return Hindrance.of("too weak", f"Pd {pd[best]:.1g} at best, {far} away")

    def _below_ground_m(self, states: TruthState) -> Floats:
        """How far states are below the ground, metres; NaN where none is known."""
        latitude_deg, longitude_deg, height_m = ecef_to_geodetic(states.position_ecef_m)
        return self._sensors.world.ground_m(latitude_deg, longitude_deg) - height_m


def _end_ns(start_ns: int, duration_s: float | None) -> int:
    return start_ns + (LONGEST_NS if duration_s is None else round(duration_s * NS))


def limits_of(sensor: Sensor) -> dict[str, Any]:
    """Keys of a sensor's cover, of a mount's where that turns it."""
    names = ("range_max_m", *LIMITS)
    told: dict[str, Any] = {name: getattr(sensor, name, None) for name in names}
    mount = mount_of(sensor)
    if mount is None or hasattr(sensor, "pan_deg"):  # a camera's are those of its mount already
        return told
    return told | {
        "azimuth_min_deg": None,
        "azimuth_max_deg": None,
        "elevation_min_deg": max(mount.tilt_min_deg + told["elevation_min_deg"], -90.0),
        "elevation_max_deg": min(mount.tilt_max_deg + told["elevation_max_deg"], 90.0),
    }


def each_its_own(signatures: Signatures, drone: Ints) -> Signatures:
    """What there is to sense of targets that are those drones, a row each."""
    emitters = signatures.emitters
    return Signatures(
        rcs_m2=signatures.rcs_m2[drone],
        sound_power_db=signatures.sound_power_db[drone],
        emitters=[emitters[i] for i in drone.tolist()],
        size_m=signatures.size_m[drone],
        echoes=None if signatures.echoes is None else signatures.echoes.rows(drone),
    )


def not_emitted(sensor: Sensor, signatures: Signatures, drone: int = 0) -> str:
    """What a drone lacks of what such a sensor senses, as a verb; empty if it lacks nothing."""
    if sensor.sapient_type == "ACOUSTIC" and np.isnan(signatures.sound_power_db[drone]):
        return "makes no known sound"
    if sensor.sapient_type == "CAMERA" and np.isnan(signatures.size_m[drone]):
        return "is of unknown size"
    if sensor.band_hz is None:
        return "has no known cross-section" * bool(
            sensor.sapient_type == "RADAR" and np.isnan(signatures.rcs_m2[drone])
        )
    emitters, (low_hz, high_hz) = signatures.emitters[drone], sensor.band_hz
    if not emitters:
        return EMITS_NOTHING
    heard = any(
        e.frequency_hz + e.bandwidth_hz / 2 >= low_hz
        and e.frequency_hz - e.bandwidth_hz / 2 <= high_hz
        for e in emitters
    )
    return "" if heard else f"emits nothing from {low_hz / 1e6:g} to {high_hz / 1e6:g} MHz"
