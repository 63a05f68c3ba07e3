"""Where a scene's drones may be seen from one of its sensors: the places at which methods differ.

Places are drawn from the volume that the scene's own drones fly through, in the sensor's cover.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plotfeed.feeds.accuracy_chart.charted_model import charted_model
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.sensing.scene_drones import launch, trajectories_of
from plotfeed.feeds.sensing.visibility import each_its_own, looked_at
from plotfeed.models.frames import LocalFrame, aer_to_enu, ecef_to_geodetic, geodetic_to_ecef
from plotfeed.models.live_samples import FOREVER_NS
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Columns, Floats, Ints, Signatures, TruthState

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
