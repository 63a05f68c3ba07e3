"""What systems say of themselves: categories 016, 025 and 063."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.asterix_readers import items_of, read_blocks, values_of

from plotfeed.proto.asterix.cat016 import Component, Pair, System, SystemEncoder016
from plotfeed.proto.asterix.cat025 import CAT025, CAT025_HALF_TURN, StatusEncoder025
from plotfeed.proto.asterix.cat062 import StatusEncoder063
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.asterix.codec.layout import Category
from plotfeed.proto.errors import EncodeError

MIDNIGHT_NS = 1_700_006_400 * 10**9
MAST = Component(identity=1, latitude_deg=40.45, longitude_deg=-3.73, height_m=700.0)
PAIR = Pair(identity=1, transmitter=1, receiver=1)
FIRST = np.array([0])
STATUS = StatusEncoder025(25, 3, latitude_deg=40.45, longitude_deg=-3.73, height_m=700.0)


def system(**changes: Any) -> SystemEncoder016:
    """A system of one transmitter and one receiver, but for the changes."""
    settings: dict[str, Any] = {"period_s": 10}
    parts: dict[str, Any] = {
        "sac": 25,
        "sic": 3,
        "pairs": [PAIR],
        "transmitters": [MAST],
        "receivers": [MAST],
        "reference": MAST,
    }
    of_parts = {name: value for name, value in changes.items() if name in parts}
    others = {name: value for name, value in changes.items() if name not in parts}
    return SystemEncoder016([System(**parts | of_parts)], **settings | others)


@given(st.floats(-90, 90), st.floats(-180, 180), st.floats(-8192, 8191.75))
@example(90.0, 180.0, 8191.75)
@example(-90.0, -180.0, -8192.0)
@example(0.0, 179.99999999, 0.125)
def test_stations_come_back_to_half_an_lsb(
    latitude_deg: float, longitude_deg: float, height_m: float
) -> None:
    station = replace(
        MAST, latitude_deg=latitude_deg, longitude_deg=longitude_deg, height_m=height_m
    )
    blocks = system(transmitters=[MAST, station]).blocks(MIDNIGHT_NS)
    _, components = (record for block in blocks for record in decode(block))
    back = [components.get(f"I016/410/1/{name}") for name in ("LAT", "LON", "ALT")]
    for value, given_value, half in zip(
        back, (latitude_deg, longitude_deg, height_m), (90 / 2**31, 90 / 2**31, 0.125), strict=True
    ):
        assert isinstance(value, float)
        assert abs(math.remainder(value - given_value, 360) if half < 0.1 else
                   value - given_value) <= half * (1 + 1e-6)  # fmt: skip


def test_systems_of_as_many_components_are_encoded_together() -> None:
    def of(sic: int, height_m: float) -> System:
        mast = replace(MAST, height_m=height_m)
        return System(
            sac=25, sic=sic, pairs=[PAIR], transmitters=[mast], receivers=[MAST], reference=mast
        )

    both, times = [of(3, 700.0), of(4, 900.0)], np.array([10**9, 10**9, 2 * 10**9])
    which = np.array([1, 0, 1])
    together = SystemEncoder016(both, period_s=10).blocks_by(times, which)
    assert together == [
        SystemEncoder016([both[i]], period_s=10).blocks(t)
        for i, t in zip(which.tolist(), times.tolist(), strict=True)
    ]
    with pytest.raises(EncodeError, match="different numbers"):
        SystemEncoder016([both[0], replace(both[1], pairs=[PAIR] * 2)], period_s=10)


def test_a_system_and_its_components_are_two_messages() -> None:
    composed, components = system(geoid_undulation_m=50.0).blocks(MIDNIGHT_NS - 10**9)
    (first,), (second,) = decode(composed), decode(components)
    assert (first.get("I016/000"), second.get("I016/000")) == (1, 2)
    assert first.get("I016/140") == second.get("I016/140") == 86_399.0
    assert first.get("I016/300") == [{"PID": 1, "TID": 1, "RID": 1}]
    assert first.get("I016/405") == 650.0
    assert second.get("I016/420/0/ALT") == 700.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"period_s": math.nan},
        {"pairs": [replace(PAIR, identity=65_536)]},
        {"pairs": [PAIR] * 256},
        {"transmitters": [replace(MAST, latitude_deg=90.1)]},
        {"receivers": [replace(MAST, height_m=math.nan)]},
        {"reference": replace(MAST, longitude_deg=math.inf)},
        {"transmitters": [MAST] * 70},  # more than one datagram holds
    ],
)
def test_a_system_that_cannot_be_sent_is_refused_at_once(wrong: dict[str, Any]) -> None:
    with pytest.raises(EncodeError):
        system(**wrong)


def test_status_has_what_asterix_decoder_reads_of_it() -> None:
    blocks = STATUS.blocks(np.array([MIDNIGHT_NS + 10**9]), FIRST)
    ((record,),) = read_blocks(blocks)
    assert {name: values_of(item) for name, item in items_of(record).items()} == {
        "I025/010": [25, 3],
        "I025/000": [1, 0],
        "I025/070": [1.0],
        "I025/100": [0, 0, 0, 0, 0],
        "I025/600": pytest.approx([40.45, -3.73], abs=5e-8),
        "I025/610": [700.0],
    }


def test_status_goes_round_the_globe() -> None:
    encoder = StatusEncoder025(1, 1, latitude_deg=-90.0, longitude_deg=179.0, height_m=-1e6)
    (record,) = decode(encoder.blocks(FIRST, FIRST)[0])
    assert record.get("I025/600") == {"LAT": -90.0, "LON": pytest.approx(179.0, abs=5e-8)}
    assert record.get("I025/610") == -8192.0


@pytest.mark.parametrize("edition", [CAT025, CAT025_HALF_TURN])
def test_the_north_pole_is_as_near_as_the_item_can_say(edition: Category) -> None:
    place = {"longitude_deg": 0.0, "height_m": 0.0}
    pole = StatusEncoder025(1, 1, latitude_deg=90.0, **place, category=edition)
    there = pole.blocks(FIRST, FIRST)[0].find(bytes.fromhex("7fffffff00000000"))
    assert there > 0
    with pytest.raises(EncodeError, match=r"90\.1"):
        StatusEncoder025(1, 1, latitude_deg=90.1, **place, category=edition)


@pytest.mark.parametrize("place", [(91.0, 0.0), (0.0, 181.0), (0.0, math.nan)])
def test_a_place_off_the_globe_is_refused(place: tuple[float, float]) -> None:
    with pytest.raises(EncodeError, match="I025/600"):
        StatusEncoder025(1, 1, latitude_deg=place[0], longitude_deg=place[1], height_m=0.0)


def test_each_sensor_that_tracks_says_so_itself() -> None:
    encoder = StatusEncoder063([25, 26], [3, 4])
    blocks = encoder.blocks(np.array([MIDNIGHT_NS, MIDNIGHT_NS + 10**9]), np.array([1, 0]))
    first, second = (record for block in blocks for record in decode(block))
    assert first.get("I063/050") == {"SAC": 26, "SIC": 4}
    assert (second.get("I063/010/SIC"), second.get("I063/030")) == (3, 1.0)


def test_asterix_decoder_reads_the_status_of_sensors() -> None:
    ((record,),) = read_blocks(StatusEncoder063(25, 3).blocks(np.array([10**9]), FIRST))
    assert {name: values_of(item) for name, item in items_of(record).items()} == {
        "I063/010": [25, 3],
        "I063/030": [1.0],
        "I063/050": [25, 3],
        "I063/060": [0, 0, 0, 0, 0, 0],
    }
