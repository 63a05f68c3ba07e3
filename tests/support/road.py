"""The whole road: a scene flown in simulated time, and what its messages say, as columns.

Plots are read from the bytes that left, as protobuf and as category 048, and joined with the ledger
of the truth topic: plots of a sector stand in the same order in all three.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, from_tree
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.frames import LocalFrame, aer_to_enu, wrap_180
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.ledger import entries_in

NS = 1_000_000_000
START_NS = 1_700_000_000 * NS
SITE = LocalFrame(40.45, -3.73, 650.0)

Array = NDArray[Any]


def staring(period_s: float = 1.0) -> dict[str, Any]:
    return {"kind": "staring", "period_s": period_s}


def rotating(period_s: float = 1.0, sectors: int = 8) -> dict[str, Any]:
    return {"kind": "rotating", "period_s": period_s, "sectors": sectors}


def radar(**changes: Any) -> dict[str, Any]:
    """A sensor of a scene: the paper's active radar, staring at the whole sky, without alarms.

    Like the paper's it has no errors but those of noise.
    """
    paper = {
        "id": "radar",
        "type": "active_radar",
        "report": ["asterix-048", "plots"],
        "scan": staring(),
        "power_w": 500.0,
        "frequency_hz": 10e9,
        "gain_tx_dbi": 20.0,
        "gain_rx_dbi": 35.4,
        "integration_s": 0.06,
        "loss_db": 4.0,
        "noise_figure_db": 5.0,
        "pfa": 1e-6,
        "n_reference": 16,
        "range_resolution_m": 10.0,
        "range_max_m": 20_000.0,
        "azimuth_beamwidth_deg": 2.0,
        "elevation_beamwidth_deg": 6.0,
        "elevation_min_deg": -10.0,
        "elevation_max_deg": 80.0,
        "range_floor_m": 0.0,
        "azimuth_floor_deg": 0.0,
        "elevation_floor_deg": 0.0,
    }
    return paper | changes


def waypoint(azimuth_deg: float, elevation_deg: float, range_m: float) -> dict[str, float]:
    """A place as it is seen from the site."""
    enu_m = aer_to_enu(azimuth_deg, elevation_deg, range_m)
    latitude_deg, longitude_deg, height_m = (float(x) for x in SITE.to_geodetic(enu_m))
    return {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "height_m": height_m}


def flown(name: str, *path: dict[str, float], **more: Any) -> dict[str, Any]:
    return {"id": name, "path": list(path), "speed_m_s": 10.0, "repeat": True} | more


def held(
    name: str, azimuth_deg: float, elevation_deg: float, range_m: float, **more: Any
) -> dict[str, Any]:
    """A drone that stays where it is, within a centimetre."""
    places = (waypoint(azimuth_deg, elevation_deg, r) for r in (range_m, range_m + 0.01))
    return flown(name, *places, speed_m_s=0.01, **more)


def scene(
    sensors: Sequence[dict[str, Any]],
    drones: Sequence[dict[str, Any]] = (),
    *,
    seed: int,
    folder: Path = Path(),
    **more: Any,
) -> Scene:
    general = {
        "name": "road",
        "seed": seed,
        "site": {
            "latitude_deg": SITE.latitude_deg,
            "longitude_deg": SITE.longitude_deg,
            "height_m": SITE.height_m,
        },
    }
    tree = {"scene": general, "sensor": list(sensors), "drone": list(drones)} | more
    return from_tree(tree, folder / "road.toml")


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one length, by name."""

    columns: dict[str, Array]

    def __getattr__(self, name: str) -> Array:
        try:
            return self.columns[name]
        except KeyError:
            raise AttributeError(name) from None

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def rows(self, which: Array) -> Self:
        return replace(self, columns={k: v[which] for k, v in self.columns.items()})


