"""Reads messages by the packages of others: run by the Python of .venv-utm, JSON in and out.

With a URL and a number, such as `tcp://127.0.0.1:8087 20`, it connects and receives so many events.
"""

from __future__ import annotations

import asyncio
import json
import sys
import warnings
import xml.etree.ElementTree as ET
from typing import Any

warnings.simplefilter("ignore")


def cot(text: str) -> dict[str, Any]:
    """An event as TAK's protobuf, by takproto."""
    import takproto

    event = takproto.parse_proto(takproto.xml2proto(text)).cotEvent
    names = ("uid", "type", "how", "sendTime", "staleTime", "lat", "lon", "hae", "ce", "le")
    track = event.detail.track
    return {
        **{name: getattr(event, name) for name in names},
        "speed": track.speed,
        "course": track.course,
        "callsign": event.detail.contact.callsign,
    }


def f3411(text: str) -> dict[str, Any]:
    """Flights as InterUSS parses the answer of a service provider."""
    from implicitdict import ImplicitDict
    from uas_standards.astm.f3411.v22a.api import GetFlightsResponse

    found = ImplicitDict.parse(json.loads(text), GetFlightsResponse)
    first = found.flights[0]
    return {
        "ids": [flight.id for flight in found.flights],
        "seconds": first.current_state.timestamp.value.datetime.timestamp(),
        "accuracy_h": first.current_state.position.accuracy_h.value,
        "alt": first.current_state.position.alt,
    }


def location_fix(text: str) -> dict[str, Any]:
    """Whether foxglove-sdk's own LocationFix has every key of a message."""
    from foxglove.messages import LocationFix
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    schema = LocationFix.get_schema()
    files = FileDescriptorSet.FromString(schema.data).file
    fields = {
        field.name
        for file in files
        for m in file.message_type
        if m.name == "LocationFix"
        for field in m.field
    }
    return {"name": schema.name, "unknown": sorted(json.loads(text).keys() - fields)}


def display_data(text: str) -> dict[str, Any]:
    """What a display shows, as InterUSS parses what it observes."""
    from implicitdict import ImplicitDict
    from uas_standards.interuss.automated_testing.rid.v1.observation import GetDisplayDataResponse

    found = ImplicitDict.parse(json.loads(text), GetDisplayDataResponse)
    return {
        "flights": [flight.id for flight in found.flights],
        "clusters": [cluster.number_of_flights for cluster in found.clusters],
    }


async def receive(url: str, number: int) -> None:
    """Print who is where by so many events of Cursor on Target that PyTAK receives."""
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


READERS = {"cot": cot, "f3411": f3411, "display-data": display_data, "location-fix": location_fix}

if __name__ == "__main__":
    if sys.argv[1:]:
        asyncio.run(receive(sys.argv[1], int(sys.argv[2])))
    for line in () if sys.argv[1:] else sys.stdin:
        kind, text = json.loads(line)
        print(json.dumps(READERS[kind](text)))
