"""A decoded SAPIENT message as one line."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

ENVELOPE = frozenset({"timestamp", "node_id", "destination_id", "additional_information"})
MAX_TEXT = 2000


def sapient_line(message: Mapping[str, Any]) -> str:
    """When, who in short, what kind of message, and what is in it."""
    (kind,) = message.keys() - ENVELOPE
    content: Mapping[str, Any] = message[kind]
    parts = {
        "detection_report": _detection,
        "registration": _registration,
        "status_report": _status,
    }
    words = parts[kind](content) if kind in parts else iter([json.dumps(content)[:MAX_TEXT]])
    node = str(message.get("node_id", "?"))[:8]
    return "  ".join([str(message.get("timestamp", "?")), node, kind, *words])


def _detection(report: Mapping[str, Any]) -> Iterator[str]:
    for place in ("range_bearing", "location"):
        yield from _numbers(report.get(place, {}))
    for found in report.get("classification", ()):
        below = "".join(f"/{sub.get('type')}" for sub in found.get("sub_class", ()))
        yield f"class {found.get('type')}{below} {found.get('confidence', '')}".rstrip()
    for info in report.get("object_info", ()):
        yield f"{info.get('type')} {info.get('value')}"
    for signal in report.get("signal", ()):
        yield from _numbers(signal)
    if "id" in report:
        yield f"id {report['id']}"


def _registration(registration: Mapping[str, Any]) -> Iterator[str]:
    yield str(registration.get("name"))
    for node in registration.get("node_definition", ()):
        yield " ".join([str(node.get("node_type")), *node.get("node_sub_type", ())])
    yield str(registration.get("icd_version"))


def _status(report: Mapping[str, Any]) -> Iterator[str]:
    yield from (str(report.get(name)) for name in ("system", "info", "mode"))
    yield from _numbers(report.get("node_location", {}))


def _numbers(fields: Mapping[str, Any]) -> Iterator[str]:
    """Those of a part; its enumerations say the same in every message."""
    for name, value in fields.items():
        if isinstance(value, int | float):
            yield f"{name} {value:.9g}"
