"""Runs a shipped scene in simulated time, without a broker, and keeps what its sensors sent."""

from __future__ import annotations

import asyncio
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, from_tree
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto import plotfeed_pb2 as pb

START_UTC_NS = int(datetime(2026, 1, 1, 12, tzinfo=UTC).timestamp()) * 10**9
"""Always the same, so that a picture drawn again is the same picture."""
Tree = dict[str, Any]


@dataclass(slots=True)
class Sent:
    """The plots that one sensor sent, and the ledger beside them, sector by sector."""

    batches: list[pb.PlotBatch] = field(default_factory=list)
    ledgers: list[pb.Ledger] = field(default_factory=list)

    def plots(self) -> Iterator[tuple[pb.Plot, pb.PlotTruth]]:
        """Every plot with what is true of it."""
        for batch, ledger in zip(self.batches, self.ledgers, strict=True):
            assert (batch.scan, batch.sector) == (ledger.scan, ledger.sector)  # noqa: S101
            yield from zip(batch.plots, ledger.plots, strict=True)

    def looks(self) -> Iterator[pb.Look]:
        """Every time that a drone was illuminated."""
        for ledger in self.ledgers:
            yield from ledger.looks


def scene_with(sensor: str, drones: Sequence[Tree] = ()) -> Tree:
    """Scene section-4 with that sensor alone, and with those drones in place of its own."""
    tree = tomllib.loads((files("plotfeed.feeds.scene.examples") / "section-4.toml").read_text())
    tree["sensor"] = [s for s in tree["sensor"] if s["id"] == sensor]
    tree["drone"] = list(drones) or tree["drone"]
    return tree


def sent_by(tree: Tree, duration_s: float) -> Sent:
    """What the one sensor of a scene sends in that time."""
    (sent,) = sent_by_sensors(from_tree(tree, Path("section-4.toml")), duration_s).values()
    return sent


def sent_by_sensors(scene: Scene, duration_s: float) -> dict[str, Sent]:
    """What each sensor of a scene sends in that time, by its id."""
    found = {sensor.id: Sent() for sensor in scene.sensor}

    def tap(message: Message, _sent_utc_ns: int) -> None:
        kind = message.topic.rpartition("/")[2]
        if kind == "plots":
            batch = pb.PlotBatch.FromString(message.payload)
            found[batch.sensor].batches.append(batch)
        elif kind == "truth":
            ledger = pb.Ledger.FromString(message.payload)
            found[ledger.sensor].ledgers.append(ledger)

    clock = InstantClock(START_UTC_NS)
    asyncio.run(run(scene, clock=clock, broker="none", duration_s=duration_s, tap=tap))
    return found
