from __future__ import annotations

import base64
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.recordings import MESSAGES, START_NS, message, plots, read, written

from plotfeed.replay import files
from plotfeed.replay.files import JsonLinesReader, JsonLinesWriter
from plotfeed.replay.recorded import Recorded


@settings(max_examples=50)
@given(st.lists(MESSAGES, max_size=3))
def test_everything_that_a_message_has_comes_back(messages: list[Recorded]) -> None:
    data = written(JsonLinesWriter, messages)
    assert len(data.splitlines()) == len(messages)
    got, reader = read(JsonLinesReader, data)
    assert got == messages
    assert reader.damage == []
    assert reader.at == len(data)


def test_a_line_is_an_object_with_the_fields_by_name() -> None:
    (one,) = plots(1)
    (line,) = written(JsonLinesWriter, [one]).splitlines()
    fields = json.loads(line)
    assert base64.b64decode(fields.pop("payload_base64")) == one.payload
    assert fields == {
        "topic": "plotfeed/radar/asterix/048",
        "log_time_ns": START_NS,
        "publish_time_ns": START_NS,
        "stage": "received",
        "content_type": "application/x-asterix; cat=48",
        "properties": [],
        "retain": False,
        "qos": 0,
    }


def test_topic_payload_and_log_time_are_enough() -> None:
    (one,), reader = read(
        JsonLinesReader, b'\n{"topic": "t", "payload_base64": "", "log_time_ns": 7}'
    )
    assert one == message(b"", 7, topic="t", content_type="")
    assert reader.damage == []


GOOD = {"topic": "t", "payload_base64": "AAAA", "log_time_ns": 7}


@pytest.mark.parametrize(
    ("line", "what"),
    [
        (b"[]", "a line that is no JSON object"),
        (b"{", "a line that is no JSON"),
        (b"\xff\xfe{}", "a line that is no JSON"),
        (b"[" * 100_000, "a line that is no JSON"),
        (b"9" * 10_000, "a line that is no JSON"),
        ({"topic": 7}, "topic: expected a text"),
        ({"topic": "\ud800"}, "topic: half of a surrogate pair is no character"),
        ({"payload_base64": "A"}, "payload_base64: expected base64"),
        ({"payload_base64": "é==="}, "payload_base64: expected base64"),
        ({"payload_base64": None}, "payload_base64: expected a text"),
        ({"log_time_ns": -1}, "log_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"log_time_ns": 1.5}, "log_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"log_time_ns": True}, "log_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"publish_time_ns": None}, "publish_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"log_time_ns": 1 << 64}, "log_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"qos": 3}, "qos: expected one of 0, 1, 2"),
        ({"qos": True}, "qos: expected one of 0, 1, 2"),
        ({"retain": 1}, "retain: expected one of False, True"),
        ({"stage": "x"}, "stage: expected one of telemetry, before, after, received"),
        ({"stage": ["x"]}, "stage: expected one of telemetry, before, after, received"),
        ({"properties": {}}, "properties: expected a list of pairs"),
        ({"properties": [["a"]]}, "properties: expected a list of pairs"),
        ({"properties": [["a", 1]]}, "properties: expected a text"),
        ({"content_type": None}, "content_type: expected a text"),
    ],
)
def test_a_line_that_is_no_message_is_damage_and_the_next_is_read(
    line: bytes | dict[str, object], what: str
) -> None:
    if isinstance(line, dict):
        line = json.dumps(GOOD | line).encode()
    good = json.dumps(GOOD).encode() + b"\n"
    messages, reader = read(JsonLinesReader, good + line + b"\n" + good)
    assert len(messages) == 2
    assert [(each.offset, each.what) for each in reader.damage] == [(len(good), what)]


def test_a_line_without_end_is_damage_and_the_next_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MAX_LINE_OCTETS", 100)
    good = json.dumps(GOOD).encode() + b"\n"
    long = json.dumps(GOOD | {"topic": "t" * 250}).encode() + b"\n"
    messages, reader = read(JsonLinesReader, good + long + good)
    assert len(messages) == 2
    assert [each.offset for each in reader.damage] == [len(good)]
    assert reader.at == len(good) * 2 + len(long)
