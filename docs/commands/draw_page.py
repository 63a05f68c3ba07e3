"""Draws docs/page-dark.png and page-light.png: the live page of a session, as a browser shows it.

Needs Chromium and the extra test-page. python docs/commands/draw_page.py
"""

from __future__ import annotations

import asyncio
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from playwright.async_api import Page, async_playwright

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.page.page_access import PageAddress
from plotfeed.feeds.page.run_with_page import PageObserver, alongside
from plotfeed.feeds.page.scene_outline import Basemap, load_basemap
from plotfeed.feeds.page.server import PageServer, serving
from plotfeed.feeds.page.tracker_tracks import decode_tracks
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene, from_tree
from plotfeed.feeds.session.observer import Tap
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import WallClock

DOCS = Path(__file__).parents[1]
START_UTC_NS = 1_767_268_800_000_000_000
SECONDS = 50.0
SITE = {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}
TRACKS_TOPIC = "plotfeed/tower/asterix/062"
OPTIONS = ["--no-sandbox", "--disable-gpu", "--hide-scrollbars"]

RADAR = {
    "type": "active_radar",
    "power_w": 5.0,
    "frequency_hz": 10e9,
    "gain_tx_dbi": 20.0,
    "integration_s": 0.06,
    "pfa": 1e-5,
    "range_resolution_m": 10.0,
    "range_min_m": 150.0,
    "range_max_m": 8000.0,
    "azimuth_beamwidth_deg": 2.0,
    "elevation_beamwidth_deg": 6.0,
    "receive_beams": 32,
    "elevation_min_deg": -2.0,
    "elevation_max_deg": 60.0,
}
BURSTS = {"kind": "gilbert-elliott", "mean_loss": 0.05, "mean_burst": 3.0}
SENSORS = [
    RADAR
    | {
        "id": "tower",
        "report": ["asterix-048", "asterix-062", "plots"],
        "scan": {"kind": "rotating", "period_s": 2.0},
        "link": {"latency_ms": 120.0, "jitter_ms": 25.0, "loss": BURSTS},
    },
    RADAR
    | {
        "id": "gate",
        "sic": 2,
        "scan": {"kind": "staring", "period_s": 1.0},
        "position_enu_m": [2600.0, -1900.0, 12.0],
        "range_max_m": 4200.0,
        "azimuth_min_deg": 60.0,
        "azimuth_max_deg": 200.0,
        "link": {"latency_ms": 60.0, "jitter_ms": 10.0},
    },
    {
        "id": "roof",
        "sic": 3,
        "type": "rf",
        "scan": {"kind": "staring", "period_s": 2.0},
        "position_enu_m": [-2800.0, -2400.0, 20.0],
        "frequency_min_hz": 2.4e9,
        "frequency_max_hz": 2.5e9,
        "channel_bandwidth_hz": 1e7,
        "integration_s": 1e-3,
        "range_max_m": 6000.0,
        "azimuth_beamwidth_deg": 10.0,
        "baseline_m": 0.3,
        "duty_cycle": 0.6,
    },
    {
        "id": "fence",
        "sic": 4,
        "type": "acoustic",
        "scan": {"kind": "staring", "period_s": 1.0},
        "position_enu_m": [-1200.0, 1100.0, 3.0],
        "height_above_ground_m": 1.5,
        "microphones": 8,
        "azimuth_beamwidth_deg": 4.4,
        "noise_db": 0.0,
        "sensitivity_db": 6.0,
        "absorption_db_per_km": 5.0,
        "range_max_m": 1400.0,
    },
]


def scene() -> Scene:
    """Four sensors that see differently, and two dozen drones."""
    rng = np.random.default_rng(21)
    drones = []
    for i in range(24):
        turn, at, up_m = rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi), rng.uniform(60, 300)
        middle_m = rng.uniform(800, 5500) * np.array([np.sin(at), np.cos(at)])
        half_m = rng.uniform(600, 2200) * np.array([np.sin(turn), np.cos(turn)])
        ends = [middle_m - half_m, middle_m + half_m]
        emitters = [{"frequency_hz": 2.45e9, "bandwidth_hz": 1e7, "eirp_dbm": 20.0}]
        drones.append(
            {
                "id": f"uav-{i + 1:02}",
                "speed_m_s": float(rng.uniform(9, 22)),
                "rcs_m2": 0.03,
                "repeat": True,
                "emitters": emitters if i % 6 == 0 else [],
                "path": [
                    {"east_m": float(e), "north_m": float(n), "above_site_m": float(up_m)}
                    for e, n in ends
                ],
            }
        )
    general = {"name": "field-day", "seed": 4, "site": SITE}
    tree = {"scene": general, "sensor": SENSORS, "drone": drones}
    return from_tree(tree, DOCS / "field-day.toml")


