"""Bad peers at one door of a session, or at all: what its sensors report is as without them."""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import random
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from multiprocessing.synchronize import Event
from pathlib import Path

from fuzz.first_seeds import seeds_of
from support.brokers import free_port, own_broker
from support.sessions import at_work
from support.waiting import PATIENCE_S

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.link.counters import lateness_us
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.scene import Scene
from plotfeed.testing import MqttReceiver, flown, radar, rotating, scene, waypoint

WAYS = ("garbage", "flood", "silence", "drip", "cut", "disconnect")
TOPICS = {
    "telemetry": "plotfeed/telemetry/bad",
    "control": "plotfeed/control",
    "mapped": "fleet/bad/state",
}
OVER_TCP = ("mavlink", "sbs1", "beast", "asterix-021")
LIVE = (
    *(f"{kind} udp" for kind in (*OVER_TCP, "remote-id")),
    *(f"{kind} tcp" for kind in OVER_TCP),
)
SERVED = "remote-id http"
DOORS = ("mqtt", *TOPICS, *LIVE, SERVED)
MAPPING = {"topic": "fleet/{drone}/state", "latitude": "lat", "longitude": "lon", "altitude": "alt"}
ANSWER = b"HTTP/1.1 200 OK\r\nContent-Length: 400\r\n\r\n" + b'{"flights": []}'.ljust(400)
RESETS = struct.pack("ii", 1, 0)  # Of SO_LINGER: who closes then resets the connection
TURN_S = 0.02


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a session said of itself, and how its octets compare with those of one alone."""

    refused: int
    sectors: int
    differing: int
    lateness_p99_ms: float
    end_s: float  # From when it was told to end


class Attack:
    """One who misbehaves in that way at that door, until told to stop."""

    def __init__(self, door: str, way: str, port: int, over: Event) -> None:
        self._door, self._way, self._port, self._over = door, way, port, over
        self._chance = random.Random(f"{door} {way}")  # noqa: S311 - no secret
        live = f"live-{door.partition(' ')[0]}"
        kind = {"mqtt": "mqtt-broker", SERVED: "network-remote-id"} | {t: t for t in TOPICS}
        self._whole = next(seed for seed in seeds_of(kind.get(door, live)) if seed)

    def run(self) -> None:
        """Do it again and again."""
        work = {SERVED: self._serve} | dict.fromkeys(TOPICS, self._publish)
        while not self._over.is_set():
            with contextlib.suppress(OSError, AssertionError):
                work.get(self._door, self._connect)()

    def octets(self) -> Iterator[bytes]:
        """What is said in turn, a piece each time; for ever, but where it is cut."""
        part = self._whole[: len(self._whole) // 3]
        if self._way in {"garbage", "flood"}:
            size = 200 if self._way == "garbage" else 60
            while True:
                yield self._chance.randbytes(size)
        if self._way == "drip":
            for at in range(10**6):
                yield (part * 2)[at % len(part) :][:1]
        if self._way == "cut":
            yield part
        elif self._way == "silence":
            while True:
                yield b""

    def _say(self, send: Callable[[bytes], object]) -> None:
        for piece in self.octets():
            if self._over.is_set():
                return
            if piece:
                send(piece)
            if self._way != "flood":
                self._over.wait(TURN_S)

    def _connect(self) -> None:
        """At a socket: of a live source, or of the broker."""
        kind = socket.SOCK_DGRAM if self._door.endswith("udp") else socket.SOCK_STREAM
        with socket.socket(socket.AF_INET, kind) as ours:
            ours.settimeout(1.0)
            ours.connect(("127.0.0.1", self._port))
            self._say(ours.sendall)
            if self._way == "cut" and kind == socket.SOCK_STREAM:
                ours.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESETS)
        self._over.wait(TURN_S)

    def _publish(self) -> None:
        """On a topic of the broker, whose clients come, say nothing, or go without a word."""
        client, topic = MqttReceiver(self._port, 5, "plotfeed/errors/#"), TOPICS[self._door]
        try:
            if self._way == "flood":
                while not self._over.is_set():
                    client.publish_all((topic, each) for each in islice(self.octets(), 200))
            else:
                self._say(lambda piece: client.publish(topic, piece))
        finally:
            client.close()
        self._over.wait(TURN_S)

    def _serve(self) -> None:
        """As a service that is asked for flights."""
        with socket.create_server(("127.0.0.1", self._port)) as server:
            server.settimeout(0.1)
            while not self._over.is_set():
                with contextlib.suppress(OSError):
                    theirs, _ = server.accept()
                    with theirs:
                        theirs.settimeout(0.1)
                        if self._way in {"drip", "cut"}:
                            self._whole = ANSWER
                        elif self._way in {"garbage", "flood"}:
                            theirs.sendall(ANSWER[:17])
                        self._say(theirs.sendall)


def scene_of(ports: dict[str, int], port: int) -> Scene:
    """A radar that turns slower than a machine stalls, a drone that is known, and all the doors."""
    schemes = {"udp": "udp://127.0.0.1:{}", "tcp": "tcpin://127.0.0.1:{}"}
    schemes["http"] = "http://127.0.0.1:{}/rid"
    sources = []
    for door, at in ports.items():
        kind, _, over = door.partition(" ")
        asked = {"view": [40.43, -3.76, 40.47, -3.70], "poll_s": 0.2} if over == "http" else {}
        sources.append({"url": f"{kind}:{schemes[over].format(at)}"} | asked)
    telemetry = {"max_speed_m_s": 350.0, "takeoff_height_m": 650.0, "geoid_undulation_m": 51.0}
    return scene(
        [radar(scan=rotating(6.0, 240), pfa=1e-5)],
        [flown("visitor", waypoint(60.0, 5.0, 1700.0), waypoint(320.0, 5.0, 1500.0), rcs_m2=0.05)],
        seed=3,
        telemetry=telemetry
        | {"mapping": [MAPPING | {"altitude_reference": "ellipsoid"}], "source": sources},
        mqtt={"port": port},
    )


def misbehave(
    doors: Sequence[str], ways: Sequence[str], ports: Mapping[str, int], begun: Event, over: Event
) -> None:
    """At each of those doors somebody, all in this process, until told to stop or nobody can.

    In each of those ways; where we are the service that is asked, in the first.
    """
    attacks = [
        Attack(door, way, ports[door], over)
        for door in doors
        for way in (ways[:1] if door == SERVED else ways)
    ]
    threads = [threading.Thread(target=each.run, daemon=True) for each in attacks]
    for thread in threads:
        thread.start()
    begun.set()
    session = multiprocessing.parent_process()
    while not over.wait(0.1) and session is not None and session.is_alive():
        pass


async def beside(
    doors: Sequence[str], ways: Sequence[str], seconds: float, folder: Path
) -> Outcome:
    """A session with bad peers at those doors for so long, and the same engine without.

    They are a process of their own, as peers are, so that their work is not the session's.
    """
    broker, apart = free_port(), multiprocessing.get_context("spawn")
    ports = {door: free_port() for door in (*LIVE, SERVED)}
    made, begun, over = scene_of(ports, broker), apart.Event(), apart.Event()
    ports |= dict.fromkeys(("mqtt", *TOPICS), broker)
    bad = apart.Process(target=misbehave, args=(doors, ways, ports, begun, over))
    with own_broker(folder, broker):
        async with at_work(made, broker) as session:
            bad.start()
            try:
                await asyncio.to_thread(begun.wait, PATIENCE_S)
                await asyncio.sleep(seconds)
                await session.sectors_more(1)
            finally:
                ended_s = time.monotonic()
        end_s = time.monotonic() - ended_s
        over.set()
        await asyncio.to_thread(bad.join)
    engine = Engine(made, session.session.start_ns)
    alone = octets_of(engine.until(session.sectors[-1].sector.end_ns))
    said = octets_of(session.sectors)
    differing = sum(alone.get(key) != payload for key, payload in said.items())
    p99_ms = lateness_us(session.totals.lateness_ns, 99)[0] / 1e3
    return Outcome(session.totals.refused, len(session.sectors), differing, p99_ms, end_s)


def octets_of(batches: Iterable[Batch]) -> dict[tuple[int, str], bytes]:
    """What sensors said, by the end of the sector and the topic."""
    return {
        (end_ns, one.topic): one.payload
        for batch in batches
        for end_ns, messages in zip(batch.sectors.end_ns.tolist(), batch.messages, strict=True)
        for one in messages
    }
