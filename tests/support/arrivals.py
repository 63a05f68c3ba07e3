"""A subscriber in a process of its own that counts what arrives, and nothing else."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import asyncio, sys
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
async def main():
    count = 0
    def heard(*_):
        nonlocal count
        count += 1
    address = BrokerAddress("127.0.0.1", int(sys.argv[1]), (5,))
    link = MqttTransport(address, "count", subscribe=[sys.argv[2]], on_message=heard)
    async with link.connected(5):
        print("ready", flush=True)
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
        await asyncio.sleep(1.0)
    print(count, flush=True)
asyncio.run(main())
"""


class Arrivals:
    """It hears those topics once it is made."""

    def __init__(self, port: int, topic_filter: str = "plotfeed/+/asterix/#") -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(port), topic_filter],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout
        self._process.stdout.readline()

    def count(self) -> int:
        """How many messages came; a second later it hears no more."""
        return int(self._process.communicate("")[0])
