"""A SAPIENT middleware in a process of its own that never stops talking, and still listens.

    python tests/support/sapient_flood.py errors|empty|tasks

It prints its port, and whenever a node has said goodbye, how many detections that node reported.
"""

from __future__ import annotations

import asyncio
import sys

from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport

ACK = SapientMessage(registration_ack={"acceptance": True}).SerializeToString()
ERROR = SapientMessage(error={"packet": b"x", "error_message": ["no"]}).SerializeToString()
TASK = SapientMessage(
    task={
        "task_id": "01J00000000000000000000000",
        "control": "CONTROL_START",
        "command": {"request": "Status"},
    }
).SerializeToString()
SAYS = {"errors": ERROR, "empty": b"", "tasks": TASK}
AT_ONCE = 200


def framed(message: bytes) -> bytes:
    return len(message).to_bytes(4, "little") + message


async def talk(writer: asyncio.StreamWriter) -> None:
    while True:
        writer.write(framed(SAYS[sys.argv[1]]) * AT_ONCE)
        await writer.drain()
        await asyncio.sleep(0)


async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.write(framed(ACK))
    talking = asyncio.create_task(talk(writer))
    detections = 0
    try:
        while True:
            length = int.from_bytes(await reader.readexactly(4), "little")
            message = SapientMessage.FromString(await reader.readexactly(length))
            detections += message.HasField("detection_report")
            if message.status_report.system == StatusReport.SYSTEM_GOODBYE:
                print(detections, flush=True)
    except (asyncio.IncompleteReadError, ConnectionError):
        pass
    finally:
        talking.cancel()
        writer.close()


async def main() -> None:
    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    server.close()


if __name__ == "__main__":
    asyncio.run(main())
