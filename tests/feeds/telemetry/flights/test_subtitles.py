"""DJI's subtitles in each of their dialects: places, heights and times, and what must be asked."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from support.given_flights import flown, places

from plotfeed.feeds.telemetry.flights import read
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

S = 1_000_000_000
START = round(datetime(2022, 6, 21, 16, 6, 17, tzinfo=UTC).timestamp()) * S
ABOVE, SEA, GLOBE = (
    AltitudeReference.ABOVE_TAKEOFF,
    AltitudeReference.MEAN_SEA_LEVEL,
    AltitudeReference.ELLIPSOID,
)


def subtitles(*lines: str, dated: bool = True) -> str:
    blocks = []
    for i, line in enumerate(lines):
        date = f"2022.06.21 16:06:{17 + i:02d}\n" if dated else ""
        blocks.append(f"{i + 1}\n00:00:{i:02d},000 --> 00:00:{i + 1:02d},000\n{date}{line}\n")
    return "\n".join(blocks)


DIALECTS = {
    "Matrice 300": "GPS(36.61{i:02d},-6.1120,0.0M) BAROMETER:{i}.5M",
    "Mavic Pro": "HOME(-6.1120,36.6100) GPS(-6.1120,36.61{i:02d},16) BAROMETER:{i}.5",
    "Mavic Mini": "F/2.8, SS 206, ISO 150, EV 0, GPS (-6.1120, 36.61{i:02d}, 15), D 2.36m, "
    "H {i}.50m, H.S 0.0m/s",
    "brackets": "[iso: 100] [latitude: 36.61{i:02d}] [longitude: -6.1120] "
    "[rel_alt: {i}.5 abs_alt: {i}.0]",
}
FILMS = {name: [line.format(i=i) for i in range(3)] for name, line in DIALECTS.items()}
MATRICE = subtitles(*FILMS["Matrice 300"])


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("dated", [True, False])
def test_every_dialect_gives_the_same_flight(dialect: str, dated: bool) -> None:
    text = subtitles(*FILMS[dialect], dated=dated)
    if not dated:
        with pytest.raises(PlotfeedError, match="start_utc_ns"):
            flown(".srt", text)
    flight = flown(".srt", text, start_utc_ns=None if dated else START)
    assert places(flight) == [pytest.approx((36.61 + i / 1e4, -6.112, i + 0.5)) for i in range(3)]
    assert [r.t_utc_ns for r in flight.reports] == [START + i * S for i in range(3)]
    assert flight.reports[0].altitude_reference is ABOVE
    assert flight.skipped == ()


@pytest.mark.parametrize(
    ("line", "options", "expected"),
    [
        (
            "[latitude : 1.5] [longtitude : -2.5] [rel_alt: 3.0 abs_alt: 9.0]",  # as some have it
            {},
            (1.5, -2.5, 3.0, ABOVE),
        ),
        (FILMS["brackets"][1], {"altitude_reference": SEA}, (36.6101, -6.112, 1.0, SEA)),
        (
            "[latitude: 1.5] [longitude: 2.5] [altitude: 117.0]",
            {"altitude_reference": GLOBE},
            (1.5, 2.5, 117.0, GLOBE),
        ),
        # A value beyond 90 tells the order, whatever the dialect.
        ("GPS(149.02,-20.25,0.0M) BAROMETER:1.0M", {}, (-20.25, 149.02, 1.0, ABOVE)),
        ("GPS(-20.25,149.02,5) BAROMETER:1.0", {}, (-20.25, 149.02, 1.0, ABOVE)),
        ("GPS(36.6,-6.1,16) BAROMETER:1.0", {"gps_order": "lat-lon"}, (36.6, -6.1, 1.0, ABOVE)),
        ("GPS(36.6,-6.1,16) BAROMETER:1.0", {"gps_order": "lon-lat"}, (-6.1, 36.6, 1.0, ABOVE)),
        (FILMS["Matrice 300"][0], {"gps_order": "lon-lat"}, (-6.112, 36.61, 0.5, ABOVE)),
    ],
)
def test_places_and_heights_are_what_the_file_says_or_else_the_user(
    line: str, options: dict[str, Any], expected: tuple[Any, ...]
) -> None:
    flight = flown(".srt", subtitles(line), **options)
    assert (*places(flight)[0], flight.reports[0].altitude_reference) == expected


@pytest.mark.parametrize(
    ("line", "asks"),
    [
        ("[latitude: 1.5] [longitude: 2.5] [altitude: 117.0]", "--set altitude_reference"),
        ("GPS(36.6,-6.1,16) BAROMETER:1.0", "--set gps_order"),
        ("GPS(-6.1120,36.61,16) HOME(-6.1,36.6) Hx:1.0", "no heights: expected BAROMETER, Hb"),
        ("Good evening.", "no positions"),
    ],
)
def test_what_nobody_says_is_asked_for(line: str, asks: str) -> None:
    with pytest.raises(PlotfeedError, match=asks):
        flown(".srt", subtitles(line))


def test_local_time_is_shifted_by_its_offset() -> None:
    flight = flown(".srt", MATRICE, utc_offset_h=2.0)
    assert flight.reports[0].t_utc_ns == START - 7200 * S
    assert any("+2 h" in line for line in flight.assumed)


def test_fractions_of_a_second_are_read_in_both_spellings() -> None:
    tail = "[latitude: 1.5] [longitude: 2.5] [rel_alt: 3.0 abs_alt: 9.0]\n\n"
    text = "".join(
        f"{i}\n00:00:00,000 --> 00:00:00,033\n<font>FrameCnt: 1\n2022-06-21 16:06:{when}\n{tail}"
        for i, when in enumerate(["17,774,808", "18.858"])
    )
    t = [r.t_utc_ns - START for r in flown(".srt", text).reports]
    assert t == [774_808_000, 1_858_000_000]


def test_records_that_cannot_be_read_are_told_by_line() -> None:
    first, _, last = FILMS["Matrice 300"]
    lines = [first, "GPS(n/a) BAROMETER:1.0M", "GPS(0.0,0.0,0.0M) BAROMETER:1.0M", last]
    lines.append("GPS(36.6104,-6.1120,0.0M)")
    flight = flown(".srt", subtitles(*lines))
    assert len(flight.reports) == 2
    assert [line.partition(":")[0] for line in flight.skipped] == ["line 7", "line 12", "line 22"]
    assert flight.skipped[-1].endswith("no BAROMETER, which other blocks have")


def test_a_byte_order_mark_and_an_odd_suffix_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(b"\xef\xbb\xbf" + MATRICE.replace("\n", "\r\n").encode())
    assert len(read(path).reports) == 3
