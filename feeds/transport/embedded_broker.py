"""The embedded MQTT broker: a process of its own, which speaks 3.1.1 and 5.0 on one port.

It is plotfeed's (`transport/mqtt/broker.py`), as no broker that pip installs on every machine has
both versions and users with rights. It is heard on loopback, or where the scene says; there its
clients need names and passwords.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from typing import Any, Self

from plotfeed.feeds.console.printed import bracketed
from plotfeed.feeds.scene.output_keys import EmbeddedBrokerKeys
from plotfeed.feeds.transport.local_hosts import LOOPBACK, ServedAddress, drawn_token, fixed_token
from plotfeed.feeds.transport.mqtt.address import BrokerAccess
from plotfeed.feeds.transport.mqtt.broker import BrokerLimits, Rights, User
from plotfeed.proto.errors import PlotfeedError

log = logging.getLogger(__name__)

# One that cannot listen says so, and is not waited for; on a busy machine it may take long.
START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 2.0
AGAIN_AFTER_S = 0.5  # A process that has ended is made anew no sooner
ONE_OF_YOUR_OWN = "give the address of a broker of your own with --broker mqtt://HOST:PORT"
SESSION_USER = "session"  # Its name at the broker, with a password that nobody else has
PASSWORD_VARIABLE_OF = "PLOTFEED_BROKER_{}"  # noqa: S105 - its name  # nosec B105


class BrokerError(PlotfeedError):
    """The embedded broker did not start."""

    exit_code = 1


def rights_by_user(prefix: str) -> dict[str, Rights]:
    """What each user of the embedded broker may publish and hear, by its name.

    What drones report is as good as the truth, and so is heard by the one who may hear that alone.
    """
    secret = [f"{prefix}/truth", f"{prefix}/telemetry/#"]
    answers = [f"{prefix}/session", f"{prefix}/errors", f"{prefix}/+/status"]
    orders = [f"{prefix}/control", f"{prefix}/+/cue", f"{prefix}/+/sapient/task"]
    return {
        "telemetry": Rights([f"{prefix}/telemetry/+"], [*answers, f"{prefix}/+/description"]),
        "control": Rights(orders, hears_not=secret),
        # A tracker publishes what it makes of the plots, on topics that are not the session's.
        "plots": Rights(publishes_not=[f"{prefix}/#"], hears_not=secret),
        "truth": Rights([]),
    }


@dataclass(frozen=True, slots=True)
class Ports:
    """Where the broker listens."""

    mqtt: int
    websocket: int | None = None
    # The ports that were wanted and are taken, by those that stand in for them.
    instead_of: Mapping[int, int] = field(default_factory=dict)

    def by_protocol(self) -> dict[str, int]:
        """All ports."""
        ports = {"MQTT": self.mqtt}
        return ports if self.websocket is None else {**ports, "WebSocket": self.websocket}

    def urls(self, host: str = LOOPBACK) -> dict[str, str]:
        """What to tell people, by protocol: an address, and what there is to say of it."""
        found = {}
        for protocol, port in self.by_protocol().items():
            scheme = "ws" if port == self.websocket else "mqtt"
            found[protocol] = f"{scheme}://{bracketed(host)}:{port}"
            if port in self.instead_of:
                found[protocol] += f" (port {self.instead_of[port]} is taken)"
        return found


class EmbeddedBroker:
    """Start it, use its ports and the session's access, keep it up, stop it."""

    def __init__(
        self,
        ports: Ports,
        settings: EmbeddedBrokerKeys,
        prefix: str,
        *,
        may_be_others: bool = False,
    ) -> None:
        """`ports` are those that are wanted until it has started."""
        self.ports = ports
        at_home = ServedAddress(settings.host).is_loopback
        rights = rights_by_user(prefix)
        self.users = {}
        for name, may in rights.items():
            fixed = fixed_token(os.environ, PASSWORD_VARIABLE_OF.format(name.upper()))
            self.users[name] = User(fixed or drawn_token(), may)
        own = User(drawn_token(), Rights())
        known = {**self.users, SESSION_USER: own}
        self.access = BrokerAccess(username=SESSION_USER, password=own.password)
        limits = BrokerLimits(
            settings.max_connections, settings.max_payload_octets, settings.max_memory_mib << 20
        )
        self.asks_for_names = settings.users or not at_home
        self.orders: dict[str, Any] = {
            "host": settings.host,
            "ports": [*ports.by_protocol().values()],
            "may_be_others": may_be_others,
            "origins": settings.websocket_origins,
            "on_loopback": at_home,
            "anonymous": not self.asks_for_names,
            "users": {name: asdict(user) for name, user in known.items()},
            "trusted": SESSION_USER,
            "limits": asdict(limits),
            "messages_per_s": settings.max_messages_per_s,
        }
        self._process: Process

    @classmethod
    async def start(
        cls,
        preferred_port: int = 1883,
        settings: EmbeddedBrokerKeys | None = None,
        *,
        prefix: str = "plotfeed",
        may_be_others: bool = True,
    ) -> Self:
        """Listen on `preferred_port`, for WebSocket the one after; on free ones if taken.

        Raises `BrokerError` if they are taken and may not be others, or if it does not listen
        within a minute, and `OSError` if there is no such host.
        """
        settings = settings or EmbeddedBrokerKeys()
        websocket = settings.websocket_origins is not None
        if websocket and not find_spec("websockets"):
            key = "mqtt.embedded.websocket_origins"
            raise BrokerError(f"{key} needs more: pip install 'plotfeed[page]'")
        ports = Ports(preferred_port, preferred_port + 1 if websocket else None)
        broker = cls(ports, settings, prefix, may_be_others=may_be_others)
        wanted, got = broker.orders["ports"], await broker._begin()
        others = {had: port for port, had in zip(wanted, got, strict=True) if had != port}
        broker.ports = Ports(got[0], got[1] if websocket else None, others)
        broker.orders |= {"ports": got, "may_be_others": False}  # if it is started anew
        if broker.asks_for_names:
            names = ", ".join(f"{name} {user.password}" for name, user in broker.users.items())
            log.warning("users of the embedded broker, each with its password: %s", names)
        return broker

    async def _begin(self) -> list[int]:
        """Start the process, and return at which ports it listens."""
        process = self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "plotfeed.feeds.transport.broker_process"),
            stdin=PIPE,
            stdout=PIPE,
            stderr=DEVNULL,
            start_new_session=True,  # Ctrl-C is for us: the broker is still needed to say goodbye
        )
        assert process.stdin is not None  # noqa: S101 - for mypy
        assert process.stdout is not None  # noqa: S101 - for mypy
        told: dict[str, Any] = {}
        try:
            with contextlib.suppress(ConnectionError, TimeoutError):
                process.stdin.write(json.dumps(self.orders).encode() + b"\n")
                async with asyncio.timeout(START_TIMEOUT_S):
                    await process.stdin.drain()
                    told = json.loads(await process.stdout.readline() or b"{}")
            if "ports" in told:
                return list(told["ports"])
            if "error" in told:
                raise OSError(None, told["error"])
            first = self.ports.mqtt
            if "taken" in told:
                protocol = "MQTT" if told["taken"] == first else "WebSocket"
                raise BrokerError(
                    f"mqtt.port = {first}: port {told['taken']} of {self.orders['host']}, for "
                    f"{protocol}, is taken; name another, or leave the key out to have any that is "
                    "free"
                )
            raise BrokerError(
                f"the embedded broker did not start on port {first}; {ONE_OF_YOUR_OWN}"
            )
        except BaseException:
            await self.stop()
            raise

    async def keep_up(self) -> None:
        """Pass on what the broker tells of clients, and start it anew if it ends; never returns."""
        while True:
            assert self._process.stdout is not None  # noqa: S101 - for mypy
            while line := await self._process.stdout.readline():
                log.warning("the embedded broker: %s", line.decode(errors="replace").strip())
            code = await self._process.wait()
            log.warning("the embedded broker has ended (exit code %s); it starts anew", code)
            with contextlib.suppress(BrokerError, OSError):
                await asyncio.sleep(AGAIN_AFTER_S)
                await self._begin()

    async def stop(self) -> None:
        """End the process."""
        process = self._process
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        try:
            await asyncio.wait_for(process.wait(), STOP_TIMEOUT_S)
        except TimeoutError:
            process.kill()
            await process.wait()
