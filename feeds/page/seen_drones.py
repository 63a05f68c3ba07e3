"""Drones of a recording: where the ledger says that sensors looked at them, and on from there."""

from __future__ import annotations

from bisect import insort
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from plotfeed.feeds.places import frame_at
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.sensors import Sensor
from plotfeed.feeds.times import NS
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.state import Floats, Ints, Looks, Plots, TruthState
from plotfeed.models.truth import fit_velocity

KEPT = 12
"""Places of a drone, the latest ones."""
SIGMA_M = 0.1
"""A velocity is fitted to places as if they were known so well, so that it is that of now."""
SCANS = 2.5
"""A drone that no sensor has looked at for so many of the longest scans is not there."""


class _Seen(NamedTuple):
    t_ns: int
    position_ecef_m: Floats
    velocity_ecef_m_s: Floats


class SeenDrones:
    """Positions by sensors that stand straight; of one that does not, the ledger's looks err."""

    def __init__(self, scene: Scene) -> None:
        self._frames = {s.id: frame_at(scene.scene.site, s.position_enu_m) for s in scene.sensor}
        self._straight = {s.id for s in scene.sensor if _is_straight(s)}
        longest_s = max(sensor.scan.period_s for sensor in scene.sensor)
        self._alive_ns = round(max(scene.telemetry.stale_after_s, SCANS * longest_s) * NS)
        self._places: dict[int, list[tuple[int, Floats]]] = {}
        self._latest: dict[int, _Seen] = {}
        self._changed: set[int] = set()
        """Drones that were seen since the last were worked out."""

    def take(self, sensor: str, looks: Looks, plots: Plots) -> None:
        """What a sensor looked at, or else what its plots truly were."""
        if sensor not in self._frames:
            return
        if sensor in self._straight:
            geometry = (looks.azimuth_deg, looks.elevation_deg, looks.range_m)
            self._take(sensor, looks.drone, looks.t_utc_ns, geometry)
        else:
            true = (plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
            self._take(sensor, plots.drone, plots.t_utc_ns, true)

    def state_at(self, t_utc_ns: int) -> TruthState:
        """Those that are there then, moved on from where they were seen last."""
        for drone in self._changed:
            times, positions = zip(*self._places[drone], strict=True)
            velocity_m_s = fit_velocity(times, positions, SIGMA_M)
            self._latest[drone] = _Seen(times[-1], positions[-1], velocity_m_s)
        self._changed.clear()
        there = [(k, v) for k, v in self._latest.items() if t_utc_ns - v.t_ns <= self._alive_ns]
        since_s = np.array([(t_utc_ns - seen.t_ns) / NS for _, seen in there])
        position_m = np.array([seen.position_ecef_m for _, seen in there]).reshape(-1, 3)
        velocity_m_s = np.array([seen.velocity_ecef_m_s for _, seen in there]).reshape(-1, 3)
        return TruthState(
            drone=np.array([drone for drone, _ in there], np.int64),
            t_utc_ns=np.full(len(there), t_utc_ns),
            position_ecef_m=position_m + since_s[:, None] * velocity_m_s,
            velocity_ecef_m_s=velocity_m_s,
        )

    def _take(
        self, sensor: str, drones: Ints, t_utc_ns: Ints, geometry: tuple[Floats, Floats, Floats]
    ) -> None:
        there = (drones >= 0) & np.isfinite(geometry).all(axis=0)
        place_m = self._frames[sensor].to_ecef(aer_to_enu(*(part[there] for part in geometry)))
        times = t_utc_ns[there].tolist()
        for drone, t_ns, position in zip(drones[there].tolist(), times, place_m, strict=True):
            self._note(drone, t_ns, position)

    def _note(self, drone: int, t_ns: int, position_ecef_m: Floats) -> None:
        """Sensors tell of the same time, and of earlier ones, too."""
        places = self._places.setdefault(drone, [])
        if any(t_ns == other_ns for other_ns, _ in places):
            return
        insort(places, (t_ns, position_ecef_m), key=itemgetter(0))
        del places[:-KEPT]
        self._changed.add(drone)


def _is_straight(sensor: Sensor) -> bool:
    return sensor.bias is None and sensor.drift is None
