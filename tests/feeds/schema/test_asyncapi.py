"""The AsyncAPI document, held against its standard and against what a session really publishes."""

from __future__ import annotations

import asyncio
import base64
import json
import re
import subprocess
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from google.protobuf.json_format import ParseDict
from support.brokers import free_port, own_broker
from support.command import plotfeed_here
from support.random_scenes import SENSOR_MAKERS, Dice
from support.sapient_rules import ONE, task
from support.tools import NODE_MODULES, ROOT, needed, node_module

from plotfeed.feeds.formats import FORMATS
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene import sensors
from plotfeed.feeds.scene.changes import parsed
from plotfeed.feeds.scene.scene import Scene, from_tree
from plotfeed.feeds.schema.asyncapi import OURS, REQUIRED, document, flows
from plotfeed.feeds.session.session import run
from plotfeed.feeds.telemetry.position_report import Refused, decode
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import decode_lenient
from plotfeed.proto.message_kinds import OUR_MESSAGES
from plotfeed.testing import START_NS, MqttMessage, MqttReceiver, fly, held, rotating, staring

PREFIX = "north/site/7"
SPEED = 5.0
DURATION_S = 21.0  # Of the scene: what is periodic comes every ten seconds
TELEMETRY = {
    "time_utc": "2026-01-01T12:00:00Z",
    "latitude_deg": 40.0,
    "longitude_deg": -3.0,
    "altitude_m": 700.0,
    "altitude_reference": "ELLIPSOID",
}
# Of each type one as random scenes have them, which sees the drone below.
SENSORS: list[dict[str, Any]] = [
    {"id": kind, "type": kind} | SENSOR_MAKERS[kind](Dice(3))
    | ({"scan": rotating(1.0, 16), "pfa": 1e-5} if kind == "active_radar" else {"scan": staring()})
    | ({"pan_deg": 45.0, "tilt_deg": 20.0, "horizontal_fov_deg": 60.0} if kind == "camera" else {})
    for kind in SENSOR_MAKERS
]  # fmt: skip
EMITTER = {"frequency_hz": 2.437e9, "bandwidth_hz": 1e6, "eirp_dbm": 30.0, "kind": "control"}
DRONE = held("near", 45.0, 20.0, 100.0, rcs_m2=1.0, sound_power_db=110.0, emitters=[EMITTER])


def scene(**mqtt: Any) -> Scene:
    """Every type of sensor, each with every format that it can report in."""
    assert {s["type"] for s in SENSORS} == sensors.SENSORS.keys()
    return from_tree(
        {
            "scene": {
                "name": "everything",
                "seed": 5,
                "site": {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0},
            },
            "telemetry": {"geoid_undulation_m": 51.0},
            "mqtt": {"prefix": PREFIX, **mqtt},
            "cooperative": {"report": ["asterix-129", "json"]},
            "sensor": [s | {"report": list(sensors.SENSORS[s["type"]].formats)} for s in SENSORS],
            "drone": [DRONE],
        },
        Path("scene.toml"),
    )


async def published(what: Scene, port: int) -> tuple[list[MqttMessage], dict[str, Message]]:
    """All messages of a session as an MQTT 5 client hears them, and as they left.

    The latter by their sources and ids: a broker may deliver with a lower QoS.
    """
    left: dict[str, Message] = {}
    ready = asyncio.Event()

    def tap(message: Message, _t_utc_ns: int) -> None:
        left[event_of(dict(message.properties))] = message

    def is_last(message: MqttMessage, sensor: str) -> bool:
        return message.topic == f"{PREFIX}/{sensor}/status" and b"OFFLINE" in message.payload

    with await asyncio.to_thread(MqttReceiver, port, 5, "#") as ears:
        running = asyncio.create_task(
            run(
                what,
                clock=WallClock(START_NS, speed=SPEED),
                broker=f"mqtt://127.0.0.1:{port}",
                duration_s=DURATION_S,
                tap=tap,
                on_ready=lambda *_: ready.set(),
            )
        )
        await ready.wait()
        ears.publish(f"{PREFIX}/telemetry/nobody", b"{}", "application/json")
        ears.publish(f"{PREFIX}/{SENSORS[0]['id']}/sapient/task", task(ONE, request="Registration"))
        await running
        for sensor in SENSORS:
            await asyncio.to_thread(ears.wait_for, partial(is_last, sensor=sensor["id"]))
    inbound = ("/telemetry/nobody", "/sapient/task")
    return [m for m in ears.heard if not m.topic.endswith(inbound)], left


