"""Processor time of a deadline: 200 sensors with two messages each, to two brokers; and the ledger.

    python tools/benchmarks/bench_delivery.py

MQTT 5 to one broker and 3.1.1 to the other, packets ready, perfect links. Up to the last write is
what a deadline takes; what is told and written afterwards has the time until the next.
"""

from __future__ import annotations

import asyncio
import statistics
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

from aims import YARDSTICK, aim, ratios, spread, yardstick_us
from bench_engine import a_broker
from support.every_kind import scene_of, seen
from support.waiting import PATIENCE_S

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.link.ledger_messages import ledger_messages
from plotfeed.feeds.link.outbox import Outbox, prepare_all, send_all
from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto import plotfeed_pb2 as pb

SENSORS, DEADLINES, RUNS = 200, 100, 3
EVERY_S = 0.02
AIM_US, AIM_MESSAGE_US = 1000, 2.0


@dataclass
class Found:
    """Microseconds of each deadline."""

    write: list[float] = field(default_factory=list)
    tell: list[float] = field(default_factory=list)
    statuses: list[float] = field(default_factory=list)
    both: list[float] = field(default_factory=list)


def messages(sensor: str, due_utc_ns: int) -> list[Message]:
    """A block of plots and one of service."""
    source = f"plotfeed/{sensor}"
    return [
        Message(
            topic=f"{source}/asterix/{category}",
            payload=bytes(octets),
            content_type=f"application/x-asterix; cat={category}",
            due_utc_ns=due_utc_ns,
            properties=attributes(source, f"asterix/{category}", "1-1", due_utc_ns, sensor=sensor),
        )
        for category, octets in (("048", 60), ("034", 20))
    ]


def numbered(some: list[Message]) -> list[Message]:
    """Messages as a link that does nothing passes them on."""
    for number, one in enumerate(some):
        one.number = number
    return some


def status(sensor: str, due_utc_ns: int) -> Message:
    """What each sensor says every five seconds."""
    return Message(
        topic=f"plotfeed/{sensor}/status",
        payload=bytes(300),
        content_type="application/json",
        due_utc_ns=due_utc_ns,
        retain=True,
        qos=1,
    )


async def measured(ports: list[int]) -> Found:
    """Deadlines over brokers on those ports, of MQTT 5 and 3.1.1 in turn."""
    clock, totals, found = WallClock(), SessionCounters(), Found()
    async with asyncio.TaskGroup() as running:
        links = [
            MqttTransport(BrokerAddress("127.0.0.1", port, (5 - i,)), "bench")
            for i, port in enumerate(ports)
        ]
        tasks = [running.create_task(link.run()) for link in links]
        for link in links:
            await link.wait_until_up(PATIENCE_S)
        outboxes = [Outbox(clock, links, totals=totals) for _ in range(SENSORS)]
        for _ in range(DEADLINES):
            await asyncio.sleep(EVERY_S)
            one_deadline(outboxes, clock.now_ns(), found)
            await asyncio.sleep(EVERY_S)
            start = time.process_time()
            for i, outbox in enumerate(outboxes):
                outbox.send_past_link(status(f"r{i}", clock.now_ns()))
            await asyncio.sleep(0)
            found.statuses.append((time.process_time() - start) * 1e6)
        for task in tasks:
            task.cancel()
    clock.close()
    return found


def one_deadline(outboxes: list[Outbox], due_utc_ns: int, found: Found) -> None:
    """Whoever is told first is told after the last write."""
    told: list[float] = []

    def keep(_: object) -> None:
        if not told:
            told.append(time.process_time())

    departures = [
        (outbox, numbered(messages(f"r{i}", due_utc_ns)), None) for i, outbox in enumerate(outboxes)
    ]
    prepare_all(departures)
    start = time.process_time()
    send_all(departures, keep)
    end = time.process_time()
    found.write.append((told[0] - start) * 1e6)
    found.tell.append((end - told[0]) * 1e6)
    found.both.append((end - start) * 1e6 / len(departures) / 2)


def ledger_us(sectors: int, drones: int) -> float:
    """A sector's entry of so many drones, that of one sensor among so many others."""
    batch = seen(scene_of("staring", sectors, ["plots"], drones=drones), scans=1)
    due_ns = int(batch.sectors.end_ns[0])
    sent = [messages(sensor, due_ns) for sensor in batch.sensors]
    for one in chain.from_iterable(sent):
        one.fate, one.sent_utc_ns = pb.SENT, one.due_utc_ns
    batch = replace(batch, messages=sent, links=[""] * sectors)
    kept, took = [(batch, row) for row in range(sectors)], []
    for _ in range(20):
        start = time.process_time()
        ledger_messages("plotfeed", kept)
        took.append((time.process_time() - start) * 1e6)
    return statistics.median(took) / sectors


def main() -> None:
    """Prints tables."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        places = [Path(name) / f"broker{i}" for i in range(2)]
        for place in places:
            place.mkdir()
        brokers = [stack.enter_context(a_broker(place)) for place in places]
        ports = [port for _, port in brokers]
        runs = [
            (asyncio.run(measured(ports)), asyncio.run(measured([])), yardstick_us())
            for _ in range(RUNS)
        ]
    over_brokers, over_none, yardsticks = zip(*runs, strict=True)
    print(f"Medians of {DEADLINES}, µs of processor: median (least to most) of {RUNS} runs; "
          f"{brokers[0][0]} as the brokers.\n{YARDSTICK}\n")  # fmt: skip
    print("| | two brokers | a yardstick's | none | a yardstick's |\n|---|--:|--:|--:|--:|")
    for what, attribute in (
        ("a deadline, up to the last write", "write"),
        ("counted and told afterwards", "tell"),
        ("200 retained statuses of QoS 1, one by one", "statuses"),
        ("a message, both", "both"),
    ):
        cells = []
        for found in (over_brokers, over_none):
            each = [statistics.median(getattr(one, attribute)) for one in found]
            form = ".1f" if attribute == "both" else ",.0f"
            cells += [spread(each, form), spread(ratios(each, yardsticks), ".2g")]
        print(f"| {what} | {' | '.join(cells)} |")
    print()
    for what, limit, found, attribute in (
        ("a deadline, with two brokers", AIM_US, over_brokers, "write"),
        ("a message, with none", AIM_MESSAGE_US, over_none, "both"),
    ):
        us = statistics.median(statistics.median(getattr(one, attribute)) for one in found)
        print(aim(what, f"{limit:,g} µs", f"{us:,.3g} µs", is_met=us <= limit))
    print("\nA sector in the ledger, by how many are told of at once, µs:\n")
    print("| looks and plots in each | 1 | 50 | 200 | 1 beside 200 |\n|--:|--:|--:|--:|--:|")
    for drones in (1, 10, 1000):
        runs = [[ledger_us(sectors, drones) for sectors in (1, 50, 200)] for _ in range(RUNS)]
        each = [spread(column, ",.1f") for column in zip(*runs, strict=True)]
        alone, together = (column for column in (*zip(*runs, strict=True),)[::2])
        each.append(spread(ratios(alone, together), ".1f"))
        print(f"| {drones:,} | " + " | ".join(each) + " |")


if __name__ == "__main__":
    main()
