"""The MQTT brokers that a scene names, or the embedded one while somebody sends to it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from plotfeed.feeds.scene.output_keys import USUAL_PORT
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.transport.mqtt.address import BrokerAccess, BrokerAddress

NO_BROKER = "none"
LINGER_S = 0.3  # The embedded broker stays on for so long, to pass on the last messages

Brokers = tuple[list[BrokerAddress], dict[str, str]]  # Where to publish, and what to call it


@contextlib.asynccontextmanager
async def brokers_of(scene: Scene, broker: str | None) -> AsyncIterator[Brokers]:
    """The brokers to publish to, and what to call them; the embedded one lives meanwhile."""
    to = scene.outgoing
    url = broker or to.broker
    if url == NO_BROKER:
        yield [], {}
        return
    if url is not None:
        address = broker_address(scene, url)
        yield [address], {"MQTT": str(address)}
        return
    from plotfeed.feeds.transport.embedded_broker import EmbeddedBroker

    embedded = await EmbeddedBroker.start(
        to.port or USUAL_PORT, to.embedded, may_be_others=to.port is None
    )
    keeping_up = asyncio.create_task(embedded.keep_up(), name="embedded broker")
    try:
        from plotfeed.feeds.transport.local_hosts import LOOPBACK

        mqtt3 = BrokerAddress(LOOPBACK, embedded.ports.mqtt3, (4,), ends_with_us=True)
        mqtt5 = BrokerAddress(LOOPBACK, embedded.ports.mqtt5, (5,), ends_with_us=True)
        yield [mqtt5, mqtt3], embedded.ports.urls()
        await asyncio.sleep(LINGER_S)
    finally:
        keeping_up.cancel()
        embedded.stop()


def broker_address(scene: Scene, url: str) -> BrokerAddress:
    """A broker of the user's own, with the keys to it that the scene names."""
    to = scene.outgoing
    access = BrokerAccess(
        ca_file=to.ca_file,
        certificate_file=to.certificate_file,
        key_file=to.key_file,
        version=scene.mqtt.version if "version" in scene.mqtt.model_fields_set else None,
    ).with_credentials(to.credentials_file)
    return BrokerAddress.parse(url, access=access, waits=to.waits)
