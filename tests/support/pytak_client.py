"""Receives events of Cursor on Target by PyTAK: run by the Python of .venv-utm, lines of JSON out.

.venv-utm/bin/python tests/support/pytak_client.py tcp://127.0.0.1:8087 20
"""

from __future__ import annotations

import asyncio
import json
import sys
import warnings
import xml.etree.ElementTree as ET
from typing import Any

warnings.simplefilter("ignore")


async def receive(url: str, number: int) -> None:
    """Print who is where by that many events."""
    import pytak

    config: dict[str, Any] = {"COT_URL": url, "TAK_PROTO": "0"}
    reader, writer = await pytak.protocol_factory(config)  # the connection lasts as long as both
    queue: asyncio.Queue[bytes] = asyncio.Queue()
    worker = asyncio.create_task(pytak.RXWorker(queue, config, reader).run())
    for _ in range(number):
        event = ET.fromstring(await queue.get())  # noqa: S314 - a test's own
        point = event.find("point")
        assert point is not None
        place = {name: float(point.attrib[name]) for name in ("lat", "lon")}
        print(json.dumps({"uid": event.attrib["uid"], **place}), flush=True)
    worker.cancel()
    writer.close()


if __name__ == "__main__":
    asyncio.run(receive(sys.argv[1], int(sys.argv[2])))
