from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.scene.scene import SceneError, numbered
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.models.tracks import MAX_TRACKS
from plotfeed.testing import fly, held, radar, rotating, scene

CODES = st.none() | st.integers(0, 3)


def sensors(*stated: dict[str, Any]) -> list[dict[str, Any]]:
    return [radar(id=f"r{i}", **keys) for i, keys in enumerate(stated)]


def codes_of(found: Iterable[Any]) -> list[tuple[int, int]]:
    return [(s.sac, s.sic) for s in found]


def codes(*stated: dict[str, Any]) -> list[tuple[int, int]]:
    """In a scene of sensors that say no more than that."""
    return codes_of(scene(sensors(*stated), seed=1).sensor)


def tables(*stated: dict[str, Any]) -> list[Sensor]:
    """The same before a scene numbers them."""
    one = sensor_of(radar())
    return [one.model_copy(update={"id": f"r{i}", **keys}) for i, keys in enumerate(stated)]


@pytest.mark.parametrize(
    ("stated", "numbered"),
    [
        ([{}, {}, {}], [(0, 1), (0, 2), (0, 3)]),
        # What is stated anywhere is left to who states it, and areas are numbered by themselves.
        ([{}, {"sic": 1}, {}, {"sic": 3}], [(0, 2), (0, 1), (0, 4), (0, 3)]),
        (
            [{"sac": 7}, {}, {"sac": 7}, {"sac": 7, "sic": 2}, {"sic": 2}],
            [(7, 1), (0, 1), (7, 3), (7, 2), (0, 2)],
        ),
    ],
)
def test_sensors_without_a_sic_are_numbered_in_their_order(
    stated: list[dict[str, Any]], numbered: list[tuple[int, int]]
) -> None:
    assert codes(*stated) == numbered


def test_who_finds_no_room_in_an_area_goes_to_the_next() -> None:
    found = codes_of(numbered(tables(*[{}] * 600)))
    assert len(set(found)) == 600
    assert found[:255] == [(0, n) for n in range(1, 256)]
    assert found[255] == (1, 1)
    assert found[-1] == (2, 90)


def test_an_area_that_is_stated_and_full_is_refused() -> None:
    full = [{"sac": 5}] * 256
    assert "sic" not in numbered(tables(*full))[-1].model_fields_set
    with pytest.raises(SceneError, match="'r0' and 'r255' both have sac 5 and sic 1"):
        scene(sensors(*full), seed=1)


@given(st.lists(st.tuples(CODES, CODES), max_size=12))
def test_no_number_is_given_that_somebody_has(stated: list[tuple[int | None, int | None]]) -> None:
    keys = [
        {key: value for key, value in zip(("sac", "sic"), pair, strict=True) if value is not None}
        for pair in stated
    ]
    found = numbered(tables(*keys))
    assert numbered(found) == found
    given_to = codes_of(s for s, old in zip(found, keys, strict=True) if "sic" not in old)
    kept = {(old.get("sac", 0), old["sic"]) for old in keys if "sic" in old}
    assert len(set(given_to)) == len(given_to)
    assert not set(given_to) & kept
    for new, old in zip(found, keys, strict=True):
        assert {key: getattr(new, key) for key in old} == old


@pytest.mark.parametrize("nonsense", [{"sic": "x"}, {"sac": "x"}, {"sic": 300}, {"sac": -1}])
def test_nonsense_is_refused_as_before(nonsense: dict[str, Any]) -> None:
    with pytest.raises(SceneError, match=r"sensor\[0\]"):
        codes(nonsense, {})


def test_equal_codes_are_refused_where_asterix_is_reported() -> None:
    both = {"sac": 25, "sic": 3}
    with pytest.raises(SceneError, match="'r0' and 'r2' both have sac 25 and sic 3"):
        codes(both, {}, both)
    silent = [both | {"report": ["plots"]}, both, both | {"report": ["plots", "sapient"]}]
    assert codes(*silent) == [(25, 3)] * 3


def test_who_reports_tracks_in_a_format_of_no_source_has_a_share_of_their_numbers() -> None:
    half, usual = MAX_TRACKS // 2, (1, MAX_TRACKS)
    both = sensors({"report": ["tracks"]}, {"report": ["plots"]}, {"report": ["tracks"]})
    for some, numbers in (
        (both, [(1, half), usual, (half + 1, 2 * half)]),
        ([both[0] | {"tracks": {"numbers": [5, 6]}}, both[2]], [(5, 6), (half + 1, 2 * half)]),
        (both[:2], [usual, usual]),
    ):
        found: list[Any] = list(scene(some, seed=1).sensor)
        assert [sensor.tracks.numbers for sensor in found] == numbers


def test_their_records_bear_their_numbers() -> None:
    both = radar(id="one", scan=rotating()), radar(id="two", report=["asterix-062"])
    flown = fly(scene(both, [held("d", 30.0, 5.0, 2000.0)], seed=4), 11.0)
    for number, sensor, category in (
        (1, "one", 34),
        (1, "one", 48),
        (2, "two", 62),
        (2, "two", 63),
    ):
        records = flown.records(sensor, category)
        assert {r.get(f"I{category:03d}/010/SIC") for r in records} == {number}
