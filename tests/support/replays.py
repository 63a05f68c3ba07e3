"""Recordings in memory, and what a replay of them does, under a simulated clock or a real one."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from support.recordings import mcap_of
from support.waiting import PATIENCE_S

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.replaying.replay_settings import ReplaySettings
from plotfeed.feeds.replaying.replayer import Replayer
from plotfeed.feeds.replaying.routes import ReplayCounters
from plotfeed.feeds.timing.clock import Clock, InstantClock
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.recorded import Recorded, Stage

S = 1_000_000_000
MS = 1_000_000
RECORDED = 1_767_268_800 * S  # When the recordings of tests begin
REPLAYED = RECORDED + 1_000_000 * S + 7  # When simulated replays begin


def message(
    since_ns: int,
    topic: str = "plotfeed/radar/plots",
    payload: bytes = b"",
    *,
    stage: Stage = Stage.AFTER,
    publish_since_ns: int | None = None,
    **more: object,
) -> Recorded:
    return Recorded(
        topic=topic,
        payload=payload or since_ns.to_bytes(8, "big", signed=True),
        log_time_ns=RECORDED + since_ns,
        publish_time_ns=RECORDED + (since_ns if publish_since_ns is None else publish_since_ns),
        stage=stage,
        **more,  # type: ignore[arg-type]
    )


REGULAR = [message(i * 100 * MS) for i in range(10)]  # A message every 100 ms
TYPE = "application/x-protobuf; messageType=plotfeed.v1.PlotBatch"
# A status, plots of either QoS, the last of which says so, and truth, which is not replayed.
SESSION = [
    message(0, "plotfeed/radar/status", b"{}", content_type="application/json", retain=True, qos=1),
    *(
        message(i * MS, "plotfeed/radar/plots", bytes([i]) * 30, content_type=TYPE, qos=i % 2,
                properties=(("time", iso_utc(RECORDED)), ("n", str(i))))
        for i in range(1, 40)
    ),
    message(41 * MS, "plotfeed/truth", b"secret"),
    message(42 * MS, "plotfeed/radar/plots", b"last", content_type=TYPE),
]  # fmt: skip


class Memory:
    """A recording that is a list."""

    def __init__(self, messages: Sequence[Recorded]) -> None:
        self._messages = messages

    def messages(self, start_ns: int | None, end_ns: int | None) -> Iterator[Recorded]:
        for each in self._messages:
            if (start_ns is None or each.log_time_ns >= start_ns) and (
                end_ns is None or each.log_time_ns < end_ns
            ):
                yield each


@dataclass(eq=False)
class Ears:
    """A way out that notes what leaves and when."""

    clock: Clock
    heard: list[tuple[int, Message]] = field(default_factory=list)
    on_message: Callable[[Message], object] = lambda _: None
    carries_it: Callable[[Message], bool] = lambda _: True

    def publish(self, outgoing: Sequence[Message]) -> None:
        for delivery in outgoing:
            self.heard.append((self.clock.now_ns(), delivery))
            delivery.leave()
            delivery.settle(delivered=True)
            self.on_message(delivery)

    def prepare(self, messages: Sequence[Message]) -> None:
        pass

    async def drain(self, timeout_s: float = 1.0) -> None:
        pass

    def carries(self, message: Message) -> bool:
        return self.carries_it(message)

    def times(self) -> list[int]:
        """When messages left, since the first."""
        return [t - self.heard[0][0] for t, _ in self.heard]

    def payloads(self) -> list[bytes]:
        return [message.payload for _, message in self.heard]


def since(*steps_ms: float) -> list[int]:
    """Milliseconds as nanoseconds."""
    return [round(step * MS) for step in steps_ms]


def log_file(folder: Path, recorded: Sequence[Recorded]) -> Path:
    """An MCAP file of these messages."""
    path = folder / "session.mcap"
    path.write_bytes(mcap_of(recorded, attachments=()))
    return path


async def simulated(
    messages: Sequence[Recorded],
    settings: ReplaySettings | None = None,
    *,
    replayer: Replayer | None = None,
    on_message: Callable[[Message], object] = lambda _: None,
    begin_utc_ns: int = REPLAYED,
) -> tuple[Ears, ReplayCounters]:
    """What leaves in a replay under a clock that jumps from deadline to deadline."""
    replayer = replayer or Replayer(settings, clock=InstantClock(begin_utc_ns))
    ears = Ears(replayer.clock, on_message=on_message)
    async with asyncio.timeout(PATIENCE_S):
        totals = await replayer.run(Memory(messages), [ears])
    return ears, totals
