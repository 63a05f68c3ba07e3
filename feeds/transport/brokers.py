"""The MQTT brokers that a scene names, or the embedded one while somebody sends to it."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.transport.mqtt.address import BrokerAccess, BrokerAddress

NO_BROKER = "none"
LINGER_S = 0.3  # The embedded broker stays on for so long, to pass on the last messages

Brokers = tuple[list[BrokerAddress], dict[str, str]]  # Where to publish, and what to call it


@contextlib.asynccontextmanager
async def brokers_of(scene: Scene, broker: str | None) -> AsyncIterator[Brokers]:
    """The brokers to publish to, and what to call them; the embedded one lives meanwhile."""
    to = scene.outgoing
    url = broker or to.mqtt.broker
    if url == NO_BROKER:
        yield [], {}
        return
    if url is not None:
        address = broker_address(scene, url)
        yield [address], {"MQTT": str(address)}
        return
    from plotfeed.feeds.transport.embedded_broker import EmbeddedBroker
    from plotfeed.feeds.transport.local_hosts import LOOPBACK

    keys = to.mqtt.embedded
    embedded = await EmbeddedBroker.start(
        to.mqtt.port,
        keys,
        prefix=scene.mqtt.prefix,
        may_be_others="port" not in to.mqtt.model_fields_set,
    )
    keeping_up = asyncio.create_task(embedded.keep_up(), name="embedded broker")
    try:
        host = LOOPBACK if keys.host == "0.0.0.0" else keys.host  # noqa: S104  # nosec B104
        own = BrokerAddress(
            host, embedded.ports.mqtt, (5,), access=embedded.access, ends_with_us=True
        )
        yield [own], embedded.ports.urls(host if host == keys.host else socket.gethostname())
        await asyncio.sleep(LINGER_S)
    finally:
        keeping_up.cancel()
        await embedded.stop()


def broker_address(scene: Scene, url: str) -> BrokerAddress:
    """A broker of the user's own, with the keys to it that the scene names."""
    keys = scene.outgoing.mqtt
    named = (keys.ca_file, keys.client_certificate_file, keys.client_key_file)
    ca, certificate, key, credentials = (
        None if name is None else scene.file(name) for name in (*named, keys.credentials_file)
    )
    access = BrokerAccess(
        ca_file=ca,
        certificate_file=certificate,
        key_file=key,
        version=scene.mqtt.version if "version" in scene.mqtt.model_fields_set else None,
    ).with_credentials(credentials)
    return BrokerAddress.parse(url, access=access, waits=scene.outgoing.waits)
