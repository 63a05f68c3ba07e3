from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.asterix_input import plots
from support.asterix_readers import items_of, read_blocks, values_of

from plotfeed.proto.asterix.cat205 import BearingEncoder205
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.errors import EncodeError

SITE = {"latitude_deg": 40.45, "longitude_deg": -3.73}
ENCODER = BearingEncoder205(25, 3, **SITE)


def one(encoder: BearingEncoder205 = ENCODER, **columns: Any) -> Record:
    """One bearing there and back."""
    (block,) = encoder.blocks(plots(**columns), 0)
    (record,) = decode(block)
    return record


def test_each_bearing_has_a_block_of_its_own_and_a_number() -> None:
    blocks = ENCODER.blocks(plots(azimuth_deg=np.arange(300.0)), 0, 250)
    records = [record for block in blocks for record in decode(block)]
    assert len(blocks) == len(records) == 300
    assert [r.get("I205/040") for r in records] == [(250 + row) % 256 for row in range(300)]
    np.testing.assert_allclose([r.get("I205/070") for r in records], np.arange(300.0))


@given(st.floats(-720, 720))
@example(359.996)
@example(360.0)
@example(655.36)
def test_bearings_come_back_round_the_circle(azimuth_deg: float) -> None:
    back = one(azimuth_deg=azimuth_deg).get("I205/070")
    assert isinstance(back, float)
    assert 0 <= back < 360
    assert abs(math.remainder(back - azimuth_deg, 360)) <= 0.005 + 1e-9


def test_the_time_is_that_of_sending() -> None:
    (block,) = ENCODER.blocks(plots(t_utc_ns=5_000_000_000), 7_000_000_000)
    assert decode(block)[0].get("I205/030") == 7.0


@pytest.mark.parametrize("name", ["azimuth_deg", "amplitude_dbm", "snr", "elevation_deg"])
def test_what_is_measured_now_and_then_is_refused(name: str) -> None:
    for rows in ([1.0, math.nan], [math.nan, 1.0]):
        with pytest.raises(EncodeError):
            ENCODER.blocks(plots(**{name: rows}), 0)


@pytest.mark.parametrize("position", [(90.1, 0.0), (0.0, -180.1), (math.nan, 0.0), (0, math.inf)])
def test_a_place_off_the_globe_is_refused(position: tuple[float, float]) -> None:
    with pytest.raises(EncodeError, match="I205/050"):
        BearingEncoder205(1, 1, latitude_deg=position[0], longitude_deg=position[1])


def test_no_plots_make_no_blocks() -> None:
    assert ENCODER.blocks(plots(azimuth_deg=np.empty(0)), 0) == []


def test_asterix_decoder_reads_bearings() -> None:
    blocks = ENCODER.blocks(
        plots(azimuth_deg=[123.456], amplitude_dbm=-80.0, snr=1e4, elevation_deg=-1.25), 10**9
    )
    ((record,),) = read_blocks(blocks)
    read = {name: values_of(item) for name, item in items_of(record).items()}
    assert read == {
        "I205/010": [25, 3],
        "I205/000": [5],
        "I205/030": [1.0],
        "I205/040": [0],
        "I205/050": pytest.approx([40.45, -3.73], abs=3e-6),
        "I205/070": pytest.approx([123.46]),
        "I205/180": pytest.approx([26.99]),
        "I205/190": [255],
        "I205/200": pytest.approx([-1.25]),
    }
