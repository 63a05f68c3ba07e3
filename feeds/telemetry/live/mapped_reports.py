"""Reports of drones from JSON as other systems publish it, by the mappings of a scene."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from plotfeed.feeds.scene.telemetry_keys import PLACE, TelemetryMapping
from plotfeed.feeds.telemetry.live.heard import HeardReport, named, unforeseen
from plotfeed.feeds.telemetry.position_report import (
    PositionReport,
    Reason,
    Refused,
    Velocity,
    over_ground,
)
from plotfeed.proto.units import FOOT_M, KNOT_M_S, MILE_H_M_S
from plotfeed.proto.utc import utc_ns

MAX_PAYLOAD_OCTETS = 65_536
ANGLES = {"deg": 1.0, "rad": 180 / math.pi, "1e-7deg": 1e-7}
LENGTHS = {"m": 1.0, "ft": FOOT_M, "mm": 1e-3, "cm": 1e-2}
SPEEDS_M_S = {"m/s": 1.0, "km/h": 1 / 3.6, "kn": KNOT_M_S, "mph": MILE_H_M_S, "cm/s": 1e-2}
TIMES_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
MOST_NS = 2.0**100  # Far beyond all that is taken for a time; a product of two numbers may be inf


class MappedReports:
    """Knows which topics are mapped, and makes reports of what comes on them."""

    def __init__(self, mappings: Sequence[TelemetryMapping]) -> None:
        self._mappings = [(mapping, mapping.topic.split("/")) for mapping in mappings]

    @property
    def topics(self) -> list[str]:
        """What there is to subscribe to."""
        return list(dict.fromkeys(mapping.filter for mapping, _ in self._mappings))

    def maps(self, topic: str) -> bool:
        """Whether that topic is mapped."""
        return self._found(topic) is not None

    def hear(self, topic: str, payload: bytes, now_utc_ns: int) -> HeardReport | None:
        """The report, or why there is none; None for a topic that is not mapped."""
        found = self._found(topic)
        return None if found is None else _heard(*found, payload, now_utc_ns)

    def _found(self, topic: str) -> tuple[TelemetryMapping, str] | None:
        """The mapping of a topic, and the drone that the topic names, if any."""
        levels = topic.split("/")
        for mapping, pattern in self._mappings:
            if len(levels) == len(pattern) and all(
                theirs in ("+", PLACE, ours) for ours, theirs in zip(levels, pattern, strict=True)
            ):
                return mapping, levels[pattern.index(PLACE)] if PLACE in pattern else ""
        return None


def _heard(mapping: TelemetryMapping, drone: str, payload: bytes, now_utc_ns: int) -> HeardReport:
    if mapping.drone is None:
        drone = named(PLACE, {"drone": drone})
    try:
        tree = _tree(payload)
        if mapping.drone is not None:
            drone = named(PLACE, {"drone": _value(tree, mapping.drone)})
        return HeardReport.checked(drone, _report(mapping, tree, now_utc_ns))
    except Refused as refused:
        return HeardReport(drone, refused)
    except Exception as error:  # noqa: BLE001 - of strangers' data, whatever it is
        return HeardReport(drone, unforeseen(error))


def _tree(payload: bytes) -> Any:
    if len(payload) > MAX_PAYLOAD_OCTETS:
        detail = f"payload of {len(payload)} octets; at most {MAX_PAYLOAD_OCTETS} are taken"
        raise Refused(Reason.OVERSIZED, detail)
    try:
        return json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise Refused(Reason.UNDECODABLE, f"payload is not JSON: {error}") from error


def _value(tree: Any, path: str) -> Any:
    """What stands at a path; raises `Refused` that names it."""
    found = tree
    for key in path.split("."):
        if isinstance(found, dict) and key in found:
            found = found[key]
        elif isinstance(found, list) and key.isascii() and key.isdigit() and len(key) < 6:
            if int(key) >= len(found):
                raise Refused(Reason.MISSING, f"{path} is missing")
            found = found[int(key)]
        else:
            raise Refused(Reason.MISSING, f"{path} is missing")
    if found is None:
        raise Refused(Reason.MISSING, f"{path} is null")
    return found


def _number(tree: Any, path: str) -> float:
    value = _value(tree, path)
    try:
        if isinstance(value, bool):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        detail = f"{path} is {ascii(value)[:40]}; expected a number"
        raise Refused(Reason.UNDECODABLE, detail) from None
    if not math.isfinite(number):
        raise Refused(Reason.NOT_FINITE, f"{path} is {number}; expected a finite number")
    return number


def _report(mapping: TelemetryMapping, tree: Any, now_utc_ns: int) -> PositionReport:
    angle = ANGLES[mapping.angle_unit]

    def accuracy(path: str | None) -> float:
        return math.nan if path is None else _number(tree, path)

    return PositionReport(
        t_utc_ns=_time_ns(mapping, tree, now_utc_ns),
        latitude_deg=_number(tree, mapping.latitude) * angle,
        longitude_deg=_number(tree, mapping.longitude) * angle,
        altitude_m=_number(tree, mapping.altitude) * LENGTHS[mapping.altitude_unit],
        altitude_reference=mapping.altitude_reference,
        velocity_enu_m_s=_velocity(mapping, tree),
        horizontal_accuracy_m=accuracy(mapping.horizontal_accuracy_m),
        vertical_accuracy_m=accuracy(mapping.vertical_accuracy_m),
        rcs_m2=math.nan if mapping.rcs_m2 is None else mapping.rcs_m2,
    )


def _time_ns(mapping: TelemetryMapping, tree: Any, now_utc_ns: int) -> int:
    if mapping.time is None:
        return now_utc_ns
    if mapping.time_format == "iso":
        text = _value(tree, mapping.time)
        found = utc_ns(text) if isinstance(text, str) else None
        if found is None:
            detail = f"{mapping.time} is {ascii(text)[:40]}; expected ISO 8601 with a zone"
            raise Refused(Reason.UNDECODABLE, detail)
        return found
    value = _value(tree, mapping.time)
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 63:
        return value * TIMES_NS[mapping.time_format]  # to the last digit
    t_utc_ns = _number(tree, mapping.time) * TIMES_NS[mapping.time_format]
    return round(max(-MOST_NS, min(t_utc_ns, MOST_NS)))


def _velocity(mapping: TelemetryMapping, tree: Any) -> Velocity:
    unit_m_s = SPEEDS_M_S[mapping.speed_unit]

    def of(path: str | None) -> float:
        return math.nan if path is None else _number(tree, path) * unit_m_s

    up = of(mapping.velocity_up) if mapping.velocity_down is None else -of(mapping.velocity_down)
    if mapping.speed is not None and mapping.course is not None:
        return over_ground(of(mapping.speed), _number(tree, mapping.course), up)
    return of(mapping.velocity_east), of(mapping.velocity_north), up
