from __future__ import annotations

import json
import math
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.position_report import (
    MAX_OCTETS,
    PositionReport,
    Reason,
    Refused,
    check,
    decode,
)
from plotfeed.models.state import AltitudeReference, Emitter
from plotfeed.proto import plotfeed_pb2 as pb

REPORT = PositionReport(
    t_utc_ns=1_600_000_000_123_456_789,
    latitude_deg=40.45,
    longitude_deg=-3.73,
    altitude_m=700.5,
    altitude_reference=AltitudeReference.ELLIPSOID,
    velocity_enu_m_s=(1.0, -2.0, 0.5),
    horizontal_accuracy_m=1.5,
    size_m=0.5,
    target_class="aircraft",
    rcs_m2=0.01,
    emitters=(Emitter(frequency_hz=2.4e9, bandwidth_hz=2e7, eirp_dbm=20.0, kind="control"),),
)
FIELDS: dict[str, Any] = {
    "time_utc": "2022-05-01T00:00:00Z",
    "latitude_deg": 40.0,
    "longitude_deg": -3.0,
    "altitude_m": 700.0,
    "altitude_reference": "ELLIPSOID",
}

positive = st.floats(0, 1e12, exclude_min=True)
nothing = st.just(math.nan)
non_negative = nothing | st.floats(0, 1e12)
speed = st.floats(-500, 500) | nothing
emitters = st.builds(
    Emitter,
    frequency_hz=positive,
    bandwidth_hz=st.floats(0, 1e12),
    eirp_dbm=st.floats(-200, 200),
    kind=st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
    identity=st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
)
reports = st.builds(
    PositionReport,
    t_utc_ns=st.integers(0, 2**63 - 1),
    latitude_deg=st.floats(-90, 90),
    longitude_deg=st.floats(-180, 180),
    altitude_m=st.floats(-1000, 100_000),
    altitude_reference=st.sampled_from(AltitudeReference),
    velocity_enu_m_s=st.tuples(speed, speed, speed),
    horizontal_accuracy_m=non_negative,
    vertical_accuracy_m=non_negative,
    velocity_accuracy_m_s=non_negative,
    rcs_m2=nothing | positive,
    size_m=nothing | positive,
    target_class=st.sampled_from(["", "drone", "aircraft", "Flügel", "x" * 64]),
    sound_power_db=nothing | st.floats(-100, 300),
    emitters=st.lists(emitters, max_size=3).map(tuple),
)


def refusal(payload: bytes, content_type: str | None = None) -> Refused:
    with pytest.raises(Refused) as caught:
        decode(payload, content_type)
    assert "\n" not in caught.value.detail
    return caught.value


def json_with(**changes: Any) -> bytes:
    fields = {**FIELDS, **changes}
    return json.dumps({k: v for k, v in fields.items() if v is not ...}).encode()


@given(reports)
def test_a_report_survives_either_format_with_or_without_content_type(
    report: PositionReport,
) -> None:
    for payload, content_type in (
        (report.to_protobuf(), "application/x-protobuf"),
        (report.to_json(), "application/json"),
    ):
        assert repr(decode(payload, content_type)) == repr(report)
        # NaN differs from itself, not from its text
        if report.t_utc_ns >= 1_000_000_000:
            assert repr(decode(payload, None)) == repr(report)


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=8,
)


@given(st.sampled_from([*FIELDS, "emitters", "rcsM2", "velocity_up_m_s"]), json_values)
def test_any_value_in_any_field_gives_a_report_or_a_refusal(name: str, value: Any) -> None:
    with suppress(Refused):
        check(decode(json.dumps({**FIELDS, name: value}).encode(), "application/json"))


@pytest.mark.parametrize(
    "content_type",
    [
        "application/x-protobuf",
        "application/protobuf",
        "Application/X-Protobuf; messageType=plotfeed.v1.Telemetry",
        "application/vnd.example+protobuf",
        "application/octet-stream",
        "",
        None,
    ],
)
def test_protobuf_is_told_by_its_content_type(content_type: str | None) -> None:
    assert decode(REPORT.to_protobuf(), content_type) == REPORT


@pytest.mark.parametrize(
    "content_type", ["application/json", "application/json; charset=utf-8", "text/json", "", None]
)
def test_json_is_told_by_its_content_type(content_type: str | None) -> None:
    assert decode(b" \r\n" + REPORT.to_json(), content_type) == REPORT


def test_camel_case_names_are_taken() -> None:
    payload = b"""{"timeUtc": "2022-05-01T00:00:00Z", "latitudeDeg": 40, "longitudeDeg": -3,
        "altitudeM": 700, "altitudeReference": "ABOVE_TAKEOFF", "velocityUpMS": 2}"""
    report = decode(payload, "application/json")
    assert report.t_utc_ns == 1_651_363_200_000_000_000
    assert report.altitude_reference is AltitudeReference.ABOVE_TAKEOFF
    assert repr(report.velocity_enu_m_s) == "(nan, nan, 2.0)"


