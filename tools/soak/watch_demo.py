"""The demonstration watched in a browser beside its broker, at three sizes of its window.

    python tools/soak/watch_demo.py --minutes 3 --folder watched

Stories happen meanwhile. What the page said of plots and tracks is compared
with what the broker carried in the same time; pictures of the page are left in the folder. Prints
JSON, and fails where anything differs.
"""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import ExitStack
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from support.chromium import chromium, looking
from support.command import running
from support.page_beside_broker import Beside

from plotfeed.feeds.scene.scene import example
from plotfeed.testing import MqttReceiver

SIZES = ((1280, 720), (1920, 1080), (2560, 1440))
# Of equal parts of the time; in those without a name all is as usual.
STORIES = ("", "Outage of the tower", "", "The tower goes blind", "Jamming", "A swarm")


def watch(scene: str, seconds: float, folder: Path) -> list[dict[str, object]]:
    """What each window said otherwise than the broker."""
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        run = stack.enter_context(running("demo", scene, "--page", "127.0.0.1:0", folder=folder))
        client = stack.enter_context(MqttReceiver(run.port("MQTT"), 5, "#"))
        browser = stack.enter_context(chromium())
        url = f"http://127.0.0.1:{run.port('page')}/"
        windows = []
        for width, height in SIZES:
            size = {"width": width, "height": height}
            page = stack.enter_context(looking(browser, url, viewport=size))
            page.get_by_role("button", name="Skip the tour").click()
            page.get_by_role("button", name="Truth").click()
            windows.append((width, Beside(page, client, example(scene))))
        first = windows[0][1].page
        for part, story in enumerate(STORIES):
            button = first.get_by_role("button", name=story, exact=True)
            if story and button.count():
                button.click()
            steps = max(round(seconds / len(STORIES) / 5), 1)
            for _ in range(steps):
                first.wait_for_timeout(1000 * seconds / len(STORIES) / steps)
                for _, beside in windows:
                    beside.sample()
            for width, beside in windows:
                beside.page.screenshot(path=folder / f"{width}-{part}.png")
            if story and button.count():
                button.click()
        return [{"width": width, **beside.differences()} for width, beside in windows]


def main() -> int:
    """Watch, print, and say whether it was as it should be."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--scene", default="field-day")
    options.add_argument("--minutes", type=float, default=3.0)
    options.add_argument("--folder", type=Path, default=Path("watched"))
    asked = options.parse_args()
    found = watch(asked.scene, 60 * asked.minutes, asked.folder)
    print(json.dumps(found, indent=1))
    return int(any(each["differences"] for each in found))


if __name__ == "__main__":
    sys.exit(main())
