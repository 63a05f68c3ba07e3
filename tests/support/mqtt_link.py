"""MQTT links to a broker that does what a test says, and ends of their connections."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from support.certificates import Certificates
from support.deliveries import number_of
from support.scripted_broker import ScriptedBroker, serving
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.transport.mqtt.address import BrokerAccess, BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport

BUSY = 0x89  # A refusal that is not for ever


@asynccontextmanager
async def linked(
    broker: ScriptedBroker, *subscribe: str, tls: Certificates | None = None, **queue: object
) -> AsyncIterator[MqttTransport]:
    context, address = None, "mqtt"
    access = BrokerAccess()
    if tls is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tls.broker.certificate, tls.broker.key)
        address, access = "mqtts", BrokerAccess(ca_file=tls.ca)
    async with serving(broker, context):
        url = f"{address}://127.0.0.1:{broker.port}"
        link = MqttTransport(
            BrokerAddress.parse(url, versions=(5,), access=access),
            "test",
            subscribe=subscribe,
            queue=MqttQueueKeys.model_validate(queue),
        )
        running = asyncio.create_task(link.run())
        try:
            await link.wait_until_up(PATIENCE_S)
            yield link
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


async def end_connection(broker: ScriptedBroker, link: MqttTransport, *, code: int = 0) -> None:
    """The next ones are answered with that code."""
    broker.code = code
    broker.hang_up()
    await until(lambda: not link.is_up)


def numbers(payloads: list[bytes]) -> list[int]:
    return [number_of(payload) for payload in payloads]
