"""Drones of the scene that report themselves, and what they say."""

from __future__ import annotations

import numpy as np

from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.drones import COOPERATIVE, CooperativeKeys
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame, ecef_to_geodetic
from plotfeed.models.state import Floats
from plotfeed.models.truth import Trajectories
from plotfeed.proto.asterix.cat129 import TargetEncoder129
from plotfeed.proto.content_types import asterix_content_type
from plotfeed.proto.utc import NS

HALF_OF_POSITIONS = (2 * np.log(2)) ** 0.5
"""Radius that holds half of a circular normal distribution, in standard deviations."""


class CooperativeDrones:
    """What the cooperative drones say at the k-th period since 1970."""

    def __init__(self, scene: Scene, settings: CooperativeKeys, trajectories: Trajectories) -> None:
        self.period_ns = round(settings.period_s * NS)
        self._accuracy_m = settings.accuracy_m
        self._undulation_m = scene.telemetry.geoid_undulation_m or 0.0
        self._trajectories = trajectories
        names = settings.those_of([drone.id for drone in scene.drone])
        self._chances = {
            trajectories.names.index(name): Chance(scene.scene.seed, f"{COOPERATIVE}/{name}")
            for name in dict.fromkeys(names)
        }
        self._drones = np.array(sorted(self._chances), np.int64)
        self._encoder = TargetEncoder129(settings.sac, settings.sic, country=settings.country)
        self._root = f"{scene.mqtt.prefix}/{COOPERATIVE}"
        self._qos = scene.mqtt.qos

    def messages(self, number: int) -> list[Message]:
        """One a drone that is there, due when it says it is."""
        t_utc_ns = number * self.period_ns
        state = self._trajectories.state_at(t_utc_ns, self._drones)
        if not len(state):
            return []
        names = [self._trajectories.names[drone] for drone in state.drone]
        latitude_deg, longitude_deg, height_m = ecef_to_geodetic(state.position_ecef_m)
        velocity_m_s = np.zeros((len(state), 3))
        for i, drone in enumerate(state.drone):
            frame = LocalFrame(latitude_deg[i], longitude_deg[i], height_m[i])
            error_m = self._error_m(int(drone), number)
            said = frame.to_geodetic(error_m)
            latitude_deg[i], longitude_deg[i], height_m[i] = (float(x) for x in said)
            velocity_m_s[i] = frame.rotate_from_ecef(state.velocity_ecef_m_s[i])
        blocks = self._encoder.blocks(
            names,
            state.t_utc_ns,
            latitude_deg,
            longitude_deg,
            altitude_m=height_m - self._undulation_m,
            accuracy_m=self._radius_m(len(state)),
            velocity_m_s=velocity_m_s,
        )
        return [
            self._message(number, name, block) for name, block in zip(names, blocks, strict=True)
        ]

    def _error_m(self, drone: int, number: int) -> Floats:
        if not self._accuracy_m:
            return np.zeros(3)
        rng = self._chances[drone].rng(Purpose.COOPERATION, number)
        return self._accuracy_m * rng.standard_normal(3)

    def _radius_m(self, n: int) -> Floats | None:
        """Accuracy as the drones state it, at least 1 m: 0 would say that it is unknown."""
        if not self._accuracy_m:
            return None
        return np.full(n, max(self._accuracy_m * HALF_OF_POSITIONS, 1.0))

    def _message(self, number: int, drone: str, block: bytes) -> Message:
        t_utc_ns = number * self.period_ns
        return Message(
            topic=f"{self._root}/asterix/129",
            payload=block,
            content_type=asterix_content_type(129),
            due_utc_ns=t_utc_ns,
            qos=self._qos,
            properties=attributes(
                self._root, "asterix/129", f"{number}-{drone}", t_utc_ns, drone=drone
            ),
        )
