"""A subscriber in a process of its own that counts what arrives, and nothing else."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import asyncio, sys, gmqtt
async def main():
    count = 0
    def heard(*_):
        nonlocal count
        count += 1
        return 0
    client = gmqtt.Client("count")
    client.on_message = heard
    client.on_disconnect = lambda *_: None
    await client.connect("127.0.0.1", int(sys.argv[1]), version=5)
    client.subscribe(sys.argv[2])
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
