"""What a scene's sensors report, as NumPy columns, worked out at once: no broker, clock or loop."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from plotfeed.feeds.scene.changes import changed, in_force
from plotfeed.feeds.scene.scene import Scene, example, load
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.sensing.emulated_sensor import AHEAD_NS, EmulatedSensor
from plotfeed.feeds.sensing.scene_drones import launch
from plotfeed.models.beam import Sector
from plotfeed.models.sensors.sensor_model import NO_LOOKS, NO_PLOTS
from plotfeed.models.state import Columns, Ints, Looks, Plots
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS


@dataclass(frozen=True, kw_only=True)
class SimulatedLooks(Looks):
    """Looks of a whole simulation, each with the scan and the sector that it belongs to."""

    scan: Ints
    sector: Ints


@dataclass(frozen=True, kw_only=True)
class SimulatedPlots(Plots):
    """Plots of a whole simulation, each with the scan and the sector that it belongs to."""

    scan: Ints
    sector: Ints


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedSensor:
    """What one sensor did: columns of what it measured, and of what it might have measured."""

    sensor: Sensor
    """Its keys, as the scene has them."""
    plots: SimulatedPlots
    """A row a plot, false alarms among them, in the order of time."""
    looks: SimulatedLooks
    """A row a drone and look, detected or not: geometry, SNR (linear) and Pd as they truly were."""


class Simulation(Mapping[str, SimulatedSensor]):
    """What each sensor of a scene reported, by the sensor's id.

    The columns are those of `plotfeed.models.state.Plots` and `Looks`, (n,), with `scan` and
    `sector` beside them; unit and frame are in each name. Distances, azimuths (clockwise from true
    north) and elevations (above the horizontal) are seen from the sensor, heights are above the
    WGS-84 ellipsoid, times nanoseconds of UTC since 1970. NaN is what the sensor does not measure.
    """

    def __init__(
        self, sensors: Mapping[str, SimulatedSensor], drones: Sequence[str], start_utc_ns: int
    ) -> None:
        self._sensors = dict(sensors)
        self.drones = tuple(drones)
        """Ids, by the index in the columns `drone`, where -1 (`FALSE_ALARM`) is of no drone."""
        self.start_utc_ns = start_utc_ns
        """When it began, UTC since 1970."""

    def __getitem__(self, sensor: str) -> SimulatedSensor:
        return self._sensors[sensor]

    def __iter__(self) -> Iterator[str]:
        return iter(self._sensors)

    def __len__(self) -> int:
        return len(self._sensors)


def simulate(
    scene: Scene | str | Path,
    duration_s: float,
    *,
    seed: int | None = None,
    start_utc_ns: int | None = None,
) -> Simulation:
    """What the sensors of a scene report in that time; raises `PlotfeedError`.

    The scene is a loaded one, the name of one that comes with plotfeed ("section-4"), or the path
    of a file. `seed` and `start_utc_ns` are in place of the scene's own; without either start the
    simulation begins now. Drones are those that the scene flies by itself.

    Plots are those of a session of that start and seed, [[sensor.event]] included, up to the last
    sector that ends within the duration. They are what sensors hand to their links: links, formats
    and the clocks of sensors (`bias.time_offset_s`) are not applied, and nothing is sent.
    """
    if not isinstance(scene, Scene):
        is_name = isinstance(scene, str) and re.fullmatch(r"[\w-]+", scene)
        scene = example(str(scene)) if is_name else load(scene)
    if seed is not None:
        general = scene.scene.model_copy(update={"seed": seed})
        scene = scene.model_copy(update={"scene": general})
    if start_utc_ns is None:
        start_utc_ns = scene.scene.start_utc_ns or time.time_ns()
    trajectories = Trajectories(stale_after_s=scene.telemetry.stale_after_s)
    launch(scene, trajectories, start_utc_ns)
    end_utc_ns = start_utc_ns + round(duration_s * NS)
    sensors = {
        sensor.id: _simulated(
            sensor, EmulatedSensor(scene, sensor, trajectories), start_utc_ns, end_utc_ns
        )
        for sensor in scene.sensor
    }
    return Simulation(sensors, trajectories.names, start_utc_ns)


def _simulated(
    sensor: Sensor, emulated: EmulatedSensor, start_utc_ns: int, end_utc_ns: int
) -> SimulatedSensor:
    looks, plots = [], []
    for sector in _sectors(sensor, emulated, start_utc_ns, end_utc_ns):
        seen, measured = emulated.look(sector)
        looks.append(_of_sector(SimulatedLooks, seen, sector))
        plots.append(_of_sector(SimulatedPlots, measured, sector))
    nothing = Sector(0, 0, 0, 0, 0.0, 0.0)
    return SimulatedSensor(
        sensor=sensor,
        plots=SimulatedPlots.joined(plots or [_of_sector(SimulatedPlots, NO_PLOTS, nothing)]),
        looks=SimulatedLooks.joined(looks or [_of_sector(SimulatedLooks, NO_LOOKS, nothing)]),
    )


def _sectors(
    sensor: Sensor, emulated: EmulatedSensor, start_utc_ns: int, end_utc_ns: int
) -> Iterator[Sector]:
    """The whole sectors of a sensor that is switched on, with its events in force meanwhile."""
    sector = emulated.sector_at(start_utc_ns)
    if sector.start_ns < start_utc_ns:
        sector = emulated.next_sector(sector)
    before: list[Mapping[str, Any]] = []
    while sector.end_ns <= end_utc_ns:
        # As of the time at which a session works a sector out.
        elapsed_ns = max(sector.end_ns - AHEAD_NS, sector.start_ns) - start_utc_ns
        changes = in_force(sensor.event, elapsed_ns)
        if changes != before:
            emulated.change(changed(sensor, *changes))
            before = changes
        if emulated.sensor.enabled:
            yield sector
        sector = emulated.next_sector(sector)


C = TypeVar("C", bound=Columns)


def _of_sector(kind: type[C], columns: Columns, sector: Sector) -> C:
    number = np.full(len(columns), 1)
    return kind.holding(
        {**vars(columns), "scan": sector.scan * number, "sector": sector.index * number}
    )