def basemap(site: Any) -> Basemap:
    """A river, roads and a runway that nobody has built."""
    frame = site_frame(site)

    def places(points: list[tuple[float, float]]) -> list[list[float]]:
        enu_m = np.array([(e, n, 0.0) for e, n in points])
        latitude_deg, longitude_deg, _ = frame.to_geodetic(enu_m)
        return np.stack([longitude_deg, latitude_deg], axis=-1).tolist()

    north = np.linspace(-9000, 9000, 60)
    middle = 4200 + 700 * np.sin(north / 1500) - 0.25 * north
    left, right = (list(zip(middle + side_m, north, strict=True)) for side_m in (-160, 160))
    river = [*left, *reversed(right)]
    runway = [(-900, -350), (700, 150), (680, 210), (-920, -290), (-900, -350)]
    roads = [
        [(-9000, -1500), (-2600, -900), (-300, -700), (2200, -1600), (9000, -2300)],
        [(-1900, 9000), (-1300, 2600), (-300, -700), (300, -4000), (-700, -9000)],
    ]
    features = [("Polygon", [places(river)]), ("Polygon", [places(runway)])]
    features += [("LineString", places(road)) for road in roads]
    collection = {
        "type": "FeatureCollection",
        "features": [
            {"type": "Feature", "properties": {}, "geometry": {"type": kind, "coordinates": c}}
            for kind, c in features
        ],
    }
    path = DOCS / ".basemap.geojson"
    try:
        path.write_text(json.dumps(collection))
        return load_basemap(path.name, path, site)
    finally:
        path.unlink()


async def draw() -> None:
    """Run the scene, look at it twice."""
    shown, view = scene(), View()
    observer = PageObserver(view)
    observer.scene(basemap(shown.scene.site))
    site = site_frame(shown.scene.site)

    def tap(message: Message, _sent_utc_ns: int) -> None:
        if message.topic == TRACKS_TOPIC:
            view.tracks(decode_tracks(message.payload, observer.now_utc_ns(), site))

    server = PageServer(PageAddress("127.0.0.1", 0), view, observer, observer.now_utc_ns)
    async with (
        serving(server) as url,
        alongside(observer.follow(), "page-follow"),
        async_playwright() as playwright,
    ):
        session = asyncio.create_task(
            run(
                shown,
                clock=WallClock(START_UTC_NS),
                broker="none",
                duration_s=SECONDS + 60,
                observers=[Tap(tap), observer],
            )
        )
        browser = await playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=OPTIONS
        )
        window = {"width": 1680, "height": 1000}
        dark = await browser.new_page(viewport=window, color_scheme="dark")
        light = await browser.new_page(viewport=window, color_scheme="light")
        for page in (dark, light):
            await page.goto(url)
        await light.click("#truth")
        await light.get_by_role("button", name="gate").click()
        await asyncio.sleep(SECONDS)
        await dark.screenshot(path=DOCS / "page-dark.png")
        await _select(light)
        await light.screenshot(path=DOCS / "page-light.png")
        await browser.close()
        session.cancel()
    print(f"{DOCS}/page-dark.png, page-light.png")


async def _select(page: Page) -> None:
    """The newest plot of a drone."""
    await page.evaluate(
        """() => {
          const { picture: { plots }, display } = plotfeed;
          for (let row = plots.end - 1; row >= plots.begin; row--) {
            const at = plots.at(row);
            if (plots.drone[at] >= 0 && plots.sensor[at] === 1 && !plots.flags[at])
              return display.select({ kind: "plot", row, at });
          }
        }"""
    )
    await page.wait_for_timeout(300)


if __name__ == "__main__":
    asyncio.run(draw())
