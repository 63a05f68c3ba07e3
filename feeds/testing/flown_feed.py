"""A scene flown in simulated time: its messages, and what they say as columns beside the truth."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
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
from plotfeed.proto.ledger import entries_in
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
    def _looks(self) -> dict[str, FeedTable]:
        names = [f.name for f in pb.Look.DESCRIPTOR.fields]
        rows: dict[str, list[tuple[Any, ...]]] = {entry.sensor: [] for entry in self.ledgers}
        for entry in self.ledgers:
            rows[entry.sensor] += [
                (entry.scan, entry.sector, *(getattr(look, name) for name in names))
                for look in entry.looks
            ]
        return {sensor: _table(of, ["scan", "sector", *names]) for sensor, of in rows.items()}

    def _plots(self, sensor: str) -> FeedTable:
        truths = [entry for entry in self.ledgers if entry.sensor == sensor]
        batches = [pb.PlotBatch.FromString(p) for p in self.payloads(f"{sensor}/plots")]
        measured, true = _known(pb.Plot), ["drone", *_known(pb.PlotTruth)]
        rows = []
        for entry, batch in zip(truths, batches, strict=True):
            for plot, truth in zip(batch.plots, entry.plots, strict=True):
                of = (entry.scan, entry.sector), (batch.scan, batch.sector)
                if of[0] != of[1] or plot.time_utc_ns != truth.time_utc_ns:
                    raise ValueError(f"{sensor}: {of}: plots and ledger are of different sectors")
                rows.append((*of[0], *_values(plot, measured), *_values(truth, true)))
        table = _table(rows, ["scan", "sector", *measured, *(f"true_{name}" for name in true)])
        table.columns["drone"] = table.columns.pop("true_drone")
        if records := self.records(sensor, 48):
            table.columns.update(
                (name, np.array([r.get(path) for r in records], dtype=np.float64))
                for name, path in ASTERIX_048.items()
            )
        return table


def fly(
    scene: Scene, duration_s: float, start_ns: int = START_NS, *, record: Path | None = None
) -> Feed:
    """The feed of a scene in that many seconds of simulated time, from `start_ns` (UTC) on.

    It is returned as soon as it is worked out; links delay and lose what the scene says. `record`
    is a new file for the whole session, an MCAP that `plotfeed replay`, `report` and `score` read.
    """
    messages: list[Message] = []

    def tap(message: Message, _sent_utc_ns: int) -> None:
        messages.append(message)

    with ExitStack() as files:
        observers: list[Observer] = []
        if record is not None:
            recorder = Recorder(record, attachments=attachments_of(scene, start_ns), waits=True)
            files.enter_context(recorder)
            observers.append(SessionRecorder(recorder, ledger_is_sent=scene.mqtt.truth))
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


def _values(message: pb.Plot | pb.PlotTruth, names: Sequence[str]) -> Iterator[Any]:
    for name in names:
        is_there = name in ("drone", "time_utc_ns") or message.HasField(name)
        yield getattr(message, name) if is_there else np.nan


def _table(rows: list[tuple[Any, ...]], names: list[str]) -> FeedTable:
    columns = list(zip(*rows, strict=True)) or [()] * len(names)
    return FeedTable({name: np.array(column) for name, column in zip(names, columns, strict=True)})
