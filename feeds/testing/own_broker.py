"""A broker of one's own: the one that plotfeed comes with, on ports that are free."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from plotfeed.feeds.transport.embedded_broker import EmbeddedBroker, Ports

FIRST_PORT = 18_830  # Others where this one, or the next, is taken


@contextmanager
def broker(port: int = FIRST_PORT) -> Iterator[Ports]:
    """Ports of a broker that is there until the end of the `with`; raises `BrokerError`.

    It speaks MQTT 3.1.1 and 5.0 on `mqtt`, on loopback alone.
    """
    with ThreadPoolExecutor(1) as thread:  # whoever calls may have an event loop that runs
        loop = thread.submit(asyncio.Runner).result()
        own = thread.submit(loop.run, EmbeddedBroker.start(port)).result()
        try:
            yield own.ports
        finally:
            thread.submit(loop.run, own.stop()).result()
            thread.submit(loop.close).result()
