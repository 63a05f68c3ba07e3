from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.position_report import Reason, Refused, decode
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.asterix.cat129 import TargetEncoder129
from plotfeed.proto.asterix.decode_cooperative import is_block_129
from plotfeed.proto.utc import DAY_NS, nearest_utc_ns

S = 1_000_000_000
NOW = 1_767_268_800 * S  # 2026-01-01T12:00:00Z
MIDNIGHT = NOW + 12 * 3600 * S
CAT129 = "application/x-asterix; cat=129"
ENCODER = TargetEncoder129(country="ES")


def block(t_utc_ns: int = NOW, serial: str = "a", **columns: Any) -> bytes:
    given = {"altitude_m": [700.0]} | columns
    given = {name: value for name, value in given.items() if value is not None}
    (data,) = ENCODER.blocks([serial], [t_utc_ns], [40.0], [-3.0], **given)
    return data


def refusal(payload: bytes, content_type: str | None = CAT129, now: int | None = NOW) -> Refused:
    with pytest.raises(Refused) as caught:
        decode(payload, content_type, now_utc_ns=now)
    return caught.value


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
    bare = decode(block(), CAT129, now_utc_ns=NOW)
    assert np.isnan([*bare.velocity_enu_m_s, bare.horizontal_accuracy_m]).all()


@pytest.mark.parametrize(
    "content_type", [None, "", CAT129, "application/x-asterix", "Application/X-Asterix;cat=129"]
)
def test_it_is_known_by_its_content_type_or_its_looks(content_type: str | None) -> None:
    assert decode(block(), content_type, now_utc_ns=NOW).altitude_m == pytest.approx(700.0)


def test_only_one_whole_block_looks_like_one() -> None:
    whole = block()
    assert is_block_129(whole)
    for other in (whole[:-1], whole + b"\0", b"\x30" + whole[1:], b"", b"\x81", b"\x81\x00\x03"):
        assert not is_block_129(other)


@given(
    st.integers(0, 11_059_199),  # 1/128 s of a day
    st.integers(-DAY_NS // 2 + 1, DAY_NS // 2 - 1),
)
def test_the_day_is_the_nearest(ticks: int, ahead_ns: int) -> None:
    t_utc_ns = NOW // DAY_NS * DAY_NS + ticks * (S // 128)
    assert nearest_utc_ns(ticks * (S // 128), t_utc_ns - ahead_ns) == t_utc_ns


@pytest.mark.parametrize("off_s", [-1.5, -1 / 128, 0.0, 1 / 128, 1.5])
@pytest.mark.parametrize("late_s", [-1.0, 0.0, 1.0])
def test_midnight_is_crossed_both_ways(off_s: float, late_s: float) -> None:
    t_utc_ns = MIDNIGHT + round(off_s * S)
    report = decode(block(t_utc_ns), CAT129, now_utc_ns=t_utc_ns + round(late_s * S))
    assert report.t_utc_ns == t_utc_ns


def test_a_time_of_no_day_is_refused() -> None:
    payload = bytearray(block())
    at = payload.index(bytes.fromhex("546000"))  # 43200 s in 1/128 s
    payload[at : at + 3] = (11_059_201).to_bytes(3, "big")
    assert refusal(bytes(payload)).reason is Reason.UNDECODABLE


def test_of_several_reports_the_latest_is_taken() -> None:
    blocks = [block(NOW + k * S, altitude_m=[700.0 + k]) for k in (-2, 0, -1)]
    report = decode(b"".join(blocks), CAT129, now_utc_ns=NOW)
    assert (report.t_utc_ns, report.altitude_m) == (NOW, pytest.approx(700.0))


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
    ],
    ids=lambda value: value.name if isinstance(value, Reason) else "",
)
def test_what_is_wrong_is_refused_with_its_reason(payload: bytes, reason: Reason) -> None:
    assert refusal(payload).reason is reason
    assert refusal(block(), "application/x-asterix; cat=48").reason is Reason.CONTENT_TYPE
    assert refusal(block(), now=None).reason is Reason.MISSING  # of which day nobody says


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
