"""What the display draws of lenses, beams, jammers and tracks is what there is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from support.chromium import drawn, until
from support.page_server import Served

from plotfeed import testing
from plotfeed.feeds.lab.track_reports import ToldTrack
from plotfeed.feeds.page.updates import TrackFlag
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from playwright.sync_api import Page

LENS = {
    "id": "camera",
    "type": "camera",
    "sic": 5,
    "position_enu_m": [0.0, 0.0, 10.0],
    "pan_deg": 60.0,
    "horizontal_fov_deg": 14.0,
    "pixels_across": 1920,
    "pixels_down": 1080,
    "range_max_m": 2000.0,
    "scan": testing.staring(),
}
JAMMER = {
    "east_m": -900.0,
    "north_m": 700.0,
    "above_site_m": 50.0,
    "eirp_w": 10.0,
    "frequency_hz": 9.4e9,
    "bandwidth_hz": 4e7,
}
# At a distance in some directions.
COLOURS = """([azimuths, range]) => {
  const context = document.getElementById("screen").getContext("2d"), { view } = plotfeed.display;
  return azimuths.map((azimuth) => {
    const angle = (azimuth * Math.PI) / 180;
    const x = view.x(range * Math.sin(angle)), y = view.y(range * Math.cos(angle));
    return [...context.getImageData(Math.round(x), Math.round(y), 1, 1).data.slice(0, 3)];
  });
}"""
SEA = [0x0A, 0x16, 0x1F]


def show(page: Page, served: Served, sensors: list[dict[str, Any]]) -> None:
    """Another scene, of which nothing but the cover of sensors is drawn."""
    scene = testing.scene(sensors, seed=1)
    served.call(lambda: served.server._view.scene(scene))
    page.get_by_role("heading", name=f"{sensors[0]['id']}: settings").wait_for()
    for layer in ("Sweep", "Labels", "Map"):
        page.get_by_role("checkbox", name=layer).uncheck()
    page.get_by_label("Grid").select_option("none")
    until(page, "plotfeed.display.isFitted")
    drawn(page)


def covered(page: Page, step_deg: float) -> list[float]:
    """Directions in which anything is drawn over the bare ground, halfway between steps."""
    drawn(page)
    azimuths = np.arange(0.5, 360.0, step_deg).tolist()
    colours = page.evaluate(COLOURS, [azimuths, 1500.0])
    found = zip(azimuths, colours, strict=True)
    return [azimuth - 0.5 for azimuth, colour in found if colour != SEA]


def test_a_fixed_camera_covers_its_lens_and_nothing_beside_it(page: Page, served: Served) -> None:
    show(page, served, [LENS])
    assert covered(page, 5) == [55, 60, 65]


def test_a_camera_is_drawn_where_it_points_while_its_mount_turns(
    page: Page, served: Served
) -> None:
    show(page, served, [LENS | {"mount": {}}])
    look: dict[str, Any] = {"tilt_deg": 3.0, "span_deg": 14.0, "sees": True, "cued_by": "rf"}
    view = served.server._view
    assert not covered(page, 5)
    for pan_deg in (60.0, 120.0):
        at = look | {"pan_deg": pan_deg, "from_deg": pan_deg - 7.0, "aim_deg": pan_deg}
        served.call(lambda: view.pointing({"camera": at}))  # noqa: B023 - at once
        until(page, f"plotfeed.picture.news.pointing.camera?.pan_deg === {pan_deg}")
        assert covered(page, 5) == [pan_deg - 5, pan_deg, pan_deg + 5]
        assert f"Points to {pan_deg:.1f}°" in page.locator("#sensor-words").inner_text()
    assert "plots of rf" in page.locator("#sensor-words").inner_text()


def test_beams_of_an_electronic_radar_are_drawn_where_they_pointed(
    page: Page, served: Served
) -> None:
    show(page, served, [LENS | {"mount": {}}])  # of which nothing is drawn by itself
    beams = {"width_deg": 4.0, "search_deg": [10.0, 14.0], "tracks_deg": [200.0]}
    served.call(lambda: served.server._view.pointing({"camera": beams}))
    until(page, "plotfeed.picture.news.pointing.camera?.search_deg.length === 2")
    assert covered(page, 2) == [8, 10, 12, 14, 198, 200]


def test_jammers_are_drawn_where_they_are_for_as_long_as_they_jam(
    page: Page, served: Served
) -> None:
    clear = testing.scene([testing.radar(range_max_m=3000.0)], seed=1)
    jammed = testing.scene([testing.radar(range_max_m=3000.0, jamming={"east": JAMMER})], seed=1)
    show(page, served, [testing.radar(range_max_m=3000.0)])
    page.get_by_role("checkbox", name="Labels").check()
    words = "plotfeed.display.words.filter((w) => w[4].includes('jammer')).map((w) => w[4])"
    for scene, told in ((jammed, "jammer east: radar"), (clear, None)):
        served.call(lambda: served.server._view.cover(scene.sensor[0]))  # noqa: B023 - at once
        until(page, f"{words}.join() === '{told or ''}'")
        azimuth_deg = float(np.degrees(np.arctan2(JAMMER["east_m"], JAMMER["north_m"])))
        range_m = float(np.hypot(JAMMER["east_m"], JAMMER["north_m"]))
        ((red, _, _),) = page.evaluate(COLOURS, [[azimuth_deg], range_m])
        assert (red > 200) == (told is not None)


def reports(times_ns: list[int], track: int, flags: int = 0, name: str = "") -> list[ToldTrack]:
    """Of a track that flies east, one a time."""
    return [
        ToldTrack(
            name=name or str(track),
            t_utc_ns=t_utc_ns,
            latitude_deg=testing.SITE.latitude_deg + 0.01 * (track - 90),
            longitude_deg=testing.SITE.longitude_deg,
            height_m=testing.SITE.height_m,
            velocity_enu_m_s=(20.0, 0.0, 0.0),
            coasted=bool(flags & TrackFlag.COASTED),
            ended=bool(flags & TrackFlag.ENDED),
        )
        for t_utc_ns in times_ns
    ]


def test_a_track_that_is_not_updated_is_drawn_as_such_with_its_age_and_stays_where_it_was(
    page: Page, served: Served
) -> None:
    ago_s = 20
    now_ns = served.call(served.server._now_utc_ns)
    often = [now_ns - s * NS for s in (4, 3, 2, 1)]
    told = [
        reports([t_ns - ago_s * NS for t_ns in often], 91),
        reports(often, 92),
        reports(often, 93, TrackFlag.COASTED),
        reports(often, 94),
        reports([now_ns], 94, TrackFlag.ENDED),
        reports(often, 89, name="<b>9th of the north-western gate"),
    ]
    served.call(lambda: [served.server._view.tracks(each) for each in told])
    until(page, "plotfeed.picture.tracks.has(93)")
    page.get_by_role("button", name="Table").click()
    page.get_by_label("Kind").select_option("tracks")
    page.get_by_label("Filter").fill("9")
    cells = (
        "[...document.querySelectorAll('#table-body tr')].map((r) => [r.cells[0].innerText,"
        " r.cells[6].innerText])"
    )
    until(page, f"{cells}.length >= 4")
    states = dict(page.evaluate(cells))
    assert states["91"] == "not updated, was confirmed"
    assert states["92"] == "confirmed"
    assert states["93"] == "coasted"
    assert states["<b>9th of the north-western gate"] == "confirmed"
    assert "94" not in states
    until(page, f"plotfeed.display.words.some((w) => w[4] === 'T91 {ago_s + 1} s')")
    assert page.evaluate("plotfeed.display.words.some((w) => w[4] === 'T92')")
    until(page, "plotfeed.display.words.some((w) => w[4] === '<b>9th of the north-')")
    ask = "plotfeed.display.select({ kind: 'track', id: 91 })"
    page.evaluate(ask)
    page.get_by_role("heading", name="Track 91").wait_for()
    assert f"{ago_s + 1}.0 s ago" in page.locator("#card").inner_text()
    # 20 m/s for 21 s would be 420 m: it is where it was told last, north of the site.
    assert "0.0°" in page.locator("#card").inner_text()