@dataclass(frozen=True, eq=False)
class Road:
    """What left."""

    messages: list[Message]
    _plots_of: dict[str, Table] = field(default_factory=dict)

    def payloads(self, topic: str) -> list[bytes]:
        return [m.payload for m in self.messages if m.topic == f"plotfeed/{topic}"]

    def looks(self, sensor: str = "radar") -> Table:
        """What the ledger says that the sensor looked at."""
        return self._looks[sensor]

    def plots(self, sensor: str = "radar") -> Table:
        """What the protobuf says was measured, what is true, and (rho, ...) what category 048 says.

        NaN is for what is absent. `drone` is empty for a false alarm.
        """
        if sensor not in self._plots_of:
            self._plots_of[sensor] = self._plots(sensor)
        return self._plots_of[sensor]

    @cached_property
    def ledgers(self) -> list[pb.Ledger]:
        return [entry for payload in self.payloads("truth") for entry in entries_in(payload)]

    @cached_property
    def _looks(self) -> dict[str, Table]:
        names = [f.name for f in pb.Look.DESCRIPTOR.fields]
        sensors = {entry.sensor for entry in self.ledgers}
        return {
            sensor: _table(
                [
                    (entry.scan, entry.sector, *(getattr(look, name) for name in names))
                    for entry in self.ledgers
                    if entry.sensor == sensor
                    for look in entry.looks
                ],
                ["scan", "sector", *names],
            )
            for sensor in sensors
        }

    def _plots(self, sensor: str) -> Table:
        truths = [entry for entry in self.ledgers if entry.sensor == sensor]
        batches = [pb.PlotBatch.FromString(p) for p in self.payloads(f"{sensor}/plots")]
        measured, true = _known(pb.Plot), ["drone", *_known(pb.PlotTruth)]
        rows = []
        for entry, batch in zip(truths, batches, strict=True):
            assert (entry.scan, entry.sector) == (batch.scan, batch.sector)
            for plot, truth in zip(batch.plots, entry.plots, strict=True):
                assert plot.time_utc_ns == truth.time_utc_ns
                rows.append(
                    (batch.scan, batch.sector, *_values(plot, measured), *_values(truth, true))
                )
        table = _table(rows, ["scan", "sector", *measured, *(f"true_{name}" for name in true)])
        table.columns["drone"] = table.columns.pop("true_drone")
        table.columns.update(self._asterix(sensor))
        return table

    def _asterix(self, sensor: str) -> dict[str, Array]:
        paths = {
            "time_of_day_s": "I048/140",
            "rho_nm": "I048/040/RHO",
            "theta_deg": "I048/040/THETA",
            "altitude_ft": "I048/110",
            "prl_deg": "I048/130/PRL",
            "pam_dbm": "I048/130/PAM",
            "doppler_m_s": "I048/120/CAL/CAL",
        }
        records = self.records(sensor, 48)
        if not records:
            return {}
        columns = {name: [r.get(path) for r in records] for name, path in paths.items()}
        return {name: np.array(values, dtype=np.float64) for name, values in columns.items()}

    def records(self, sensor: str, category: int) -> list[Record]:
        blocks = self.payloads(f"{sensor}/asterix/{category:03}")
        return [record for block in blocks for record in decode(block)]


def fly(scene: Scene, duration_s: float, start_ns: int = START_NS) -> Road:
    """The scene in simulated time."""
    messages: list[Message] = []

    def tap(message: Message, _sent_utc_ns: int) -> None:
        messages.append(message)

    clock = InstantClock(start_ns)
    asyncio.run(run(scene, clock=clock, broker="none", duration_s=duration_s, tap=tap))
    return Road(messages)


def _known(message: type[pb.Plot | pb.PlotTruth]) -> list[str]:
    """Its numbers: the time, and what may be absent."""
    return ["time_utc_ns", *(f.name for f in message.DESCRIPTOR.fields if f.has_presence)]


def _values(message: pb.Plot | pb.PlotTruth, names: Sequence[str]) -> Iterator[Any]:
    for name in names:
        is_there = name in ("drone", "time_utc_ns") or message.HasField(name)
        yield getattr(message, name) if is_there else np.nan


def _table(rows: list[tuple[Any, ...]], names: list[str]) -> Table:
    columns = list(zip(*rows, strict=True)) or [()] * len(names)
    return Table({name: np.array(column) for name, column in zip(names, columns, strict=True)})


def errors_of(plots: Table) -> dict[str, tuple[Array, Array]]:
    """Measured less true, and the stated standard deviation, by quantity."""
    return {
        "range": (plots.range_m - plots.true_range_m, plots.sigma_range_m),
        "azimuth": (wrap_180(plots.azimuth_deg - plots.true_azimuth_deg), plots.sigma_azimuth_deg),
        "elevation": (plots.elevation_deg - plots.true_elevation_deg, plots.sigma_elevation_deg),
    }
