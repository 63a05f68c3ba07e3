"""Live sources: MAVLink messages a second beside pymavlink's parser, and from packet to plot.

    python tools/benchmarks/bench_live.py [TRIALS]

The stream is an autopilot's: of ten messages two are wanted. From packet to plot it takes until a
staring radar has looked: half its period on average, and the two ticks that a report waits.
"""

from __future__ import annotations

import asyncio
import socket
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

from aims import YARDSTICK, ratios, spread, table, yardstick_us
from pymavlink.dialects.v20 import common  # type: ignore[import-untyped]
from support.brokers import free_port
from support.sessions import at_work

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.live.mavlink import MavlinkReports
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.testing import radar, scene, staring

NS = 1_000_000_000
NOW_NS = 1_767_268_800 * NS
ROUNDS, RUNS, TRIALS = 500, 5, 20
PERIOD_S = 0.1
STALE_S = 0.3


def frames(system: int, boot_ms: int) -> list[bytes]:
    """Ten messages of one round, of which two say where it is."""
    mav = common.MAVLink(None, srcSystem=system, srcComponent=1)
    place = (404_600_000, -37_300_000, 850_000)
    messages = [
        mav.global_position_int_encode(boot_ms, *place, 100_000, 100, 200, 0, 9000),
        mav.gps_raw_int_encode(boot_ms * 1000, 3, *place, 80, 120, 500, 9000, 14),
        mav.heartbeat_encode(2, 12, 0, 0, 4),
        *(mav.attitude_encode(boot_ms + n, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0) for n in range(4)),
        *(mav.vfr_hud_encode(10.0, 10.0, 90, 50, 850.0, 0.1) for _ in range(3)),
    ]
    return [bytes(message.pack(mav)) for message in messages]


def each_us(work: Callable[[], int]) -> float:
    """Processor time a message, microseconds."""
    start_s = time.process_time()
    number = work()
    return (time.process_time() - start_s) / number * 1e6


def show_costs() -> None:
    """Our way through a stream and pymavlink's, by turns."""
    datagrams = [b"".join(frames(1, 100 * n)) for n in range(ROUNDS)]

    def ours() -> int:
        listener = MavlinkReports("mav-{system}")
        for n, datagram in enumerate(datagrams):
            for heard in listener.hear("1.2.3.4:5", datagram, NOW_NS + n * NS // 10):
                if isinstance(heard.said, PositionReport):
                    heard.said.to_protobuf()
        return 10 * ROUNDS

    def theirs() -> int:
        parser: Any = common.MAVLink(None)
        return sum(len(parser.parse_buffer(bytearray(datagram))) for datagram in datagrams)

    ours(), theirs()
    runs = [(each_us(ours), each_us(theirs), yardstick_us()) for _ in range(RUNS)]
    mine, other, yardstick = (list(column) for column in zip(*runs, strict=True))
    print(f"{YARDSTICK}\n")
    rows = (
        ("plotfeed, to telemetry in protobuf, µs a message", spread(mine)),
        ("pymavlink's parser, to its messages, µs a message", spread(other)),
        ("pymavlink's, times plotfeed's", spread(ratios(other, mine))),
        ("messages a second of one core", f"{1e6 / statistics.median(mine):,.0f}"),
        ("a yardstick in messages", spread(ratios(yardstick, mine), ",.0f")),
    )
    head = f"MAVLink, 2 of 10 messages wanted; {RUNS} runs by turns", "median (least to most)"
    table(head, rows)


def seeing(port: int) -> Scene:
    """A staring radar that sees all there is, and nothing that is not."""
    telemetry = {"stale_after_s": STALE_S, "source": [{"url": f"mavlink:udp::{port}"}]}
    sensor = radar(scan=staring(PERIOD_S), pfa=1e-14, power_w=1e6)
    return scene([sensor], seed=1, telemetry=telemetry)


async def latencies_s(trials: int) -> list[float]:
    """From the first packet of a new drone to the first plot."""
    port, found = free_port(), list[float]()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        async with at_work(seeing(port), None) as session:
            for trial in range(trials):
                await asyncio.sleep(3 * STALE_S + 1.0 + trial * 0.0137)  # at any part of a period
                before, began_s = session.totals.plots, time.monotonic()
                boot_ms = 1000
                while session.totals.plots == before and time.monotonic() < began_s + 5:
                    sender.sendto(frames(1 + trial, boot_ms)[0], ("127.0.0.1", port))
                    boot_ms += 20
                    for _ in range(20):
                        await asyncio.sleep(0.001)
                        if session.totals.plots != before:
                            break
                found.append(time.monotonic() - began_s)
    return found


def main(trials: int) -> None:
    """Measure and print."""
    show_costs()
    found = asyncio.run(latencies_s(trials))
    print()
    periods = [each / PERIOD_S for each in found]
    rows = [
        ("seconds, median (least to most)", spread(found, ".3f")),
        ("periods of the radar", spread(periods)),
    ]
    table((f"from packet to plot, a radar each {PERIOD_S:g} s, {trials} trials", ""), rows)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else TRIALS)
