"""What a scene's sensors report, as NumPy columns, worked out at once: no broker, clock or loop."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from plotfeed.feeds.engine.engine import Engine, scene_of
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.beam import Sectors
from plotfeed.models.sensors.sensor_model import NO_LOOKS, NO_PLOTS
from plotfeed.models.state import Columns, Floats, Ints, Looks, Plots
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS

STRETCH_NS = NS  # Worked out at once: longer, a sector hardly costs less


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

    sensor: Sensor  # Its keys, as the scene has them
    plots: SimulatedPlots  # A row a plot, false alarms among them, in the order of time
    # A row a drone and look, detected or not: geometry, SNR (linear) and Pd as they truly were.
    looks: SimulatedLooks
    # Its sectors in the order of time, whether they brought anything or not.
    sectors: Sectors = field(default_factory=lambda: Sectors.of([]))
    drones: Sequence[str] = ()  # Names of drones, by their numbers


class Simulation(Mapping[str, SimulatedSensor]):
    """What each sensor of a scene reported, by the sensor's id.

    The columns are those of `plotfeed.models.state.Plots` and `Looks`, (n,), with `scan` and
    `sector` beside them; unit and frame are in each name. Distances, azimuths (clockwise from true
    north) and elevations (above the horizontal) are seen from the sensor, heights are above the
    WGS-84 ellipsoid, times nanoseconds of UTC since 1970. NaN is what the sensor does not measure.
    """

    def __init__(
        self, sensors: Mapping[str, SimulatedSensor], trajectories: Trajectories, start_utc_ns: int
    ) -> None:
        self._sensors = dict(sensors)
        self._trajectories = trajectories
        # Ids, by the index in the columns `drone`, where -1 (`FALSE_ALARM`) is of no drone.
        self.drones = tuple(trajectories.names)
        self.start_utc_ns = start_utc_ns  # When it began, UTC since 1970

    def __getitem__(self, sensor: str) -> SimulatedSensor:
        return self._sensors[sensor]

    def __iter__(self) -> Iterator[str]:
        return iter(self._sensors)

    def __len__(self) -> int:
        return len(self._sensors)

    def place_ecef_m(self, drone: Ints, t_utc_ns: Ints) -> Floats:
        """Places of drones, by index, at times, metres; (n,) each in, (n, 3) out, NaN of none."""
        return self._trajectories.position_at(t_utc_ns, drone)


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
    scene = scene_of(scene)
    if seed is not None:
        general = scene.scene.model_copy(update={"seed": seed})
        scene = scene.model_copy(update={"scene": general})
    if start_utc_ns is None:
        start_utc_ns = scene.scene.start_utc_ns or time.time_ns()
    engine = Engine(scene, start_utc_ns)
    end_utc_ns = start_utc_ns + round(duration_s * NS)
    parts: list[list[Batch]] = [[] for _ in scene.sensor]  # Of each sensor
    for before_ns in (*range(start_utc_ns + STRETCH_NS, end_utc_ns, STRETCH_NS), end_utc_ns + 1):
        for seen in engine.until(before_ns - 1, messages=False):
            for i in np.unique(seen.sectors.sensor).tolist():
                parts[i].append(seen.rows(np.flatnonzero(seen.sectors.sensor == i)))
    found = {}
    for sensor, of_sensor in zip(scene.sensor, parts, strict=True):
        whole = Batch.joined(of_sensor or [NOTHING])
        found[sensor.id] = SimulatedSensor(
            sensor=sensor,
            plots=of_sectors(SimulatedPlots, whole.plots, whole.plots_by, whole.sectors),
            looks=of_sectors(SimulatedLooks, whole.looks, whole.looks_by, whole.sectors),
            sectors=whole.sectors,
            drones=engine.trajectories.names,
        )
    return Simulation(found, engine.trajectories, start_utc_ns)


C = TypeVar("C", bound=Columns)
NO_ROWS = np.zeros(1, np.int64)
NOTHING = Batch(Sectors.of([]), NO_PLOTS, NO_ROWS, NO_LOOKS, NO_ROWS)


def of_sectors(kind: type[C], columns: Columns, offsets: Ints, sectors: Sectors) -> C:
    """Rows with the scan and the sector that each belongs to, and no word of whose they are."""
    row = np.repeat(np.arange(len(sectors)), np.diff(offsets))
    held = {name: column for name, column in vars(columns).items() if name != "sensor"}
    return kind.holding(held | {"scan": sectors.scan[row], "sector": sectors.index[row]})
