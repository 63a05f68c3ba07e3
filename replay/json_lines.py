"""Recordings as lines of JSON, an object a message, with all that is known of it; both ways."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from typing import Any, BinaryIO

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.recorded import LATEST_NS, Recorded, RecordingReader, RecordingWriter, Stage

MAX_LINE_OCTETS = 1 << 26


def to_json(message: Recorded) -> str:
    """One line, without its end; keys are the fields of `Recorded`, the payload is base64."""
    return json.dumps(
        {
            "topic": message.topic,
            "log_time_ns": message.log_time_ns,
            "publish_time_ns": message.publish_time_ns,
            "stage": str(message.stage),
            "content_type": message.content_type,
            "properties": message.properties,
            "retain": message.retain,
            "qos": message.qos,
            "payload_base64": base64.b64encode(message.payload).decode("ascii"),
        }
    )


def from_json(line: bytes) -> Recorded:
    """The message of a line, with at least topic, payload and log time; raises `DecodeError`."""
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):
        raise DecodeError("a line that is no JSON") from None
    if not isinstance(fields, dict):
        raise DecodeError("a line that is no JSON object")
    log_time_ns = _time(fields, "log_time_ns")
    due = "publish_time_ns" in fields
    return Recorded(
        topic=_text(fields.get("topic"), "topic"),
        payload=_payload(fields.get("payload_base64")),
        log_time_ns=log_time_ns,
        publish_time_ns=_time(fields, "publish_time_ns") if due else log_time_ns,
        content_type=_text(fields.get("content_type", ""), "content_type"),
        properties=_properties(fields.get("properties", [])),
        retain=bool(_one_of(fields.get("retain", False), "retain", (False, True))),
        qos=int(_one_of(fields.get("qos", 0), "qos", (0, 1, 2))),
        stage=Stage(_one_of(fields.get("stage", "received"), "stage", tuple(map(str, Stage)))),
    )


class JsonLinesReader(RecordingReader):
    """The messages of a file. A line that is none is damage, and the next one is read."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__()
        self._file = file
        self._read = 0

    @property
    def at(self) -> int:
        """Octets of the file that were read."""
        return self._read

    def messages(self) -> Iterator[Recorded]:
        """The message of each line that is not blank."""
        while line := self._file.readline(MAX_LINE_OCTETS):
            begin = self._read
            self._read += len(line)
            if len(line) == MAX_LINE_OCTETS and not line.endswith(b"\n"):
                self.damage.add(begin, f"a line of more than {MAX_LINE_OCTETS} octets")
                while line and not line.endswith(b"\n"):
                    line = self._file.readline(MAX_LINE_OCTETS)
                    self._read += len(line)
                continue
            if line.isspace():
                continue
            try:
                message = from_json(line)
            except DecodeError as error:
                self.damage.add(begin, str(error))
                continue
            yield message


class JsonLinesWriter(RecordingWriter):
    """Everything that a message has, a line each."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, message: Recorded) -> str | None:
        """Write a message; nothing cannot be held."""
        self._file.write(to_json(message).encode("ascii") + b"\n")
        return None


def _time(fields: dict[str, Any], name: str) -> int:
    value = fields.get(name)
    if type(value) is not int or not 0 <= value <= LATEST_NS:
        raise DecodeError(f"{name}: expected nanoseconds since 1970, up to 2554")
    return value


def _text(value: Any, name: str) -> str:
    if not isinstance(value, str):
        raise DecodeError(f"{name}: expected a text")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise DecodeError(f"{name}: half of a surrogate pair is no character") from None
    return value


def _payload(value: Any) -> bytes:
    try:
        return base64.b64decode(_text(value, "payload_base64"), validate=True)
    except ValueError:
        raise DecodeError("payload_base64: expected base64") from None


def _properties(value: Any) -> tuple[tuple[str, str], ...]:
    if not isinstance(value, list) or any(
        not isinstance(pair, list) or len(pair) != 2 for pair in value
    ):
        raise DecodeError("properties: expected a list of pairs")
    return tuple((_text(key, "properties"), _text(text, "properties")) for key, text in value)


def _one_of(value: Any, name: str, allowed: tuple[Any, ...]) -> Any:
    if type(value) is not type(allowed[0]) or value not in allowed:
        raise DecodeError(f"{name}: expected one of {', '.join(map(str, allowed))}")
    return value
