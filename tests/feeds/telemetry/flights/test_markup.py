"""GPX and KML: points with time and height, and what such files may not do to their reader."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from golden.make_flights import geodetic
from support.given_files import GOLDEN
from support.given_flights import flown

from plotfeed.feeds.telemetry.flights import read
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


def gpx(*points: str) -> str:
    return f"{HEAD}<trk><trkseg>{''.join(points)}</trkseg></trk></gpx>"


def test_track_points_are_taken_above_sea_level_unless_told() -> None:
    flight = flown(".gpx", gpx(*POINTS))
    assert [r.altitude_m for r in flight.reports] == [100.0, 101.0, 102.0, 103.0]
    assert flight.reports[0].t_utc_ns == 1_651_363_200_000_000_000
    assert flight.reports[0].altitude_reference is AltitudeReference.MEAN_SEA_LEVEL
    assert any("mean sea level" in line for line in flight.assumed)
    told = flown(".gpx", gpx(*POINTS), altitude_reference=AltitudeReference.ELLIPSOID)
    assert told.reports[0].altitude_reference is AltitudeReference.ELLIPSOID
    assert told.assumed == ()


def test_points_that_are_not_whole_are_told() -> None:
    bare = '<trkpt lat="50" lon="3"></trkpt>'
    no_elevation = '<trkpt lat="50" lon="3"><time>2022-05-01T00:00:09Z</time></trkpt>'
    noon = POINTS[0].replace("2022-05-01T00:00:00Z", "noon")
    flight = flown(".gpx", gpx(*POINTS, bare, no_elevation, noon))
    assert len(flight.reports) == 4
    assert flight.skipped == (
        "track point 5: no time",
        "track point 6: no elevation",
        "track point 7: no time, position or elevation that can be read",
    )
    text = gpx(*POINTS)
    flight = flown(".gpx", text[: text.index(POINTS[2]) + 30])
    assert len(flight.reports) == 2
    assert "cut short" in flight.skipped[0]


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be", "utf-7", "cp037"]
)
def test_no_encoding_hides_a_document_type(tmp_path: Path, encoding: str) -> None:
    levels = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))
    bomb = f'<!DOCTYPE g [<!ENTITY e0 "1234567890">{levels}]>'
    text = gpx(*POINTS).replace("<gpx", bomb + "<gpx").replace("<ele>", "<name>&e9;</name><ele>")
    text = re.sub("<[?]xml.*?[?]>", "", text)
    path = tmp_path / "a.gpx"
    path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>{text}'.encode(encoding))
    with pytest.raises(PlotfeedError) as refused:
        read(path)
    assert len(str(refused.value)) < 500
    assert encoding != "utf-8" or "document type" in str(refused.value)


def test_a_track_of_kml_without_heights_says_so() -> None:
    text = (GOLDEN / "flights" / "part.kml").read_text()
    flat = text.replace("<altitudeMode>absolute</altitudeMode>", "")
    assert flat != text
    with pytest.raises(PlotfeedError, match="no height: altitudeMode is clampToGround"):
        flown(".kml", flat)
    assert {r.altitude_m for r in flown(".kml", flat, height_m=80.0).reports} == {80.0}
    relative = flown(".kml", text.replace("absolute", "relativeToGround"))
    assert relative.reports[0].altitude_reference is AltitudeReference.ABOVE_TAKEOFF
    assert any("above the ground are taken" in line for line in relative.assumed)
    told = flown(".kml", text, altitude_reference=AltitudeReference.ELLIPSOID)
    assert told.reports[0].altitude_reference is AltitudeReference.ELLIPSOID
    with pytest.raises(PlotfeedError, match="a LineString says where and not when"):
        flown(".kml", "<kml><Placemark><LineString/></Placemark></kml>")


def test_placemarks_and_uneven_tracks_of_kml_are_read() -> None:
    mark = (
        "<Placemark><TimeStamp><when>2024-05-14T09:30:20Z</when></TimeStamp><Point><altitudeMode>"
        "absolute</altitudeMode><coordinates>{1:.7f},{0:.7f},9</coordinates></Point></Placemark>"
    ).format(*geodetic(20.0))
    uneven = "<Track><when>x</when><when>y</when><coord>1 2 3</coord></Track>"
    flight = flown(".kml", f"<kml>{mark}{uneven}</kml>")
    assert [r.altitude_m for r in flight.reports] == [9.0]
    assert flight.skipped[0] == "point 2: 2 times of 1 coordinates"
