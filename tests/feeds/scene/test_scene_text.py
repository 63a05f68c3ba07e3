"""A scene's text with a key less or more: of the sensors that are meant, and no line else."""

from __future__ import annotations

import tomllib

import pytest

from plotfeed.feeds.scene.scene_text import inline, with_key, with_table, without

TEXT = """\
[terrain]
elevation = ["a.hgt"]

[[sensor]]
id = "one"
link = { latency_ms = 5.0 }
drift = {
    sigma_azimuth_deg = 0.1,
}
power_w = 1.0

[[sensor]]
id = "two"
link = { latency_ms = 7.0 }

[sensor.drift]
sigma_azimuth_deg = 0.2
""".splitlines()
GOES = "# it goes"


@pytest.mark.parametrize(
    ("key", "owners", "gone"),
    [
        ("link", {0}, [5]),
        ("link", {1}, [13]),
        ("link", {0, 1}, [5, 13]),
        ("drift", {0}, [6, 7, 8]),
        ("drift", {1}, [15, 16]),
        ("terrain", None, [0, 1]),
        ("jamming", {0, 1}, []),
    ],
)
def test_what_goes_is_a_comment_below_why(
    key: str, owners: set[int] | None, gone: list[int]
) -> None:
    found = without(TEXT, key, owners, GOES)
    assert [line.removeprefix("# ") for line in found if line != GOES] == TEXT
    left = [line for line in found if line != GOES]
    assert [i for i, line in enumerate(left) if line.startswith("# ")] == gone
    begins = [i for i in gone if i - 1 not in gone]
    assert found.count(GOES) == len(begins)
    assert all(found[i + n] == GOES for n, i in enumerate(begins))


def test_what_comes_is_of_the_sensors_that_are_named() -> None:
    plain = [line for line in TEXT if "{" not in line and "}" not in line and "sigma" not in line]
    keys = {1: {"rain_mm_h": 5.0, "wind_m_s": None, "odd key": [1, True, "a"]}}
    tree = tomllib.loads("\n".join(with_key(plain, "weather", keys, GOES)))
    assert ["weather" in sensor for sensor in tree["sensor"]] == [False, True]
    assert tree["sensor"][1]["weather"] == {"rain_mm_h": 5.0, "odd key": [1, True, "a"]}
    more = with_table(TEXT[:2], "[[birds]]", {"id": "gulls", "count": 3}, GOES)
    assert tomllib.loads("\n".join(more))["birds"] == [{"id": "gulls", "count": 3}]
    assert more[3:5] == [GOES, "[[birds]]"]
    assert inline({"a": float("inf")}) == "{ a = inf }"
