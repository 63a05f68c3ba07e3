from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.asterix_input import tracks
from support.asterix_readers import items_of, read_blocks, values_of

from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.units import FOOT_M

ENCODER = TrackEncoder062(25, 3)
ESTIMATED = {
    "height_m": 100.0,
    "climb_m_s": 1.0,
    "age_s": 0.5,
    "sigma_east_m": 1.0,
    "sigma_north_m": 2.0,
}


def one(**columns: Any) -> Record:
    """One track there and back."""
    (block,) = ENCODER.blocks(tracks(**columns))
    (record,) = decode(block)
    return record


def test_what_is_not_estimated_is_not_sent() -> None:
    always = {"010", "070", "105", "100", "185", "040", "080"}
    assert {name[5:] for name in one(track=1).items} == always
    everything = {name[5:] for name in one(track=1, **ESTIMATED).items}
    assert everything == always | {"130", "220", "290", "500"}


@pytest.mark.parametrize("name", ESTIMATED)
def test_what_is_estimated_now_and_then_is_refused(name: str) -> None:
    with pytest.raises(EncodeError):
        ENCODER.blocks(tracks(**ESTIMATED | {name: [1.0, math.nan]}))


def test_one_deviation_without_the_other_is_refused() -> None:
    with pytest.raises(EncodeError, match="I062/500/APC/Y: a column is missing"):
        ENCODER.blocks(tracks(sigma_east_m=1.0))


@pytest.mark.parametrize(
    "wrong",
    [
        {"latitude_deg": 91.0},
        {"longitude_deg": math.nan},
        {"track": 65_536},
        {"east_m": math.nan},
        {"velocity_north_m_s": math.inf},
    ],
)
def test_what_cannot_be_sent_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(EncodeError):
        ENCODER.blocks(tracks(**wrong))


def test_no_tracks_make_no_blocks() -> None:
    assert ENCODER.blocks(tracks(track=np.empty(0, np.int64))) == []


@given(
    st.floats(-90, 90), st.floats(-180, 180), st.floats(-5e6, 5e6), st.floats(-1e4, 1e4),
    st.floats(-1e5, 1e5),
)  # fmt: skip
@example(90.0, 180.0, 4_194_303.5, 8191.75, 62_421.0)
@example(-90.0, -180.0, -4_194_304.0, -8192.0, -62_423.0)
def test_tracks_come_back_to_half_an_lsb_or_saturate(
    latitude_deg: float, longitude_deg: float, east_m: float, velocity: float, height_m: float
) -> None:
    record = one(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        east_m=east_m,
        velocity_north_m_s=velocity,
        height_m=height_m,
    )
    feet = height_m / FOOT_M
    for path, value, lsb, bits in (
        ("I062/105/LAT", latitude_deg, 180 / 2**25, 32),
        ("I062/105/LON", longitude_deg, 180 / 2**25, 32),
        ("I062/100/X", east_m, 0.5, 24),
        ("I062/185/VY", velocity, 0.25, 16),
        ("I062/130", feet, 6.25, 16),
    ):
        back = record.get(path)
        assert isinstance(back, float)
        least, most = -(2 ** (bits - 1)) * lsb, (2 ** (bits - 1) - 1) * lsb
        assert abs(back - min(max(value, least), most)) <= lsb / 2 * (1 + 1e-9)


def test_asterix_decoder_reads_tracks() -> None:
    given_tracks = tracks(
        track=[4711, 4712], t_utc_ns=10**9, latitude_deg=40.0, longitude_deg=-3.0, **ESTIMATED
    )
    (records,) = read_blocks(ENCODER.blocks(given_tracks))
    read = [{n: values_of(item) for n, item in items_of(r).items()} for r in records]
    assert [items["I062/040"] for items in read] == [[4711], [4712]]
    assert read[0] == {
        "I062/010": [25, 3],
        "I062/070": [1.0],
        "I062/105": pytest.approx([40.0, -3.0], abs=3e-6),
        "I062/100": [0.0, 0.0],
        "I062/185": [0.0, 0.0],
        "I062/040": [4711],
        "I062/080": [1, 0, 1, 2, 0, 1, *[0] * 18],
        "I062/130": pytest.approx([100 / FOOT_M], abs=3.2),
        "I062/220": pytest.approx([60 / FOOT_M], abs=3.2),
        "I062/290": [0.5],
        "I062/500": [1.5, 2.5],
    }
