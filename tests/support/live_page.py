"""A run as a user starts it, a page of it in a browser, and a client that hears its broker.

What a control does is measured on what the broker delivers: messages, and the ledger's entries with
the session's own time stamps. The clock is simulated, so nothing depends on how fast a machine is.
"""

from __future__ import annotations

import json
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from support.chromium import looking, until, wait_beside
from support.command import Running, running
from support.scene_files import DRONE, RADAR, scene_file, scene_text

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import entries_in
from plotfeed.testing import MqttMessage, MqttReceiver

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

S = 1_000_000_000
MS = 1_000_000
START = "2026-01-01T12:00:00.05Z"
START_NS = 1_767_268_800 * S + 50 * MS
SPEED = 4
# Of the radars, so that a machine that stalls for half a second is late but misses no scan.
TURN_S = 2.0
SECTORS = {"radar": 128, "gate": 32}
PFA = 1e-4
CLOCK = ("Pause", "Go on", "Step 1 s", "Restart")  # Buttons of the clock
HOVERING = """
[[drone]]
id = "hovering"
rcs_m2 = 0.05
speed_m_s = 0.01
repeat = true
path = [
    { east_m = 1500.0, north_m = -800.0, above_site_m = 250.0 },
    { east_m = 1500.01, north_m = -800.0, above_site_m = 250.0 },
]
"""


def radar(name: str, sectors: int, more: str = "") -> str:
    """A radar with false alarms to count, that reports in our own format alone."""
    more = f'report = ["plots"]\n{more}'
    text = RADAR.format(id=name, period_s=TURN_S, sectors=sectors, more=more)
    return text.replace("pfa = 1e-5", f"pfa = {PFA}")


def scene_of_two() -> str:
    """Two radars whose messages leave at once, and a drone that hovers beside one that flies."""
    sensors = radar("radar", SECTORS["radar"])
    sensors += radar("gate", SECTORS["gate"], "position_enu_m = [900.0, -700.0, 10.0]")
    return scene_text(start_utc=START, sensors=sensors, drones=DRONE + HOVERING)


def end_ns(told: pb.PlotBatch | pb.Ledger) -> int:
    """When the sector ends that is told of, UTC."""
    return ends_ns(told.sensor, told.scan, told.sector)


def ends_ns(sensor: str, scan: int, sector: int) -> int:
    turn_ns = round(TURN_S * S)
    return scan * turn_ns + (sector + 1) * turn_ns // SECTORS[sensor]


