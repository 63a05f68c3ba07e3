"""The fast way and the careful one agree, whatever comes."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.position_report import PositionReport, Refused, decode, fast_decode
from plotfeed.models.state import AltitudeReference, Emitter
from plotfeed.proto import plotfeed_pb2 as pb

FIELDS: dict[str, Any] = {
    "time_utc": "2022-05-01T00:00:00.25Z",
    "latitude_deg": 40.0,
    "longitude_deg": -3.0,
    "altitude_m": 700.0,
    "altitude_reference": "ELLIPSOID",
}
JSON, PROTOBUF = "application/json", "application/x-protobuf"


def careful(payload: bytes, content_type: str | None) -> PositionReport | None:
    try:
        return decode(payload, content_type)
    except Refused:
        return None


def assert_agree(payload: bytes, content_type: str | None) -> bool:
    """Whether the fast way knew; what it gives is what the careful way gives."""
    found = fast_decode(payload, content_type)
    if found is None:
        return False
    expected = careful(payload, content_type)
    assert expected is not None
    assert repr(found) == repr(expected)  # to the last bit, the sign of a zero too
    return True


coordinate = st.floats(-100, 100) | st.sampled_from([0.0, -0.0, 90.0, -90.0, 90.0000001])
number = st.floats() | st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-300, 989.9, 999.9, 1000.0])
optional = st.none() | number
messages = st.fixed_dictionaries(
    {},
    optional={
        "latitude_deg": coordinate,
        "longitude_deg": coordinate,
        "altitude_m": coordinate | number,
        "altitude_reference": st.integers(0, 4),
        "velocity_east_m_s": number,
        "velocity_north_m_s": number,
        "velocity_up_m_s": number,
        "horizontal_accuracy_m": number,
        "vertical_accuracy_m": number,
        "velocity_accuracy_m_s": number,
        "rcs_m2": number,
        "sound_power_db": number,
        "size_m": number,
        "target_class": st.sampled_from(["", "aircraft", "a b", "x" * 65, "\n"]),
        "emitters": st.lists(
            st.fixed_dictionaries(
                {},
                optional={
                    "frequency_hz": number,
                    "bandwidth_hz": number,
                    "eirp_dbm": number,
                    "kind": st.text(st.characters(exclude_categories=["Cs"]), max_size=4),
                },
            ),
            max_size=2,
        ),
    },
)


@given(messages, st.none() | st.integers(-2, 2**40), st.integers(-2, 2**31 - 1))
def test_any_protobuf_is_read_alike(
    fields: dict[str, Any], seconds: int | None, nanos: int
) -> None:
    message = pb.Telemetry(**fields)
    if seconds is not None:
        message.time_utc.seconds, message.time_utc.nanos = seconds, nanos
    for content_type in (PROTOBUF, None, "application/vnd.example+protobuf; a=b"):
        assert_agree(message.SerializeToString(), content_type)


@given(st.binary(max_size=60), st.sampled_from([None, JSON, PROTOBUF, "text/plain", "é"]))
def test_any_octets_are_read_alike(payload: bytes, content_type: str | None) -> None:
    assert_agree(payload, content_type)


anything = st.recursive(
    st.none() | st.booleans() | number | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=6,
)
digits = st.integers(0, 99).map(lambda n: f"{n:02}")
clock_times = st.tuples(digits, digits, digits).map(":".join)
times = st.builds(
    "{}-{}-{}T{}{}{}".format,
    st.sampled_from(["2022", "1970", "1969", "0001", "9999", "2262", "22", "²022"]),
    digits,
    digits,
    clock_times | st.just("12:00:00"),
    st.just("") | st.text("0123456789", max_size=11).map(".{}".format) | st.text(max_size=3),
    st.sampled_from(["Z", "", "z", "+01:00", "ZZ", " Z", "-00:30"]),
)
spellings = {
    field.name: st.sampled_from([field.name, field.json_name])
    for field in pb.Telemetry.DESCRIPTOR.fields
}
values = {
    "time_utc": times | st.just(FIELDS["time_utc"]) | anything,
    "target_class": st.sampled_from(["", "aircraft", "a+b", "x" * 65, "\ud800"]) | anything,
    "altitude_reference": st.sampled_from(["ELLIPSOID", "MEAN_SEA_LEVEL", "x", 1, 2, 9]) | anything,
    "emitters": st.lists(
        st.dictionaries(
            st.sampled_from(["frequency_hz", "frequencyHz", "eirpDbm", "kind", "identity", "x"]),
            number | st.text(max_size=3) | st.integers(),
        )
        | anything,
        max_size=2,
    )
    | anything,
}


@given(st.data(), st.booleans(), st.sampled_from(["", " ", "\n", "{", "\0"]))
def test_any_json_is_read_alike(data: st.DataObject, ascii_only: bool, tail: str) -> None:
    pairs = list(FIELDS.items())
    for name in data.draw(st.lists(st.sampled_from([*spellings]), max_size=4)):
        spelling = data.draw(spellings[name])
        value = data.draw(values.get(name, number | st.integers() | anything))
        if data.draw(st.booleans()):
            pairs = [(key, old) for key, old in pairs if key != name]
        pairs.append((spelling, value))
    inner = [
        f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=ascii_only)}" for key, value in pairs
    ]
    text = "{" + ", ".join(inner) + "}" + tail
    payload = text.encode("utf-8", "surrogatepass")
    for content_type in (JSON, None):
        assert_agree(payload, content_type)


@given(times)
@example("2022-05-01T24:00:00Z")
@example("2022-05-01T23:59:60Z")
@example("2024-02-29T00:00:00.123456789Z")
@example("2023-02-29T00:00:00Z")
def test_any_time_is_read_alike(text: str) -> None:
    assert_agree(json.dumps(FIELDS | {"time_utc": text}).encode(), JSON)


USUAL = PositionReport(
    t_utc_ns=1_600_000_000_123_456_789,
    latitude_deg=40.45,
    longitude_deg=-3.73,
    altitude_m=700.5,
    altitude_reference=AltitudeReference.ABOVE_TAKEOFF,
    velocity_enu_m_s=(1.0, math.nan, 0.0),
    vertical_accuracy_m=1.5,
    rcs_m2=0.01,
    size_m=11.0,
    target_class="aircraft",
    emitters=(Emitter(frequency_hz=2.4e9, eirp_dbm=20.0, kind="vidéo"),),
)


@pytest.mark.parametrize("content_type", [JSON, PROTOBUF, None])
def test_what_is_usual_is_read_fast(content_type: str | None) -> None:
    if content_type != JSON:
        assert assert_agree(USUAL.to_protobuf(), content_type)
    if content_type != PROTOBUF:
        assert assert_agree(USUAL.to_json(), content_type)
        assert assert_agree(json.dumps(FIELDS | {"altitude_m": 0}).encode(), content_type)


@pytest.mark.parametrize(
    "payload",
    [
        b'{"emitters": {}}',
        b'{"emitters": []}',
        b'{"emitters": [[["kind", "x"]]]}',
        b'{"emitters": [{}]}',
        b'{"latitude_deg": 1, "latitudeDeg": 1}',
        b'{"latitude_deg": 1, "latitude_deg": 1}',
        b'{"altitude_m": true}',
        b'{"altitude_m": NaN}',
        b'{"velocity_up_m_s": Infinity}',
        b'{"velocity_up_m_s": 1e999}',
        b'{"rcs_m2": 1e999}',
        b'{"sound_power_db": -1e999}',
        b'{"altitude_m": null}',
        b'{"altitude_m": "5"}',
    ],
)
def test_what_is_doubtful_is_read_alike(payload: bytes) -> None:
    fields = ", ".join(
        f"{json.dumps(key)}: {json.dumps(value)}"
        for key, value in FIELDS.items()
        if key.encode() not in payload
    )
    assert_agree(payload[:-1] + b", " + fields.encode() + b"}", JSON)
    assert_agree(b"[" + b'["a", 1]' + b"]", JSON)
