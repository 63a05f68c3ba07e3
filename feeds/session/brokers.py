"""The brokers of a session: one of the user's own, the embedded one, or none."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.transport.embedded_broker import LOOPBACK, EmbeddedBroker
from plotfeed.feeds.transport.mqtt.address import VERSIONS, BrokerAccess, BrokerAddress

NO_BROKER = "none"
LINGER_S = 0.3
"""The embedded broker stays on for so long, to pass on the last messages."""


Brokers = tuple[list[BrokerAddress], dict[str, str]]
"""Where to publish, and what to call it."""


@contextlib.asynccontextmanager
async def brokers_of(scene: Scene, broker: str | None) -> AsyncIterator[Brokers]:
    """The brokers to publish to, and what to call them; the embedded one lives meanwhile."""
    url = broker or scene.mqtt.broker
    if url == NO_BROKER:
        yield [], {}
        return
    if url is not None:
        address = broker_address(scene, url)
        yield [address], {"MQTT": str(address)}
        return
    embedded = await EmbeddedBroker.start(scene.mqtt.port)
    try:
        mqtt3 = BrokerAddress(LOOPBACK, embedded.ports.mqtt3, (4,))
        mqtt5 = BrokerAddress(LOOPBACK, embedded.ports.mqtt5, (5,))
        yield [mqtt5, mqtt3], embedded.ports.urls()
        await asyncio.sleep(LINGER_S)
    finally:
        embedded.stop()


def broker_address(scene: Scene, url: str) -> BrokerAddress:
    """A broker of the user's own, with the keys to it that the scene names."""
    mqtt, folder = scene.mqtt, scene.folder

    def beside_scene(name: str | None) -> Path | None:
        return None if name is None else folder / name

    access = BrokerAccess(
        ca_file=beside_scene(mqtt.ca_file),
        certificate_file=beside_scene(mqtt.client_certificate_file),
        key_file=beside_scene(mqtt.client_key_file),
    ).with_credentials(beside_scene(mqtt.credentials_file))
    return BrokerAddress.parse(url, versions=VERSIONS[mqtt.version], access=access)
