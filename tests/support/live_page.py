"""A run as a user starts it, a page of it in a browser, and a client that hears its broker.

What a control does is measured on what the broker delivers: messages, and the ledger's entries with
the session's own time stamps. The clock is simulated, so nothing depends on how fast a machine is.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from support.chromium import looking, until, wait_beside
from support.command import Running, running
from support.scene_files import radar, scene_file, scene_text

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import entries_in
from plotfeed.testing import MqttReceiver

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

S = 1_000_000_000
START = "2026-01-01T12:00:00.05Z"
START_NS = 1_767_268_800 * S + 50_000_000
SPEED = 4
# Of the radars, so that a machine that stalls for half a second is late but misses no scan.
TURN_S, SECTORS = 2.0, 32
CLOCK = ("Pause", "Go on", "Step 1 s", "Restart")  # Buttons of the clock


def end_ns(told: pb.PlotBatch | pb.Ledger) -> int:
    """When the sector ends that is told of, UTC."""
    turn_ns = round(TURN_S * S)
    return told.scan * turn_ns + (told.sector + 1) * turn_ns // SECTORS


def sectors_within(after_ns: int, until_ns: int) -> list[tuple[int, int]]:
    """Scan and sector of those that end after the one time, and not after the other."""
    each_ns = round(TURN_S * S) // SECTORS
    numbers = range(after_ns // each_ns + 1, until_ns // each_ns + 1)
    return [divmod(number - 1, SECTORS) for number in numbers]


class Live:
    """What a test of a control needs: the page to use it on, the broker to hear what it did."""

    def __init__(self, page: Page, client: MqttReceiver, process: Running) -> None:
        self.page = page
        self.client = client
        self.process = process

    def wait(self, condition: Callable[[], object]) -> None:
        """Until it holds."""
        wait_beside(self.page, condition)

    @property
    def count(self) -> int:
        """Messages so far: a place in their order, from which to look."""
        return len(self.client.heard)

    def batches(self, sensor: str = "radar", since: int = 0) -> list[pb.PlotBatch]:
        topic = f"plotfeed/{sensor}/plots"
        heard = self.client.heard[since:]
        return [pb.PlotBatch.FromString(m.payload) for m in heard if m.topic == topic]

    def ledger(self, sensor: str = "radar", since: int = 0) -> list[pb.Ledger]:
        told = [m.payload for m in self.client.heard[since:] if m.topic == "plotfeed/truth"]
        entries = [entry for payload in told for entry in entries_in(payload)]
        return [entry for entry in entries if entry.sensor == sensor]

    def on(self, topic: str, since: int = 0) -> list[tuple[int, dict[str, Any]]]:
        """Places and objects of JSON messages."""
        heard = enumerate(self.client.heard[since:], since)
        return [(at, json.loads(m.payload)) for at, m in heard if m.topic == topic]

    def sent(self, link: dict[str, Any], since: int = 0) -> list[pb.Sent]:
        """What became of the radar's messages that were given to such a link."""
        ledger = [x for x in self.ledger(since=since) if json.loads(x.link or "{}") == link]
        return [message for entry in ledger for message in entry.messages]

    def press(self, name: str) -> None:
        """The button of that name."""
        self.button(name).click()

    def button(self, name: str) -> Locator:
        """A replay has buttons of the same names as the clock."""
        group = self.page.get_by_role("group", name="Clock") if name in CLOCK else self.page
        return group.get_by_role("button", name=name, exact=True)

    def settings_after(self, action: Callable[[], object]) -> tuple[int, dict[str, Any]]:
        """Where the broker tells the radar's next settings once that is done, and which."""
        since = self.count
        action()
        self.wait(lambda: self.on("plotfeed/radar/settings", since))
        return self.on("plotfeed/radar/settings", since)[0]

    def standing(self) -> int:
        """The time at which it stands, UTC in nanoseconds; to a microsecond."""
        until(self.page, "plotfeed.picture.pace === 0")
        return round(self.page.evaluate("plotfeed.picture.nowMs(0)") * 1_000_000)

    def settle(self) -> None:
        """Until nothing has come for a while: what had left when time stood has come by then."""
        count = -1
        while count != self.count:
            count = self.count
            self.page.wait_for_timeout(300)


@contextmanager
def live(browser: Browser, folder: Path) -> Iterator[Live]:
    """A scene of two radars, run from that folder, with another scene beside it, and its page."""
    more = 'report = ["plots"]\nreceive_beams = 4'
    how: dict[str, Any] = {"period_s": TURN_S, "sectors": SECTORS}
    sensors = radar(more=more, **how)
    sensors += radar("gate", more=f"{more}\nposition_enu_m = [900.0, -700.0, 10.0]", **how)
    scene = scene_file(folder, scene_text(start_utc=START, sensors=sensors))
    other = scene_text(sensors=radar("north", more=more, **how), drones="")
    (folder / "other.toml").write_text(other)
    with (
        running("run", scene, "--page", "127.0.0.1:0", "--speed", SPEED, folder=folder) as run,
        MqttReceiver(run.port("MQTT"), 5, "#") as client,
        looking(browser, f"http://127.0.0.1:{run.port('page')}/") as page,
    ):
        yield Live(page, client, run)
