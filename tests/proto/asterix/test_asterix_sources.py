"""Records of several sources in one go are those that each source has by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.asterix_input import every_path, text_constants

from plotfeed.proto.asterix.cat048 import CAT048, ServiceEncoder034
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.encode import Encoder, Parts, Reports, profile
from plotfeed.proto.asterix.codec.layout import Category, Raw
from plotfeed.proto.errors import EncodeError

RECORDS = st.sampled_from([1, 2, 7, 80])


@given(st.sampled_from(list(CATEGORIES.values())), RECORDS, st.data())
def test_any_part_may_be_constant_for_each_source(
    category: Category, n: int, data: st.DataObject
) -> None:
    paths, texts = every_path(category), text_constants(category)
    columns = Encoder(category, paths, constants=texts).columns
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    count = data.draw(st.integers(1, 4))
    stamped = [path for path in columns if rng.random() < 0.5]
    whole = {slot.path for slot in profile(category, paths).slots if isinstance(slot.part, Raw)}

    def drawn(path: str, rows: int) -> NDArray[Any]:
        return rng.integers(0, 2, rows) if path in whole else rng.random(rows) * 0.9

    constants = {path: drawn(path, count).tolist() for path in stamped}
    values = {path: drawn(path, n) for path in columns if path not in stamped}
    sources = rng.integers(0, count, n)
    together = Encoder(category, paths, constants=texts | constants).records(values, sources)
    each = [
        Encoder(category, paths, constants=texts | {p: c[i] for p, c in constants.items()})
        for i in range(count)
    ]
    apart = [
        each[source].records({path: column[row : row + 1] for path, column in values.items()})
        for row, source in enumerate(sources.tolist())
    ]
    assert together == b"".join(apart)


def of_two(**more: Any) -> Encoder:
    constants = {"I048/010/SAC": 25, "I048/010/SIC": [3, 4]}
    return Encoder(CAT048, ("I048/010", "I048/140"), constants=constants | more)


def test_it_must_be_said_which_source_it_is() -> None:
    with pytest.raises(EncodeError, match="which of 2 sources"):
        of_two().records({"I048/140": [1.0]})
    with pytest.raises(EncodeError, match="different lengths"):
        of_two().records({"I048/140": [1.0]}, np.array([0, 1]))
    with pytest.raises(EncodeError, match="SAC: 256 is not within"):
        of_two(**{"I048/010/SAC": [1, 256]})
    with pytest.raises(EncodeError, match=r"constants of \[2, 3\] sources"):
        of_two(**{"I048/010/SAC": [1, 2, 3]})


def test_one_number_may_be_for_the_records_of_all_sources() -> None:
    records = of_two().records({"I048/140": 1.0}, np.array([1, 0, 1]))
    assert [records[i + 2] for i in (0, 6, 12)] == [4, 3, 4]


@given(
    st.lists(st.tuples(st.integers(0, 60), st.integers(0, 2)), min_size=1, max_size=9),
    st.lists(st.sampled_from([64, 200, 1400]), min_size=3, max_size=3),
)
def test_blocks_of_parts_are_those_of_each_by_itself(
    drawn: list[tuple[int, int]], most: list[int]
) -> None:
    lengths, sources = np.array(drawn).T
    by = np.concatenate([[0], np.cumsum(lengths)])
    times, sics = np.arange(by[-1]) / 128, [7, 8, 9]

    def reports(sic: Any, max_octets: Any) -> Reports:
        constants = {"I048/010/SAC": 1, "I048/010/SIC": sic}
        paths = ("I048/010", "I048/140")
        return Reports(CAT048, paths, constants=constants, max_octets=max_octets)

    together = reports(sics, most).blocks_by({"I048/140": times}, Parts(by, sources))
    alone = [
        reports(sics[source], most[source]).blocks_by(
            {"I048/140": times[by[i] : by[i + 1]]}, Parts.whole(int(lengths[i]))
        )[0]
        for i, source in enumerate(sources.tolist())
    ]
    assert together == [blocks if n else [] for blocks, n in zip(alone, lengths, strict=True)]


def test_limits_of_octets_hold_for_every_source() -> None:
    with pytest.raises(EncodeError, match="max_octets"):
        Reports(CAT048, ("I048/010",), constants={"I048/010/SIC": [1, 2]}, max_octets=[1400, 5])


PLACES = [(40.45, -3.73, 650.0), (-34.5, -58.25, -12.0)]


def test_service_messages_of_several_radars() -> None:
    encoder = ServiceEncoder034([25, 26], [3, 4], antenna_period_s=[1.0, 4.0], place=PLACES)
    alone = [
        ServiceEncoder034(25, 3, antenna_period_s=1, place=PLACES[0]),
        ServiceEncoder034(26, 4, antenna_period_s=4, place=PLACES[1]),
    ]
    times, azimuths, which = (
        [5 * 10**9, 6 * 10**9, 7 * 10**9],
        [0.0, 90.0, 11.25],
        np.array([1, 0, 1]),
    )
    assert encoder.north_markers([], which[:0]) == []
    assert encoder.north_markers(times, which) == [
        alone[i].north_markers([t], np.array([0]))[0] for i, t in zip(which, times, strict=True)
    ]
    assert encoder.sector_crossings(times, azimuths, which) == [
        alone[i].sector_crossings([t], [azimuth], np.array([0]))[0]
        for i, t, azimuth in zip(which, times, azimuths, strict=True)
    ]
