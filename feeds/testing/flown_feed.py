"""A scene flown in simulated time: its messages, and what they say as columns beside the truth."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder, attachments_of
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.ledger import LedgerTables, entries_in, tables_of
from plotfeed.proto.utc import NS

START_NS = 1_700_000_000 * NS
# Columns of category 048, by the paths of their items.
ASTERIX_048 = {
    "time_of_day_s": "I048/140",
    "rho_nm": "I048/040/RHO",
    "theta_deg": "I048/040/THETA",
    "altitude_ft": "I048/110",
    "prl_deg": "I048/130/PRL",
    "pam_dbm": "I048/130/PAM",
    "doppler_m_s": "I048/120/CAL/CAL",
}

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class FeedTable:
    """Columns of one length (n,), each an attribute by its name."""

    columns: dict[str, Array]

    def __getattr__(self, name: str) -> Array:
        try:
            return self.columns[name]
        except KeyError:
            raise AttributeError(name) from None

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def rows(self, which: Array) -> Self:
        """The rows of a mask (n,), or of indices (m,)."""
        return replace(self, columns={k: v[which] for k, v in self.columns.items()})


@dataclass(frozen=True, eq=False)
class Feed:
    """All messages that left, in the order in which they did.

    Plots are read from the octets, as protobuf and as category 048, and joined with the ledger on
    the truth topic: plots of a sector stand in the same order in all three.
    """

    messages: list[Message]
    _plots_of: dict[str, FeedTable] = field(default_factory=dict)

    def payloads(self, topic: str) -> list[bytes]:
        """The payloads on a topic, which is told without the scene's prefix `plotfeed/`."""
        return [m.payload for m in self.messages if m.topic == f"plotfeed/{topic}"]

    def looks(self, sensor: str = "radar") -> FeedTable:
        """Looks of a sensor at drones as the ledger has them, each with its scan and sector."""
        return self._looks[sensor]

    def plots(self, sensor: str = "radar") -> FeedTable:
        """Plots of a sensor that reports `plots`: measured, true (`true_…`) and in category 048.

        The units are in the names: those of `Plot` and `PlotTruth`, and of `ASTERIX_048`. NaN is
        what is absent. `drone` is the drone's id, empty for a false alarm.
        """
        if sensor not in self._plots_of:
            self._plots_of[sensor] = self._plots(sensor)
        return self._plots_of[sensor]

    @cached_property
    def ledgers(self) -> list[pb.Ledger]:
        """The ledger's entries, one a sector and sensor."""
        return [entry for payload in self.payloads("truth") for entry in entries_in(payload)]

    def records(self, sensor: str, category: int) -> list[Record]:
        """The records of an ASTERIX category that a sensor reported."""
        blocks = self.payloads(f"{sensor}/asterix/{category:03}")
        return [record for block in blocks for record in decode(block)]

    @cached_property
    def _ledger(self) -> LedgerTables:
        return tables_of(self.payloads("truth"))

    @cached_property
    def _looks(self) -> dict[str, FeedTable]:
        names = [field.name for field in pb.Look.DESCRIPTOR.fields]
        sensors = set(self._ledger.entries.sensor.tolist())
        return {sensor: FeedTable(self._told(sensor, "looks", names)) for sensor in sensors}

    def _told(self, sensor: str, part: str, names: Sequence[str]) -> dict[str, Array]:
        """Columns of what its entries tell, by the names of the messages' fields."""
        told = self._ledger.of(np.flatnonzero(self._ledger.entries.sensor == sensor))
        held = dict(vars(getattr(told, part)))
        held |= {"time_utc_ns": held["t_utc_ns"]}
        held |= {name: vars(told.entries)[name][held["entry"]] for name in ("scan", "sector")}
        held |= {name: held[name].astype(str) for name in ("drone", "other")}
        return {name: held[name] for name in ("scan", "sector", *names)}

    def _plots(self, sensor: str) -> FeedTable:
        batches = [pb.PlotBatch.FromString(p) for p in self.payloads(f"{sensor}/plots")]
        plots = [
            {"scan": batch.scan, "sector": batch.sector}
            | {field.name: value for field, value in plot.ListFields()}
            for batch in batches
            for plot in batch.plots
        ]
        known, alike = _known(pb.PlotTruth), ("scan", "sector", "time_utc_ns")
        names = ("scan", "sector", *_known(pb.Plot))
        columns = {name: np.array([plot.get(name, np.nan) for plot in plots]) for name in names}
        true = self._told(sensor, "plots", ["drone", *known])
        if (self._ledger.entries.sensor == sensor).sum() != len(batches) or not all(
            np.array_equal(columns[name], true[name]) for name in alike
        ):
            raise ValueError(f"{sensor}: plots and ledger are of different sectors")
        columns |= {"drone": true["drone"], **{f"true_{name}": true[name] for name in known}}
        if records := self.records(sensor, 48):
            columns |= {
                name: np.array([r.get(path) for r in records], dtype=np.float64)
                for name, path in ASTERIX_048.items()
            }
        return FeedTable(columns)


def fly(
    scene: Scene,
    duration_s: float,
    start_ns: int = START_NS,
    *,
    record: Path | None = None,
    observers: Sequence[Observer] = (),
) -> Feed:
    """The feed of a scene in that many seconds of simulated time, from `start_ns` (UTC) on.

    It is returned as soon as it is worked out; links delay and lose what the scene says. `record`
    is a new file for the whole session, an MCAP that `plotfeed replay`, `report` and `score` read;
    `observers` are told of the session as it goes.
    """
    messages: list[Message] = []

    def tap(message: Message, _sent_utc_ns: int) -> None:
        messages.append(message)

    with ExitStack() as files:
        if record is not None:
            recorder = Recorder(record, attachments=attachments_of(scene, start_ns), waits=True)
            files.enter_context(recorder)
            recording = SessionRecorder(recorder, ledger_is_sent=scene.mqtt.truth)
            observers = [recording, *observers]
        asyncio.run(
            run(
                scene,
                clock=InstantClock(start_ns),
                broker="none",
                duration_s=duration_s,
                observers=observers,
                tap=tap,
            )
        )
    return Feed(messages)


def _known(message: type[pb.Plot | pb.PlotTruth]) -> list[str]:
    """The names of its numbers: the time, and what may be absent."""
    return ["time_utc_ns", *(f.name for f in message.DESCRIPTOR.fields if f.has_presence)]
