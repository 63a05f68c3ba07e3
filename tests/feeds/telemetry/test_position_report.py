"""Reports from bytes: a fast way and a careful one agree whatever comes, and say what is wrong."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.position_report import (
    MAX_OCTETS,
    UNKNOWN_VELOCITY,
    PositionReport,
    Reason,
    Refused,
    decode,
    fast_decode,
)
from plotfeed.feeds.telemetry.position_report import OTHERS as OTHER_NUMBERS
from plotfeed.models.state import AltitudeReference, Emitter
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat129 import TargetEncoder129
from plotfeed.proto.asterix.decode_cooperative import is_block_129
from plotfeed.proto.utc import DAY_NS, nearest_utc_ns

JSON, PROTOBUF = "application/json", "application/x-protobuf"
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
    emitters=(Emitter(frequency_hz=2.4e9, bandwidth_hz=2e7, eirp_dbm=20.0, kind="vidéo"),),
)
FIELDS: dict[str, Any] = {
    "time_utc": "2022-05-01T00:00:00.25Z",
    "latitude_deg": 40.0,
    "longitude_deg": -3.0,
    "altitude_m": 700.0,
    "altitude_reference": "ELLIPSOID",
}


def said(**changes: Any) -> bytes:
    fields = {**FIELDS, **changes}
    return json.dumps({k: v for k, v in fields.items() if v is not ...}).encode()


def refusal(payload: bytes, content_type: str | None = None, now: int | None = None) -> Refused:
    assert fast_decode(payload, content_type) is None
    with pytest.raises(Refused) as caught:
        decode(payload, content_type, now_utc_ns=now)
    assert caught.value.detail.isprintable()
    return caught.value


def read_fast(payload: bytes, content_type: str | None) -> bool:
    """Whether the fast way knew; what it gives is what the careful way gives, or refuses."""
    found = fast_decode(payload, content_type)
    try:
        expected = repr(decode(payload, content_type))
    except Refused:
        expected = "None"
    assert found is None or repr(found) == expected  # to the last bit, the sign of a zero too
    return found is not None


text = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
unknown = st.just(math.nan)
positive = st.floats(0, 1e12, exclude_min=True)
accuracy = unknown | st.floats(0, 1e12)
speed = st.floats(-500, 500) | unknown
reports = st.builds(
    PositionReport,
    t_utc_ns=st.integers(0, 2**63 - 1),
    latitude_deg=st.floats(-90, 90),
    longitude_deg=st.floats(-180, 180),
    altitude_m=st.floats(-1000, 100_000),
    altitude_reference=st.sampled_from(AltitudeReference),
    velocity_enu_m_s=st.tuples(speed, speed, speed),
    horizontal_accuracy_m=accuracy,
    vertical_accuracy_m=accuracy,
    velocity_accuracy_m_s=accuracy,
    rcs_m2=unknown | positive,
    size_m=unknown | positive,
    target_class=st.sampled_from(["", "drone", "aircraft", "Flügel", "x" * 64]),
    sound_power_db=unknown | st.floats(-100, 300),
    emitters=st.lists(
        st.builds(
            Emitter,
            frequency_hz=positive,
            bandwidth_hz=st.floats(0, 1e12),
            eirp_dbm=st.floats(-200, 200),
            kind=text,
            identity=text,
        ),
        max_size=3,
    ).map(tuple),
)


@given(reports)
def test_a_report_survives_either_format_with_or_without_content_type(
    report: PositionReport,
) -> None:
    for payload, content_type in ((report.to_protobuf(), PROTOBUF), (report.to_json(), JSON)):
        assert repr(decode(payload, content_type)) == repr(report)  # NaN differs from itself
        if report.t_utc_ns >= 1_000_000_000:
            assert repr(decode(payload, None)) == repr(report)
            assert read_fast(payload, content_type)


number = st.floats() | st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-300, 989.9, 999.9, 1000.0])
coordinate = st.floats(-100, 100) | st.sampled_from([0.0, -0.0, 90.0, -90.0, 90.0000001])
NAMES = [field.name for field in pb.Telemetry.DESCRIPTOR.fields]
emitted = st.dictionaries(st.sampled_from(["frequency_hz", "bandwidth_hz", "eirp_dbm"]), number)
OTHERS: dict[str, st.SearchStrategy[Any]] = {
    "altitude_reference": st.integers(0, 4),
    "target_class": st.sampled_from(["", "aircraft", "a b", "x" * 65, "\n"]),
    "emitters": st.lists(emitted, max_size=2),
}
messages = st.fixed_dictionaries(
    {},
    optional={name: OTHERS.get(name, coordinate | number) for name in NAMES if name != "time_utc"},
)


@given(messages, st.none() | st.integers(-2, 2**40), st.integers(-2, 2**31 - 1))
def test_any_protobuf_is_read_alike(
    fields: dict[str, Any], seconds: int | None, nanos: int
) -> None:
    message = pb.Telemetry(**fields)
    if seconds is not None:
        message.time_utc.seconds, message.time_utc.nanos = seconds, nanos
    for content_type in (None, "application/vnd.example+protobuf; a=b"):
        read_fast(message.SerializeToString(), content_type)


anything = st.recursive(
    st.none() | st.booleans() | number | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=6,
)
digits = st.integers(0, 99).map(lambda n: f"{n:02}")
times = st.builds(
    "{}-{}-{}T{}{}{}".format,
    st.sampled_from(["2022", "1970", "1969", "0001", "9999", "2262", "22", "²022"]),
    digits,
    digits,
    st.tuples(digits, digits, digits).map(":".join) | st.just("12:00:00"),
    st.just("") | st.text("0123456789", max_size=11).map(".{}".format) | st.text(max_size=3),
    st.sampled_from(["Z", "", "z", "+01:00", "ZZ", " Z", "-00:30"]),
)
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
    """In either spelling of a field, at its usual place or twice."""
    pairs = list(FIELDS.items())
    for name in data.draw(st.lists(st.sampled_from(NAMES), max_size=4)):
        field = pb.Telemetry.DESCRIPTOR.fields_by_name[name]
        value = data.draw(values.get(name, number | st.integers() | anything))
        if data.draw(st.booleans()):
            pairs = [(key, old) for key, old in pairs if key != name]
        pairs.append((data.draw(st.sampled_from([name, field.json_name])), value))
    inner = [f"{json.dumps(k)}: {json.dumps(v, ensure_ascii=ascii_only)}" for k, v in pairs]
    payload = ("{" + ", ".join(inner) + "}" + tail).encode("utf-8", "surrogatepass")
    for content_type in (JSON, None):
        read_fast(payload, content_type)


@given(times)
@example("2022-05-01T24:00:00Z")
@example("2022-05-01T23:59:60Z")
@example("2024-02-29T00:00:00.123456789Z")
@example("2023-02-29T00:00:00Z")
def test_any_time_is_read_alike(time_utc: str) -> None:
    read_fast(said(time_utc=time_utc), JSON)


@pytest.mark.parametrize(
    ("payload", "content_type"),
    [
        *((USUAL.to_protobuf(), kind) for kind in (PROTOBUF, "application/octet-stream", "", None)),
        (USUAL.to_protobuf(), "Application/X-Protobuf; messageType=plotfeed.v1.Telemetry"),
        (USUAL.to_protobuf(), "application/vnd.example+protobuf"),
        *((USUAL.to_json(), kind) for kind in (JSON, f"{JSON}; charset=utf-8", "text/json", None)),
        (b" \r\n" + USUAL.to_json(), ""),
    ],
)
def test_what_is_usual_is_read_fast_and_told_by_its_content_type(
    payload: bytes, content_type: str | None
) -> None:
    assert read_fast(payload, content_type)
    assert repr(decode(payload, content_type)) == repr(USUAL)


def test_camel_case_names_whole_numbers_the_limits_and_what_is_left_out_are_taken() -> None:
    payload = b"""{"timeUtc": "2022-05-01T00:00:00Z", "latitudeDeg": 40, "longitudeDeg": -3,
        "altitudeM": 0, "altitudeReference": "ABOVE_TAKEOFF", "velocityUpMS": 2}"""
    assert read_fast(payload, JSON)
    report = decode(payload, JSON)
    assert report.t_utc_ns == 1_651_363_200_000_000_000
    assert report.altitude_reference is AltitudeReference.ABOVE_TAKEOFF
    assert repr(report.velocity_enu_m_s) == "(nan, nan, 2.0)"
    for longitude_deg in (180.0, -180.0):
        payload = said(longitude_deg=longitude_deg, latitude_deg=-90, altitude_m=-1000)
        assert decode(payload).longitude_deg == longitude_deg
    bare = report._replace(velocity_enu_m_s=UNKNOWN_VELOCITY)
    assert b"velocity" not in bare.to_json()
    for name in OTHER_NUMBERS:  # each may be all that is said
        report = bare._replace(**{name: 1.5})
        for payload in (report.to_protobuf(), report.to_json()):
            assert repr(fast_decode(payload, None)) == repr(decode(payload)) == repr(report)


BAD: dict[Reason, list[dict[str, Any]]] = {
    Reason.MISSING: [*({name: ...} for name in FIELDS), {"altitude_reference": 99}],
    Reason.OUT_OF_RANGE: [
        *({"latitude_deg": 90.001}, {"latitude_deg": -91}),
        *({"longitude_deg": 180.001}, {"longitude_deg": -181}),
        *({"altitude_m": -1001}, {"altitude_m": 100_001}),
        {"velocity_east_m_s": 800, "velocity_up_m_s": 800},
        *({"horizontal_accuracy_m": -1}, {"velocity_accuracy_m_s": -0.5}),
        *({"rcs_m2": 0}, {"rcs_m2": -1}, {"size_m": 0}, {"emitters": [{"frequency_hz": 0}]}),
        *({"time_utc": "1969-12-31T23:59:59Z"}, {"time_utc": "2400-01-01T00:00:00Z"}),
    ],
    Reason.NOT_FINITE: [
        *({"latitude_deg": "NaN"}, {"latitude_deg": math.nan}, {"altitude_m": math.inf}),
        *({"velocity_up_m_s": "-Infinity"}, {"velocity_up_m_s": "NaN"}),
        {"emitters": [{"frequency_hz": 1e9, "eirp_dbm": "NaN"}]},
    ],
    Reason.NAME: [{"target_class": "a/b"}, {"target_class": "x" * 65}],
    Reason.UNDECODABLE: [
        *({"target_class": 5}, {"time_utc": 5}, {"altitude_reference": "GROUND"}),
        *({"latitude": 4}, {"altitude_m": True}, {"emitters": {"a": 1}}, {"time_utc": "\udfff"}),
        *({"\ud800": 1}, {"emitters": [{"kind": "\ud800"}]}, {"latitudeDeg": 1}),
    ],
}


@pytest.mark.parametrize(
    ("reason", "changes"), [(reason, each) for reason, bad in BAD.items() for each in bad]
)
def test_bad_values_are_refused_by_name(reason: Reason, changes: dict[str, Any]) -> None:
    refused = refusal(said(**changes))
    assert refused.reason is reason
    if reason in {Reason.MISSING, Reason.OUT_OF_RANGE}:
        name = next(iter(changes))
        assert name.replace("velocity_east_m_s", "speed") in refused.detail


@pytest.mark.parametrize(
    "payload",
    [
        *(b"[" * 4000, b'{"emitters":' * 300, b'{"a": ' + b"[" * 2000),
        *(b'{"latitude_deg":' + b"9" * 4000 + b"}", b'{"latitude_deg":1e999}'),
        *(b'{"latitude_deg":1,"latitude_deg":2}', b"{}" * 5, b"[]", b"null", b"\xff\xfe{"),
        *(b'[["a", 1]]', b'{"emitters": [[["kind", "x"]]]}'),
    ],
)
def test_hostile_json_is_refused(payload: bytes) -> None:
    assert refusal(payload, JSON).reason in {Reason.UNDECODABLE, Reason.NOT_FINITE}


def test_what_is_no_report_at_all_is_refused() -> None:
    message = pb.Telemetry.FromString(USUAL.to_protobuf())
    message.time_utc.nanos = -1
    assert refusal(message.SerializeToString()).reason is Reason.OUT_OF_RANGE
    assert refusal(b"{" + b" " * MAX_OCTETS).reason is Reason.OVERSIZED
    assert refusal(b"").reason is Reason.MISSING
    refused = refusal(USUAL.to_json(), "image/png")
    assert refused.reason is Reason.CONTENT_TYPE
    assert "image/png" in refused.detail


S = 1_000_000_000
NOW = 1_767_268_800 * S  # 2026-01-01T12:00:00Z
CAT129 = "application/x-asterix; cat=129"
ENCODER = TargetEncoder129(country="ES")


def block(t_utc_ns: int = NOW, serial: str = "a", **columns: Any) -> bytes:
    given = {"altitude_m": [700.0]} | columns
    given = {name: value for name, value in given.items() if value is not None}
    (data,) = ENCODER.blocks([serial], [t_utc_ns], [40.0], [-3.0], **given)
    return data


def test_what_a_block_says_becomes_a_report() -> None:
    payload = block(accuracy_m=[2.0], velocity_m_s=[[1.0, -2.0, 0.5]])
    report = decode(payload, CAT129, now_utc_ns=NOW)
    assert report.t_utc_ns == NOW
    assert report.latitude_deg == pytest.approx(40.0, abs=90 / 2**30)
    assert report.longitude_deg == pytest.approx(-3.0, abs=90 / 2**30)
    assert report.altitude_m == pytest.approx(700.0)
    assert report.altitude_reference is AltitudeReference.MEAN_SEA_LEVEL
    assert report.velocity_enu_m_s == pytest.approx((1.0, -2.0, 0.5))
    # Half of a circular normal distribution lies within 1.1774 standard deviations.
    assert report.horizontal_accuracy_m == pytest.approx(2.0 / 1.1774, rel=1e-4)
    # It is known by its content type or its looks: only one whole block looks like one.
    whole = block()
    for content_type in (None, "", "application/x-asterix", "Application/X-Asterix;cat=129"):
        bare = decode(whole, content_type, now_utc_ns=NOW)
        assert np.isnan([*bare.velocity_enu_m_s, bare.horizontal_accuracy_m]).all()
    for other in (whole[:-1], whole + b"\0", b"\x30" + whole[1:], b"", b"\x81", b"\x81\x00\x03"):
        assert not is_block_129(other)
    blocks = [block(NOW + k * S, altitude_m=[700.0 + k]) for k in (-2, 0, -1)]
    latest = decode(b"".join(blocks), CAT129, now_utc_ns=NOW)  # of several reports
    assert (latest.t_utc_ns, latest.altitude_m) == (NOW, pytest.approx(700.0))


@given(
    st.integers(0, 11_059_199),  # 1/128 s of a day
    st.integers(-DAY_NS // 2 + 1, DAY_NS // 2 - 1),
)
def test_the_day_is_the_nearest(ticks: int, ahead_ns: int) -> None:
    t_utc_ns = NOW // DAY_NS * DAY_NS + ticks * (S // 128)
    assert nearest_utc_ns(ticks * (S // 128), t_utc_ns - ahead_ns) == t_utc_ns
    report = decode(block(t_utc_ns), CAT129, now_utc_ns=t_utc_ns - ahead_ns)
    assert report.t_utc_ns == t_utc_ns


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (block(serial="a") + block(serial="b"), Reason.NAME),
        (b"", Reason.UNDECODABLE),
        (b"\x81\x00\x03", Reason.UNDECODABLE),
        (b"\x81\xff\xff" + b"\xff" * 40, Reason.UNDECODABLE),
        (b"\x30" + block()[1:], Reason.UNDECODABLE),
        (block()[:-1], Reason.UNDECODABLE),
        (block() * 200, Reason.OVERSIZED),
        (block(altitude_m=None), Reason.MISSING),
        (block(altitude_m=None, height_m=[50.0]), Reason.ALTITUDE),
        (block(altitude_m=[200_000.0]), Reason.OUT_OF_RANGE),
        (block(velocity_m_s=[[5000.0, 0.0, 0.0]]), Reason.OUT_OF_RANGE),
        # 43200 s in 1/128 s, and more than a day has.
        (block().replace(b"\x54\x60\0", (11_059_201).to_bytes(3, "big")), Reason.UNDECODABLE),
    ],
    ids=lambda value: value.name if isinstance(value, Reason) else "",
)
def test_what_is_wrong_is_refused_with_its_reason(payload: bytes, reason: Reason) -> None:
    assert refusal(payload, CAT129, NOW).reason is reason
    assert refusal(block(), "application/x-asterix; cat=48", NOW).reason is Reason.CONTENT_TYPE
    assert refusal(block(), CAT129).reason is Reason.MISSING  # of which day nobody says


@given(st.data())
def test_a_damaged_block_is_a_report_within_bounds_or_a_refusal(data: st.DataObject) -> None:
    payload = bytearray(block(velocity_m_s=[[1.0, 2.0, 3.0]], accuracy_m=[3.0]))
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    with suppress(Refused):
        report = decode(bytes(payload), CAT129, now_utc_ns=NOW)
        assert abs(report.latitude_deg) <= 90
        assert abs(report.t_utc_ns - NOW) <= DAY_NS // 2
        assert math.isfinite(report.altitude_m)