def test_an_unknown_content_type_is_refused() -> None:
    refused = refusal(REPORT.to_json(), "image/png")
    assert refused.reason is Reason.CONTENT_TYPE
    assert "image/png" in refused.detail


@pytest.mark.parametrize("name", list(FIELDS))
def test_a_missing_field_is_named(name: str) -> None:
    refused = refusal(json_with(**{name: ...}))
    assert refused.reason is Reason.MISSING
    assert name in refused.detail


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"latitude_deg": 90.001}, Reason.OUT_OF_RANGE),
        ({"latitude_deg": -91}, Reason.OUT_OF_RANGE),
        ({"longitude_deg": 180.001}, Reason.OUT_OF_RANGE),
        ({"longitude_deg": -181}, Reason.OUT_OF_RANGE),
        ({"altitude_m": -1001}, Reason.OUT_OF_RANGE),
        ({"altitude_m": 100_001}, Reason.OUT_OF_RANGE),
        ({"velocity_east_m_s": 800, "velocity_up_m_s": 800}, Reason.OUT_OF_RANGE),
        ({"horizontal_accuracy_m": -1}, Reason.OUT_OF_RANGE),
        ({"velocity_accuracy_m_s": -0.5}, Reason.OUT_OF_RANGE),
        ({"rcs_m2": 0}, Reason.OUT_OF_RANGE),
        ({"rcs_m2": -1}, Reason.OUT_OF_RANGE),
        ({"size_m": 0}, Reason.OUT_OF_RANGE),
        ({"target_class": "a/b"}, Reason.NAME),
        ({"target_class": "x" * 65}, Reason.NAME),
        ({"target_class": 5}, Reason.UNDECODABLE),
        ({"emitters": [{"frequency_hz": 0}]}, Reason.OUT_OF_RANGE),
        ({"emitters": [{"frequency_hz": 1e9, "eirp_dbm": "NaN"}]}, Reason.NOT_FINITE),
        ({"latitude_deg": "NaN"}, Reason.NOT_FINITE),
        ({"latitude_deg": math.nan}, Reason.NOT_FINITE),
        ({"altitude_m": math.inf}, Reason.NOT_FINITE),
        ({"velocity_up_m_s": "-Infinity"}, Reason.NOT_FINITE),
        ({"velocity_up_m_s": "NaN"}, Reason.NOT_FINITE),
        ({"time_utc": "1969-12-31T23:59:59Z"}, Reason.OUT_OF_RANGE),
        ({"time_utc": "2400-01-01T00:00:00Z"}, Reason.OUT_OF_RANGE),
        ({"time_utc": 5}, Reason.UNDECODABLE),
        ({"altitude_reference": "GROUND"}, Reason.UNDECODABLE),
        ({"altitude_reference": 99}, Reason.MISSING),
        ({"latitude": 4}, Reason.UNDECODABLE),
        ({"altitude_m": True}, Reason.UNDECODABLE),
        ({"emitters": {"a": 1}}, Reason.UNDECODABLE),
    ],
)
def test_bad_values_are_refused(changes: dict[str, Any], reason: Reason) -> None:
    refused = refusal(json_with(**changes))
    assert refused.reason is reason


def test_the_limits_themselves_are_taken() -> None:
    for longitude_deg in (180.0, -180.0):
        payload = json_with(longitude_deg=longitude_deg, latitude_deg=-90, altitude_m=-1000)
        assert decode(payload).longitude_deg == longitude_deg


@pytest.mark.parametrize(
    "payload",
    [
        b"[" * 4000,
        b'{"emitters":' * 300,
        b'{"emitters":[{"kind":"\\ud800"}]}',
        b'{"latitude_deg":' + b"9" * 4000 + b"}",
        b'{"latitude_deg":1e999}',
        b'{"latitude_deg":1,"latitude_deg":2}',
        b"{}" * 5,
        b"[]",
        b"null",
        b"\xff\xfe{",
    ],
)
def test_hostile_json_is_refused(payload: bytes) -> None:
    assert refusal(payload, "application/json").reason in {Reason.UNDECODABLE, Reason.NOT_FINITE}


def test_a_payload_too_large_is_refused_unread() -> None:
    assert refusal(b"{" + b" " * MAX_OCTETS).reason is Reason.OVERSIZED


def test_an_empty_payload_misses_its_fields() -> None:
    assert refusal(b"").reason is Reason.MISSING


def test_nanoseconds_outside_a_second_are_refused() -> None:
    message = pb.Telemetry()
    message.ParseFromString(REPORT.to_protobuf())
    message.time_utc.nanos = -1
    assert refusal(message.SerializeToString()).reason is Reason.OUT_OF_RANGE


def test_a_velocity_of_which_nothing_is_known_is_left_out() -> None:
    report = REPORT._replace(velocity_enu_m_s=(math.nan,) * 3)
    assert b"velocity" not in report.to_json()
    assert decode(report.to_protobuf()) == report
