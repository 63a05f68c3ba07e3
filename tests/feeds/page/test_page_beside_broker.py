"""The demonstration in a browser, beside what its broker carries in the same time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from support.chromium import looking, until
from support.command import running
from support.page_beside_broker import Beside

from plotfeed.feeds.scene.scene import example
from plotfeed.testing import MqttReceiver

if TYPE_CHECKING:
    from playwright.sync_api import Browser

OUTAGE = "Outage of the tower"
# No track is drawn as if it were told of.
SILENT = """() => {
  const { picture, display } = plotfeed, words = display.words.map((w) => w[4]);
  const ids = [...picture.tracks.keys()], aged = words.filter((w) => /^T[0-9]+ [0-9]+ s$/.test(w));
  return ids.length > 0 && aged.length > 0 && !words.some((w) => ids.some((id) => w === `T${id}`));
}"""


def test_the_page_of_the_demonstration_says_what_its_broker_carries(
    browser: Browser, tmp_path: Path
) -> None:
    demo = ("demo", "--page", "127.0.0.1:0")
    with running(*demo, folder=tmp_path) as run, MqttReceiver(run.port("MQTT"), 5, "#") as client:
        url = f"http://127.0.0.1:{run.port('page')}/"
        with looking(browser, url) as page:
            until(page, "plotfeed.picture.tracks.size > 5")
            beside = Beside(page, client, example("field-day"))
            page.wait_for_timeout(2500)
            beside.sample()
            story = page.get_by_role("button", name=OUTAGE, exact=True)
            story.click()
            assert "grow old" in page.locator("#stories").inner_text()
            until(page, SILENT)
            beside.sample()
            assert "link down" in page.locator("#sensors").inner_text()
            story.click()
            topic, so_far = beside.scene.page.tracks_topic, len(client.heard)
            client.wait_for(lambda message: message.topic == topic, since=so_far)
            page.wait_for_timeout(2500)
            beside.sample()
            found = beside.differences()
            assert found["differences"] == []
            assert found["plots_shown"] > 50
            assert found["tracks_compared"] > 15