def event_of(attributes: dict[str, str]) -> str:
    """What CloudEvents has an event be known by."""
    return f"{attributes['source']} {attributes['id']}"


@pytest.fixture(scope="module")
def api() -> dict[str, Any]:
    return document()


def resolved(api: dict[str, Any], node: Any) -> Any:
    while isinstance(node, dict) and "$ref" in node:
        here: Any = api
        for step in node["$ref"].removeprefix("#/").split("/"):
            here = here[step]
        node = here
    return node


def sends(api: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {name: o for name, o in api["operations"].items() if o["action"] == "send"}


def matching(
    api: dict[str, Any], topic: str, content_type: str | None, attributes: dict[str, str]
) -> list[str]:
    """Operations whose channel has that topic, and whose message has those headers and content."""
    found = []
    for name, operation in sends(api).items():
        address = resolved(api, operation["channel"])["address"]
        pattern = re.escape(address.replace("{prefix}", PREFIX))
        pattern = re.sub(r"\\\{(sensor|drone)\\\}", "[^/]+", pattern)
        (message,) = (resolved(api, m) for m in operation["messages"])
        if re.fullmatch(pattern, topic) and message["contentType"] == content_type:
            headers = jsonschema.Draft202012Validator(message["headers"])
            if headers.is_valid(attributes):
                found.append(name)
    return found


def test_the_command_prints_the_document(api: dict[str, Any]) -> None:
    assert json.loads(plotfeed_here("schema", "asyncapi").stdout) == api


def test_every_format_and_category_is_told_of(api: dict[str, Any]) -> None:
    for kind, keys in sensors.SENSORS.items():
        for name in keys.formats:
            assert name in FORMATS
            category = name.removeprefix("asterix-")
            channel = api["channels"][f"asterix-{category}" if category != name else name]
            assert kind in channel["x-sensor-types"]
    told = {category for row in FORMATS.values() for category in row.facts.categories}
    assert told | {129} == CATEGORIES.keys()


@pytest.mark.asyncio
async def test_what_a_session_publishes_is_what_the_document_says(
    api: dict[str, Any], tmp_path: Path
) -> None:
    port = free_port()
    with own_broker(tmp_path, port):
        heard, left = await asyncio.wait_for(published(scene(), port), 120)
    seen: set[str] = set()
    events: set[str] = set()
    for message in heard:
        attributes = message.user_properties
        (name,) = matching(api, message.topic, message.content_type, attributes)
        seen.add(name)
        event = event_of(attributes)
        assert event not in events
        events.add(event)
        binding = api["operations"][name]["bindings"]["mqtt"]
        assert (left[event].qos, left[event].retain) == (binding["qos"], binding["retain"])
        assert message.expiry_s == binding.get("messageExpiryInterval")
        (described,) = (resolved(api, m) for m in api["operations"][name]["messages"])
        if described["contentType"] == "application/json":
            jsonschema.validate(json.loads(message.payload), described["payload"])
    of_another_scene = {"sendClaimedProtobuf", "sendScore"}  # claims in JSON, and no tracker
    assert seen | of_another_scene == set(sends(api))
    keeps = [n for n, o in sends(api).items() if o["bindings"]["mqtt"]["retain"]]
    of_nodes = ["sendSapientRegistration", "sendSapientGoodbye"]
    of_all = ["sendStatus", "sendSettings", "sendDescription", "sendSession"]
    assert keeps == [*of_nodes, *of_all]


def test_commands_are_taken_as_their_schema_says(api: dict[str, Any]) -> None:
    schema = api["components"]["messages"]["control"]["payload"]
    for command in (
        {"sensor": "radar", "set": {"link": {"latency_ms": 250}}},
        {"sensor": "radar", "reset": True},
        {"clock": {"speed": 10}},
    ):
        jsonschema.validate(command, schema)
        assert parsed(json.dumps(command).encode())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"clock": {"sped": 10}}, schema)


