"""The AsyncAPI document by AsyncAPI's own parser, and its examples by decoders."""

from __future__ import annotations

import base64
import json
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from google.protobuf.json_format import ParseDict
from support.tools import NODE_MODULES, ROOT, needed, node_module

from plotfeed.feeds.schema.asyncapi import OURS, document, flows
from plotfeed.proto.asterix.codec.decode import decode_lenient
from plotfeed.proto.message_kinds import OUR_MESSAGES


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


def test_asyncapis_own_parser_finds_nothing_wrong(tmp_path: Path) -> None:
    found = problems_of(document(), tmp_path)
    assert found["problems"] == []
    assert {name for name, _ in found["examples"]} == {flow.name for flow in flows()}
    assert {examples for _, examples in found["examples"]} == {1}


def test_the_parser_finds_what_is_wrong(tmp_path: Path) -> None:
    """Two messages in one text of protobuf, which its generator cannot choose from."""
    api = document()
    api["components"]["schemas"]["LedgerBatch"]["schema"] += "\n\nmessage Other {}"
    (problem,) = problems_of(api, tmp_path)["problems"]
    assert "more than one root" in problem


@pytest.mark.parametrize("flow", flows(), ids=lambda flow: flow.name)
def test_examples_are_what_they_are_examples_of(flow: Any) -> None:
    (example,) = document()["components"]["messages"][flow.name]["examples"]
    payload = example["payload"]
    if "json" in flow.content_type:
        schema = document()["components"]["messages"][flow.name]["payload"]
        problems = [e.message for e in jsonschema.Draft202012Validator(schema).iter_errors(payload)]
        assert not problems
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
