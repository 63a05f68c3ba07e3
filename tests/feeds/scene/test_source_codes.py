from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.scene.changes import changed
from plotfeed.feeds.scene.scene import SceneError, numbered, with_track_numbers
from plotfeed.models.tracks import MAX_TRACKS
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.testing import fly, held, radar, rotating, scene

CODES = st.none() | st.integers(0, 3)


def sensors(*stated: dict[str, Any]) -> list[dict[str, Any]]:
    return [radar(id=f"r{i}", **keys) for i, keys in enumerate(stated)]


def codes(*stated: dict[str, Any]) -> list[tuple[int, int]]:
    return [(s.sac, s.sic) for s in scene(sensors(*stated), seed=1).sensor]


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
    found = [(s.get("sac", 0), s["sic"]) for s in numbered([{}] * 600)]
    assert len(set(found)) == 600
    assert found[:255] == [(0, n) for n in range(1, 256)]
    assert found[255] == (1, 1)
    assert found[-1] == (2, 90)


def test_an_area_that_is_stated_and_full_is_refused() -> None:
    kept = numbered([{"sac": 5, "id": i} for i in range(256)])
    assert "sic" not in kept[-1]
    many = sensors(*({"sac": 5} for _ in range(256)))
    with pytest.raises(SceneError, match="'r0' and 'r255' both have sac 5 and sic 1"):
        scene(many, seed=1)


@given(st.lists(st.tuples(CODES, CODES), max_size=12))
def test_no_number_is_given_that_somebody_has(stated: list[tuple[int | None, int | None]]) -> None:
    tables = [
        {key: value for key, value in zip(("sac", "sic"), pair, strict=True) if value is not None}
        for pair in stated
    ]
    found = numbered(tables)
    assert numbered(found) == found
    given_to = [
        (new.get("sac", 0), new["sic"])
        for old, new in zip(tables, found, strict=True)
        if "sic" not in old
    ]
    kept = [(t.get("sac", 0), t["sic"]) for t in tables if "sic" in t]
    assert len(set(given_to)) == len(given_to)
    assert not set(given_to) & set(kept)
    assert all({**new, **old} == new for old, new in zip(tables, found, strict=True))


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


def test_a_sensor_keeps_its_number_when_it_is_changed() -> None:
    second = scene(sensors({}, {}), seed=1).sensor[1]
    assert changed(second, {"pfa": 1e-5}).sic == second.sic == 2


def test_who_reports_tracks_in_a_format_of_no_source_has_a_share_of_their_numbers() -> None:
    both = sensors({"report": ["tracks"]}, {"report": ["plots"]}, {"report": ["tracks"]})
    half = MAX_TRACKS // 2
    found = [table.get("tracks") for table in with_track_numbers(both)]
    assert found == [{"numbers": (1, half)}, None, {"numbers": (half + 1, 2 * half)}]
    stated = with_track_numbers([both[0] | {"tracks": {"numbers": (5, 6)}}, both[2]])
    assert [table["tracks"]["numbers"] for table in stated] == [(5, 6), (half + 1, 2 * half)]
    assert with_track_numbers(both[:2]) == both[:2]


def test_their_records_bear_their_numbers() -> None:
    both = [
        radar(id="one", scan=rotating()),
        radar(id="two"),
        radar(id="three", report=["asterix-062"]),
    ]
    flown = fly(scene(both, [held("d", 30.0, 5.0, 2000.0)], seed=4), 11.0)
    topics = {"one": (34, 48), "two": (48,), "three": (62, 63)}
    for number, (sensor, categories) in enumerate(topics.items(), 1):
        for category in categories:
            records = [
                r for p in flown.payloads(f"{sensor}/asterix/{category:03d}") for r in decode(p)
            ]
            assert records
            assert {r.get(f"I{category:03d}/010/SIC") for r in records} == {number}
