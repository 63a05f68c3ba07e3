"""Garbage at every door at once, beside a session: its plots are what they would have been."""

from __future__ import annotations

import contextlib
import random
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from fuzz.first_seeds import seeds_of
from fuzz.targets import LIVE
from support.brokers import free_port
from support.chaos import DOORS, OVER_TCP, WAYS, beside
from support.command import plotfeed, running
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S

from plotfeed.testing import MqttReceiver

pytest.importorskip("uvicorn")

DURATION_S = 6
BREATH_S = 0.5  # Between attacks: what they take of the processor is not what is tried here
SLOW = {"period_s": 12.0, "sectors": 240}  # A turn that no stall of the machine is as long as


def damaged(name: str, rng: random.Random) -> bytes:
    octets = bytearray(rng.choice([seed for seed in seeds_of(name) if seed]))
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(octets) + 1)
        octets[at : at + rng.randrange(4)] = rng.randbytes(rng.randrange(6))
    return bytes(octets)


def at_the_broker(port: int, version: int, rng: random.Random) -> None:
    """Telemetry, commands and answers that nobody can read, by the hundred."""
    client = MqttReceiver(port, version, "plotfeed/errors/#")
    try:
        for _ in range(20):
            client.publish_all(
                (f"plotfeed/{topic}", damaged(name, rng))
                for _ in range(20)
                for topic, name in (
                    (f"telemetry/{rng.randrange(10**6)}", "telemetry"),
                    ("telemetry/one", "fast-telemetry"),
                    ("control", "control"),
                    ("control", "page"),
                )
            )
    finally:
        client.close()


def at_the_sockets(ports: list[int], rng: random.Random) -> None:
    """Octets of other protocols, halves of requests, and nothing at all."""
    openings = [
        b"",
        b"GET / HTTP/1.1\r\nHost:",
        b"\x10\xff\xff\xff\x7f",
        b"\x30\x02\x00",
        b"\0" * 99,
    ]
    upgrade = (
        "GET /feed HTTP/1.1\r\nHost: 127.0.0.1:{0}\r\nOrigin: http://127.0.0.1:{0}\r\n"
        "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    openings += [upgrade.format(port).encode() + rng.randbytes(200) for port in ports]
    with contextlib.ExitStack() as held:
        for _ in range(20):
            with contextlib.suppress(OSError):
                end = socket.create_connection(("127.0.0.1", rng.choice(ports)), 5)
                held.enter_context(end).sendall(rng.choice(openings) + rng.randbytes(50))


def test_what_strangers_send_changes_no_plot(tmp_path: Path) -> None:
    sensors = radar(**SLOW) + radar("other", **SLOW)
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=sensors)
    scene, calm, attacked = scene_file(tmp_path, text), tmp_path / "calm", tmp_path / "attacked"
    page, metrics = free_port(), free_port()
    done = plotfeed(
        *("run", scene, "--duration", DURATION_S, "--write", calm, "--broker", "none"),
        *("--speed", "max"),
    )
    assert done.returncode == 0, done.stderr
    rng = random.Random(1)  # noqa: S311
    with running(
        *("run", scene, "--duration", DURATION_S, "--write", attacked),
        *("--page", page, "--metrics", metrics),
    ) as session:
        mqtt = session.port("MQTT")

        def again_and_again(attack: Callable[[], None]) -> None:
            while session.process.poll() is None:
                with contextlib.suppress(OSError, AssertionError):
                    attack()
                time.sleep(BREATH_S)

        attacks = [
            lambda: at_the_broker(mqtt, 4, rng),
            lambda: at_the_broker(mqtt, 5, rng),
            lambda: at_the_sockets([page, metrics, mqtt], rng),
        ]
        attackers = [threading.Thread(target=again_and_again, args=(a,)) for a in attacks]
        for attacker in attackers:
            attacker.start()
        out, err = session.process.communicate(timeout=PATIENCE_S)
        for attacker in attackers:
            attacker.join()
    assert session.process.returncode == 0, err
    assert "Traceback" not in err
    assert attacked.read_bytes() == calm.read_bytes()
    (refused,) = (word for line in out.splitlines()[-1:] for word in line.split("refused ")[1:])
    assert int(refused.split()[0]) > 100


SECONDS = 1.5  # tools/soak/chaos.py has ten, for each door alone


@pytest.mark.parametrize("ways", [WAYS[:3], WAYS[3:]], ids=" ".join)
@pytest.mark.asyncio
async def test_whoever_misbehaves_at_all_doors_changes_no_octet(
    ways: tuple[str, ...], tmp_path: Path
) -> None:
    found = await beside(DOORS, ways, SECONDS, tmp_path)
    assert (found.differing, found.sectors > 5, found.refused > 0) == (0, True, True)


def test_every_kind_of_live_source_is_a_door() -> None:
    assert {door.partition(" ")[0] for door in DOORS if " " in door} == LIVE.keys()
    assert {*OVER_TCP} == LIVE.keys() - {"remote-id"}
