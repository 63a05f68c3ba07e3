"""What came of sectors of many sensors, drawn at random: what formats are given."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.every_kind import GATE, PASSIVE, RF

from plotfeed.feeds.formats import Batch
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.beam import Sectors
from plotfeed.models.state import Looks, Plots
from plotfeed.testing import START_NS, radar, rotating, scene

NS = 1_000_000_000
KINDS: dict[str, dict[str, Any]] = {
    "rotating": radar(scan=rotating(1.0, 32)),
    "staring": radar(),
    "passive": PASSIVE,
    "gate": GATE,
    "rf": RF | {"azimuth_floor_deg": 2.0},
}
POLAR = {
    "range_m": (100.0, 9e4),
    "azimuth_deg": (0.0, 360.0),
    "elevation_deg": (-5.0, 80.0),
    "height_m": (0.0, 5000.0),
    "amplitude_dbm": (-120.0, 0.0),
    "run_length_deg": (0.0, 11.0),
    "snr": (10.0, 1e6),
    "sigma_range_m": (1.0, 9.0),
    "sigma_azimuth_deg": (0.1, 0.9),
    "sigma_elevation_deg": (0.1, 0.9),
}
# What the plots of a sensor hold, and between which limits.
MEASURED: dict[str, dict[str, tuple[float, float]]] = {
    "rotating": POLAR,
    "staring": POLAR,
    "passive": {
        "azimuth_deg": (0.0, 360.0),
        "bistatic_range_m": (100.0, 2e4),
        "sigma_bistatic_range_m": (1.0, 9.0),
        "sigma_azimuth_deg": (0.1, 0.9),
        "snr": (10.0, 1e6),
    },
    "gate": {"range_m": (100.0, 9000.0), "sigma_range_m": (3.0, 3.0)},
    "rf": {"azimuth_deg": (0.0, 360.0), "snr": (10.0, 1e4), "amplitude_dbm": (-99.0, -20.0)},
}


def scene_of(kind: str, count: int, report: list[str], **more: Any) -> Scene:
    """A scene of so many sensors of a kind, each with a SAC, SIC and place of its own."""
    sensors = [
        KINDS[kind]
        | {"id": f"{kind}-{i}", "report": report, "sac": i % 256, "sic": i * 7 % 256}
        | {"position_enu_m": [100.0 * i, -50.0 * i, float(i)]}
        for i in range(count)
    ]
    return scene(sensors, seed=1, **more)


def sectors_of(made: Scene, sensors: NDArray[np.int64], numbers: NDArray[np.int64]) -> Sectors:
    """Sectors of sensors of the scene, by how many sectors of each came before; (m,)."""
    every = [made.sensor[i].scan for i in sensors.tolist()]
    n = np.array([scan.sectors for scan in every])
    period_ns = np.array([scan.period_ns for scan in every])
    scan = START_NS // period_ns + numbers // n
    index = numbers % n
    return Sectors(
        sensor=sensors,
        scan=scan,
        index=index,
        start_ns=scan * period_ns + period_ns * index // n,
        end_ns=scan * period_ns + period_ns * (index + 1) // n,
        start_deg=360.0 * index / n,
        end_deg=360.0 * (index + 1) / n,
        stares=n == 1,
    )


def seen_by(
    kind: str, sectors: Sectors, counts: NDArray[np.int64], rng: np.random.Generator
) -> Batch:
    """So many plots in each of the sectors, (m,), of what sensors of the kind measure."""
    plots_by = np.concatenate([[0], np.cumsum(counts)])
    rows = np.repeat(np.arange(len(sectors)), counts)
    width_ns = (sectors.end_ns - sectors.start_ns)[rows]
    t_utc_ns = sectors.start_ns[rows] + (rng.random(len(rows)) * width_ns).astype(np.int64)
    order = np.lexsort((t_utc_ns, rows))
    columns: dict[str, NDArray[Any]] = {
        name: rng.uniform(low, high, len(rows)) for name, (low, high) in MEASURED[kind].items()
    }
    if kind == "passive":
        columns["channel"] = np.zeros(len(rows), np.int64)
    if kind == "rf":
        columns["kind"] = rng.choice(np.array(["", "video"], np.object_), len(rows))
    plots = Plots.of(t_utc_ns=t_utc_ns[order], drone=rng.integers(-1, 5, len(rows)), **columns)
    looks, looks_by = looks_at(sectors, plots.drone, rows)
    return Batch(sectors, plots, plots_by, looks, looks_by)


def looks_at(
    sectors: Sectors, drones: NDArray[np.int64], rows: NDArray[np.int64]
) -> tuple[Looks, NDArray[np.int64]]:
    """A look at each drone that plots of sectors, (n,), are of, and which are whose."""
    of, drone = np.unique(np.array([rows, drones])[:, drones >= 0], axis=1)
    number = np.ones(len(of))
    looks = Looks(
        drone=drone,
        channel=np.zeros(len(of), np.int64),
        t_utc_ns=sectors.start_ns[of],
        range_m=number,
        azimuth_deg=number,
        elevation_deg=number,
        snr=number,
        pd=number,
        detected=number > 0,
    )
    return looks, np.searchsorted(of, np.arange(len(sectors) + 1))
