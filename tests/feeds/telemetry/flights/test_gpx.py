from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.flights import read, read_gpx
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, Log
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

HEAD = (
    '<?xml version="1.0"?><gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1">'
)
POINTS = [
    f'<trkpt lat="50.0" lon="{3 + i / 1e5}"><ele>{100 + i}</ele>'
    f"<time>2022-05-01T00:00:0{i}Z</time></trkpt>"
    for i in range(4)
]


def gpx(points: list[str]) -> str:
    return f"{HEAD}<trk><trkseg>{''.join(points)}</trkseg></trk></gpx>"


def flown(text: str, **options: object) -> Flight:
    log = Log()
    read_gpx(text, FlightOptions(**options), log)  # type: ignore[arg-type]
    return log.flight("a")


def test_track_points_are_taken_above_sea_level_unless_told() -> None:
    flight = flown(gpx(POINTS))
    assert [r.altitude_m for r in flight.reports] == [100.0, 101.0, 102.0, 103.0]
    assert flight.reports[0].t_utc_ns == 1_651_363_200_000_000_000
    assert flight.reports[0].altitude_reference is AltitudeReference.MEAN_SEA_LEVEL
    assert any("mean sea level" in line for line in flight.assumed)
    told = flown(gpx(POINTS), altitude_reference=AltitudeReference.ELLIPSOID)
    assert told.reports[0].altitude_reference is AltitudeReference.ELLIPSOID
    assert told.assumed == ()


def test_points_without_time_or_elevation_are_told() -> None:
    bare = '<trkpt lat="50" lon="3"></trkpt>'
    no_elevation = '<trkpt lat="50" lon="3"><time>2022-05-01T00:00:09Z</time></trkpt>'
    flight = flown(gpx([*POINTS, bare, no_elevation]))
    assert len(flight.reports) == 4
    assert flight.skipped == ("track point 5: no time", "track point 6: no elevation")


def test_a_file_cut_short_gives_its_whole_points() -> None:
    text = gpx(POINTS)
    flight = flown(text[: text.index(POINTS[2]) + 30])
    assert len(flight.reports) == 2
    assert "cut short" in flight.skipped[0]


def test_entities_are_not_expanded() -> None:
    bomb = '<!DOCTYPE g [<!ENTITY a "aaaa">]>'
    with pytest.raises(PlotfeedError, match="document type"):
        flown(gpx(POINTS).replace("<gpx", bomb + "<gpx"))


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be", "utf-7", "cp037"]
)
def test_no_encoding_hides_a_document_type(tmp_path: Path, encoding: str) -> None:
    levels = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))
    bomb = f'<!DOCTYPE g [<!ENTITY e0 "1234567890">{levels}]>'
    text = gpx(POINTS).replace("<gpx", bomb + "<gpx").replace("<ele>", "<name>&e9;</name><ele>")
    text = re.sub("<[?]xml.*?[?]>", "", text)
    path = tmp_path / "a.gpx"
    path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>{text}'.encode(encoding))
    with pytest.raises(PlotfeedError) as refused:
        read(path, FlightOptions())
    assert len(str(refused.value)) < 500


@given(st.data())
def test_a_file_damaged_anywhere_gives_a_flight_or_a_clear_error(data: st.DataObject) -> None:
    text = gpx(POINTS)
    at = data.draw(st.integers(0, len(text)))
    text = (
        text[:at] + data.draw(st.text(max_size=5)) + text[data.draw(st.integers(at, len(text))) :]
    )
    with suppress(PlotfeedError):
        assert flown(text).reports