def test_the_scenes_qos_is_that_of_the_operations_that_say_so(api: dict[str, Any]) -> None:
    sent = fly(scene(qos=1, truth=False), 8.0).messages
    assert sent
    for message in sent:
        (name,) = matching(api, message.topic, message.content_type, dict(message.properties))
        operation = api["operations"][name]
        assert message.qos == max(operation.get("x-qos", [operation["bindings"]["mqtt"]["qos"]]))
        assert name != "sendTruth"


def test_telemetry_is_taken_as_its_schema_says(api: dict[str, Any]) -> None:
    schema = api["components"]["messages"]["telemetryJson"]["payload"]
    jsonschema.validate(TELEMETRY, schema)
    assert decode(json.dumps(TELEMETRY).encode(), "application/json").altitude_m == 700.0
    assert set(REQUIRED) == set(TELEMETRY)
    for key in REQUIRED:
        lacking = {k: v for k, v in TELEMETRY.items() if k != key}
        assert not jsonschema.Draft202012Validator(schema).is_valid(lacking)
        with pytest.raises(Refused):
            decode(json.dumps(lacking).encode(), "application/json")


# The AsyncAPI document by AsyncAPI's own parser, and its examples by decoders.


def problems_of(api: dict[str, Any], folder: Path) -> dict[str, Any]:
    node = needed("node")
    node_module("@asyncapi/parser")
    path = folder / "asyncapi.json"
    path.write_text(json.dumps(api))
    script = ROOT / "tests" / "support" / "asyncapi_problems.mjs"
    done = subprocess.run(
        [node, str(script), str(NODE_MODULES), str(path)],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_asyncapis_own_parser_finds_what_is_wrong_and_nothing_else(
    api: dict[str, Any], tmp_path: Path
) -> None:
    found = problems_of(api, tmp_path)
    assert found["problems"] == []
    assert {name for name, _ in found["examples"]} == {flow.name for flow in flows()}
    assert {examples for _, examples in found["examples"]} == {1}
    # Two messages in one text of protobuf, which its generator cannot choose from.
    wrong = json.loads(json.dumps(api))
    wrong["components"]["schemas"]["LedgerBatch"]["schema"] += "\n\nmessage Other {}"
    (problem,) = problems_of(wrong, tmp_path)["problems"]
    assert "more than one root" in problem


@pytest.mark.parametrize("flow", flows(), ids=lambda flow: flow.name)
def test_examples_are_what_they_are_examples_of(api: dict[str, Any], flow: Any) -> None:
    message_api = api["components"]["messages"][flow.name]
    payload = message_api["examples"][0]["payload"]
    if "json" in flow.content_type:
        schema = message_api["payload"]
        jsonschema.Draft202012Validator(schema).validate(payload)
    elif flow.message.startswith(f"{OURS}."):
        message = ParseDict(payload, OUR_MESSAGES[flow.message]())
        assert message.ByteSize() > 20
    elif "asterix" in flow.content_type:
        records, errors = decode_lenient(base64.b64decode(payload, validate=True))
        assert (len(errors), len(records) > 0) == (0, True)
        assert flow.content_type.endswith(f"cat={records[0].category}")
    elif flow.name == "cot":
        event = ET.fromstring(base64.b64decode(payload, validate=True))  # noqa: S314 - our own
        assert event.find("point") is not None
    else:
        from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

        octets = base64.b64decode(payload, validate=True)
        assert SapientMessage.FromString(octets).WhichOneof("content")