def sectors_within(sensor: str, after_ns: int, until_ns: int) -> list[tuple[int, int]]:
    """Scan and sector of those that end after the one time, and not after the other."""
    each_ns = round(TURN_S * S) // SECTORS[sensor]
    numbers = range(after_ns // each_ns + 1, until_ns // each_ns + 1)
    return [divmod(number - 1, SECTORS[sensor]) for number in numbers]


class Broker:
    """All that a broker has delivered, read once."""

    def __init__(self, client: MqttReceiver) -> None:
        self.client = client
        self._read = 0
        self._places: dict[tuple[type, str], list[int]] = defaultdict(list)
        # Entries and batches by sensor, with their places in the order of all.
        self._told: dict[tuple[type, str], list[Any]] = defaultdict(list)

    @property
    def count(self) -> int:
        """Messages so far: a place in their order, from which to look."""
        return len(self.client.heard)

    def ledger(self, sensor: str = "radar", since: int = 0) -> list[pb.Ledger]:
        return self._of(pb.Ledger, sensor, since)

    def batches(self, sensor: str = "radar", since: int = 0) -> list[pb.PlotBatch]:
        return self._of(pb.PlotBatch, sensor, since)

    def on(self, topic: str, since: int = 0) -> list[tuple[int, dict[str, Any]]]:
        """Places and objects of JSON messages."""
        heard = enumerate(self.client.heard[since:], since)
        return [(at, json.loads(m.payload)) for at, m in heard if m.topic == topic]

    def sent(self, link: dict[str, Any], since: int = 0) -> list[pb.Sent]:
        """What became of the radar's messages that such a link was given, without a gap."""
        entries = [x for x in self.ledger(since=since) if _link(x.link) == link]
        sent = sorted((m for x in entries for m in x.messages), key=lambda m: m.number)
        gap = next((i for i, m in enumerate(sent) if m.number != sent[0].number + i), len(sent))
        return sent[:gap]

    def _of(self, kind: type, sensor: str, since: int) -> list[Any]:
        for place in range(self._read, self.count):
            for told in _parsed(self.client.heard[place]):
                self._places[type(told), told.sensor].append(place)
                self._told[type(told), told.sensor].append(told)
            self._read = place + 1
        first = bisect_left(self._places[kind, sensor], since)
        return self._told[kind, sensor][first:]


@cache
def _link(text: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(text or "{}")
    return found


def _parsed(message: MqttMessage) -> Sequence[pb.Ledger] | Sequence[pb.PlotBatch]:
    if message.topic.endswith("/truth"):
        return entries_in(message.payload)
    return [pb.PlotBatch.FromString(message.payload)] if message.topic.endswith("/plots") else []


class Live:
    """What a test of a control needs: the page to use it on, the broker to hear what it did."""

    def __init__(self, page: Page, broker: Broker, process: Running) -> None:
        self.page = page
        self.broker = broker
        self.process = process

    def wait(self, condition: Callable[[], object]) -> None:
        """Until it holds."""
        wait_beside(self.page, condition)

    def ask(self, **fields: str) -> tuple[int, dict[str, Any]]:
        """Fill in fields of the radar by their labels and apply them; what the broker tells."""
        for label, value in fields.items():
            self.page.get_by_label(label.replace("_", " "), exact=True).fill(value)
        answer = self.settings_after(lambda: self.press("Apply"))
        self.page.get_by_text("In force.").wait_for()
        return answer

    def as_in_the_scene(self) -> tuple[int, dict[str, Any]]:
        """The radar without changes; what the broker tells."""
        return self.settings_after(lambda: self.press("As in the scene"))

    def press(self, name: str) -> None:
        """The button of that name."""
        self._button(name).click()

    def _button(self, name: str) -> Locator:
        """A replay has buttons of the same names as the clock."""
        group = self.page.get_by_role("group", name="Clock") if name in CLOCK else self.page
        return group.get_by_role("button", name=name, exact=True)

    def settings_after(self, action: Callable[[], object]) -> tuple[int, dict[str, Any]]:
        """Where the broker tells the radar's next settings once that is done, and which."""
        since = self.broker.count
        action()
        self.wait(lambda: self.broker.on("plotfeed/radar/settings", since))
        return self.broker.on("plotfeed/radar/settings", since)[0]

    def choose(self, state: str) -> tuple[int, dict[str, Any]]:
        """A state of the radar; where and as what the broker tells it."""
        radio = self.page.get_by_role("radio", name=state, exact=True)
        return self.settings_after(radio.check)

    def set_speed(self, speed: int) -> None:
        self.page.get_by_label("Speed").select_option(str(speed))
        until(self.page, f"plotfeed.picture.news.session.clock.speed === {speed}")

    def as_in_the_beginning(self) -> None:
        """The radar as in the scene, time at its pace."""
        self.as_in_the_scene()
        if self._button("Go on").is_visible():
            self.press("Go on")
        self.set_speed(SPEED)

    def freeze(self, *sensors: str) -> int:
        """Let time stand still, by the button; what it is then, and all of it has come."""
        self.press("Pause")
        self._button("Go on").wait_for()
        return self.all_until(self.standing(), *sensors)

    def step(self, *sensors: str) -> int:
        """A second more; what time it is then, and all of it has come."""
        before_ns = self.standing()
        self.press("Step 1 s")
        self.wait(lambda: self.standing() > before_ns + S - MS)
        return self.all_until(self.standing(), *sensors)

    def standing(self) -> int:
        """The time at which it stands, UTC in nanoseconds; to a microsecond."""
        until(self.page, "plotfeed.picture.pace === 0")
        return round(self.page.evaluate("plotfeed.picture.nowMs(0)") * MS)

    def all_until(self, now_ns: int, *sensors: str) -> int:
        """That time, once the broker has delivered all that the sensors have told by then.

        Without any, both. Their links must not be late.
        """
        for sensor in sensors or SECTORS:
            self._all_of(sensor, now_ns)
        self.settle()  # a status may be due at the very end
        return now_ns

    def settle(self) -> None:
        """Until nothing has come for a while: what had left when time stood has come by then."""
        count = -1
        while count != self.broker.count:
            count = self.broker.count
            self.page.wait_for_timeout(300)

    def _all_of(self, sensor: str, now_ns: int) -> None:
        last = sectors_within(sensor, now_ns - S, now_ns)[-1]
        self.wait(lambda: last in {(x.scan, x.sector) for x in self.broker.ledger(sensor)[-3:]})
        wanted = delivered(self.broker.ledger(sensor))
        # Of what left before this client came, the ledger may have told later.
        first = min(told(self.broker.batches(sensor)), default=last)
        wanted = {sector for sector in wanted if sector >= first}
        self.wait(lambda: wanted <= told(self.broker.batches(sensor)))


def told(batches: list[pb.PlotBatch]) -> set[tuple[int, int]]:
    return {(batch.scan, batch.sector) for batch in batches}


def delivered(ledger: list[pb.Ledger]) -> set[tuple[int, int]]:
    """Scans and sectors of which a message left."""
    return {(x.scan, x.sector) for x in ledger if any(m.delivered for m in x.messages)}


@contextmanager
def heard(folder: Path, *, page: str = "127.0.0.1:0") -> Iterator[tuple[Running, Broker]]:
    """The scene of two, run from that folder, with another beside it; what its broker delivers."""
    scene = scene_file(folder, scene_of_two())
    (folder / "other.toml").write_text(scene_text(sensors=radar("north", 64), drones=""))
    with (
        running("run", scene, "--page", page, "--speed", SPEED, folder=folder) as run,
        MqttReceiver(run.port("MQTT"), 5, "#") as client,
    ):
        yield run, Broker(client)


@contextmanager
def live(browser: Browser, folder: Path) -> Iterator[Live]:
    """That, with a page of it."""
    with (
        heard(folder) as (run, broker),
        looking(browser, f"http://127.0.0.1:{run.port('page')}/") as page,
    ):
        yield Live(page, broker, run)
