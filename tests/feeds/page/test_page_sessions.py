from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.brokers import free_port, mosquitto
from support.every_kind import FAR_SENSORS
from support.page_updates import Frame, news_of, read_frame
from support.sessions import at_work
from support.waiting import until

from plotfeed import testing
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.page.page_sessions import PageSessions
from plotfeed.feeds.page.run_with_page import alongside, tracks_of
from plotfeed.feeds.page.updates import SectionKind
from plotfeed.feeds.page.view import View
from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer, Tap
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import entries_in
from plotfeed.proto.utc import NS
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Stage
from plotfeed.testing import MqttReceiver

DRONE = testing.flown("a", testing.waypoint(10, 5, 3000), testing.waypoint(60, 5, 5000))
SCENE = testing.scene(
    [
        testing.radar(
            scan=testing.rotating(sectors=16), link={"latency_ms": 40.0, "jitter_ms": 5.0}
        ),
        testing.radar(id="other", position_enu_m=[500.0, 0.0, 0.0], sic=2),
    ],
    [DRONE],
    seed=3,
)

SWITCHED_OFF = {"from_s": 2.0, "set": {"enabled": False}}


class Show:
    """A session with its page, looked at without a browser."""

    def __init__(self, clock: Clock, scene: Scene = SCENE) -> None:
        self.view = View()
        self.observer = PageSessions(scene, self.view, Path("nowhere"))
        self.messages: list[tuple[Message, int]] = []
        self.frames: list[Frame] = []
        self.others: list[Observer] = []
        self._clock = clock
        self._scene = scene

    def play(
        self, duration_s: float | None = None, act: Callable[[Show], Any] | None = None
    ) -> None:
        """For so long, or until all is acted."""
        asyncio.run(self._play(duration_s, act))
        self.look()

    async def _play(self, duration_s: float | None, act: Callable[[Show], Any] | None) -> None:
        tap: Any = lambda message, t_utc_ns: self.messages.append((message, t_utc_ns))  # noqa: E731
        observers = [Tap(tap), self.observer, *self.others]
        async with (
            alongside(self.observer.follow(), "page-follow"),
            at_work(self._scene, None, *observers, clock=self._clock, duration_s=duration_s),
        ):
            if act is not None:
                await self.until(lambda: self.frames and "scene" in self.news)
                await act(self)

    def look(self) -> Frame:
        update = self.view.update(self.observer.now_utc_ns(), self.observer.now_utc_ns() / 1e9)
        self.frames.append(read_frame(update.public + update.truth))
        return self.frames[-1]

    async def until(self, holds: Callable[[], Any]) -> None:
        await until(lambda: self.look() and holds())

    @property
    def news(self) -> dict[str, Any]:
        return news_of(self.frames)

    def link(self, sensor: str) -> dict[str, Any]:
        found: dict[str, Any] = self.news.get("details", {}).get(sensor, {}).get("link", {})
        return found

    def column(self, kind: SectionKind, name: str) -> Any:
        return np.concatenate([frame.column(kind, name) for frame in self.frames])


def test_the_page_shows_every_plot_and_when_it_left_as_the_ledger_has_it() -> None:
    show = Show(WallClock(testing.START_NS, speed=5.0))
    show.play(6.0)
    expected: list[tuple[int, float, float]] = []
    ledgers = (m.payload for m, _ in show.messages if m.topic == "plotfeed/truth")
    for entry in (entry for payload in ledgers for entry in entries_in(payload)):
        carriers = [m for m in entry.messages if m.topic.endswith(("/plots", "/048", "/015"))]
        for plot in entry.plots:
            first_ns = min(m.sent_utc_ns for m in carriers if m.delivered)
            late_ms = (first_ns - plot.time_utc_ns) / 1e6
            expected.append((int(entry.sensor == "other"), plot.time_utc_ns / 1e6, late_ms))
    names = ("sensor", "t_utc_ms", "latency_ms")
    columns = (show.column(SectionKind.PLOTS, name).tolist() for name in names)
    shown = sorted(zip(*columns, strict=True))
    assert len(shown) >= 8
    np.testing.assert_allclose(shown, sorted(expected), rtol=1e-6, atol=1e-3)
    assert all(late_ms > (20.0 if sensor == 0 else -1e-3) for sensor, _, late_ms in shown)
    assert show.column(SectionKind.PLOT_TRUTHS, "drone").max() == 0


def test_marks_tell_what_was_changed_and_by_whom_and_stories_which_are_on() -> None:
    async def act(show: Show) -> None:
        for command in (
            {"sensor": "radar", "set": {"link": {"latency_ms": 400.0}}},
            {"story": "outage"},
            {"clock": {"speed": 12}},
            {"story": "outage", "reset": True},
            {"undo": True},
        ):
            await show.observer.apply(command)
        await show.until(lambda: len(show.news["marks"]) == 5)

    sensors = [testing.radar(), testing.radar(id="other", sic=2, event=[SWITCHED_OFF])]
    show = Show(WallClock(testing.START_NS, speed=10.0), testing.scene(sensors, [DRONE], seed=3))
    show.play(act=act)
    marks = show.news["marks"]
    assert sorted(mark["words"] for mark in marks) == [
        "Outage of radar",
        "Outage of radar, taken back",
        "Undone: Outage of radar, taken back",
        "other: by its script",
        "radar: link.latency_ms 400.0",
    ]
    kinds = {mark["words"]: mark["kind"] for mark in marks}
    told = ("Outage of radar", "other: by its script", "radar: link.latency_ms 400.0")
    assert [kinds[words] for words in told] == ["story", "script", "change"]
    on = [each["id"] for each in show.news["stories"] if each["since_utc_ms"] is not None]
    assert on == ["outage"]
    assert show.news["undoes"] == "Outage of radar"
    assert all(second["t_utc_ms"] > testing.START_NS / 1e6 for second in show.news["seconds"])


def test_a_sensor_and_the_clock_are_changed_while_it_runs_and_the_page_says_so(
    tmp_path: Path,
) -> None:
    """What is refused changes nothing; a record has all of it as if it had come in."""
    asked: list[dict[str, Any]] = []

    async def apply(show: Show, **command: Any) -> Any:
        asked.append(command)
        return await show.observer.apply(command)

    async def act(show: Show) -> None:
        refused: tuple[dict[str, Any], ...] = ({"sensor": "nobody", "reset": True}, {"sensor": "x"})
        for command in refused:
            with pytest.raises(PlotfeedError) as error:
                await apply(show, **command)
            assert "\n" not in str(error.value)
        link = {"latency_ms": 400.0, "jitter_ms": 0.0}
        in_force = await apply(show, sensor="radar", set={"link": link})
        assert in_force["link"]["latency_ms"] == 400.0
        assert "radar" not in show.news.get("details", {})
        show.view.watch(["radar"])
        await show.until(lambda: show.link("radar").get("messages", 0) > 10)
        await apply(show, sensor="radar", reset=True)
        await apply(show, sensor="other", set={"enabled": False})
        await show.until(lambda: show.news["settings"]["other"].get("enabled") is False)
        await apply(show, clock={"paused": True})
        before_ns = show.observer.now_utc_ns()
        await asyncio.sleep(0.05)
        assert show.observer.now_utc_ns() == before_ns
        await show.until(lambda: show.news["session"]["clock"]["paused"])
        await apply(show, clock={"step_s": 0.5})
        await show.until(lambda: show.observer.now_utc_ns() == before_ns + NS // 2)
        await apply(show, clock={"paused": False, "speed": 20.0})
        assert show.look().news["session"]["clock"]["speed"] == 20.0

    show = Show(WallClock(testing.START_NS, speed=10.0))
    with Recorder(tmp_path / "changed.mcap") as recorder:
        show.others.append(SessionRecorder(recorder, ledger_is_sent=True))
        show.play(act=act)
    assert show.news["settings"]["radar"]["link"]["latency_ms"] == 40.0
    assert show.news["settings"]["other"]["enabled"] is False
    details = (frame.news.get("details", {}).get("radar") for frame in show.frames)
    links = [of["link"] for of in details if of and of["link"]["asked_mean_ms"] == 400.0]
    judged = [link["mean_ms"] for link in links if link["messages"]]
    assert judged
    assert min(judged) >= 399.9  # later on a busy machine
    assert show.news["session"]["clock"]["kind"] == "simulated"
    assert show.news["session"]["refuses"] == {}
    with McapReader(tmp_path / "changed.mcap") as log:
        taken = [json.loads(m.payload) for m in log.messages(stages=[Stage.TELEMETRY])]
    assert taken == asked


@pytest.mark.parametrize("clock", [WallClock, InstantClock])
def test_the_page_says_what_other_clocks_do_not_allow(clock: Callable[[], Clock]) -> None:
    show = Show(clock())
    show.play(0.3)
    assert show.news["session"]["refuses"].keys() == {"pause", "step", "speed"}


@pytest.mark.asyncio
async def test_what_needs_a_session_is_refused_without_one() -> None:
    sessions = PageSessions(SCENE, View(), Path("nowhere"))
    for command in ({"sensor": "radar", "reset": True}, {"record": {"start": True}}):
        with pytest.raises(PlotfeedError, match="no session runs"):
            await sessions.apply(command)


def test_refused_telemetry_and_totals_reach_the_page() -> None:
    async def act(show: Show) -> None:
        session = show.observer._session
        assert session is not None
        topic = "plotfeed/telemetry/x"
        session.intake.receive([(topic, b"nonsense", None)], show.observer.now_utc_ns())
        await show.until(lambda: show.news.get("refusal") and show.news["totals"].get("refused"))

    show = Show(WallClock(testing.START_NS, speed=10.0))
    show.play(act=act)
    assert "plotfeed/telemetry/x" in show.news["refusal"]
    assert show.news["totals"]["refused"] == 1


@pytest.mark.asyncio
async def test_tracks_come_from_their_topic_and_nonsense_is_said(tmp_path: Any) -> None:
    port, view, frames = free_port(), View(), list[Frame]()
    scene = testing.scene([testing.radar()], seed=3, page={"tracks_topic": "tracker/tracks"})
    view.scene(scene)
    with mosquitto(tmp_path, port):
        brokers = ([BrokerAddress("127.0.0.1", port, (5,))], {})
        async with tracks_of(scene, view, brokers, lambda: testing.START_NS):
            tracker = await asyncio.to_thread(MqttReceiver, port, 5)
            place = {"track": 4, "latitude_deg": 40.46, "longitude_deg": -3.72}

            def both_are_seen() -> bool:
                tracker.publish("tracker/tracks", json.dumps(place).encode())
                tracker.publish("tracker/tracks", b"nonsense")
                frames.append(read_frame(view.update(testing.START_NS, 0.0).public))
                has_tracks = any(frame.of(SectionKind.TRACKS) for frame in frames)
                return has_tracks and "track_problem" in news_of(frames)

            await until(both_are_seen)
            (number,) = {n for f in frames for n in f.column(SectionKind.TRACKS, "track")}
            assert number == 4
            assert "JSON" in news_of(frames)["track_problem"]
            await asyncio.to_thread(tracker.close)


LENS = FAR_SENSORS["camera"] | {
    "id": "camera",
    "horizontal_fov_deg": 20.0,
    "mount": {"pan_rate_deg_s": 60.0},
    "event": [{"from_s": 1.0, "set": {"mount": {"look_at": {"azimuth_deg": 120.0}}}}],
}


def test_the_page_is_told_where_a_mount_points_while_it_turns_and_what_a_beam_looks_at() -> None:
    sector = {"azimuth_min_deg": -60.0, "azimuth_max_deg": 60.0, "report": ["asterix-015"]}
    electronic = {"kind": "electronic", "period_s": 0.5, "dwell_s": 0.01}
    steered = testing.radar(id="steered", scan=electronic, integration_s=0.01, **sector)
    show = Show(WallClock(testing.START_NS), testing.scene([LENS, steered], [DRONE], seed=3))

    def lens(news: dict[str, Any]) -> dict[str, Any]:
        found: dict[str, Any] = news.get("pointing", {}).get("camera", {})
        return found

    async def act(show: Show) -> None:
        await show.until(lambda: lens(show.news).get("pan_deg") == 120.0)
        await show.until(lambda: lens(show.news)["sees"])

    show.play(act=act)
    told = [lens(frame.news) for frame in show.frames if lens(frame.news)]
    assert (told[0]["pan_deg"], told[0]["from_deg"], told[0]["cued_by"]) == (0.0, -10.0, "")
    turning = [at for at in told if 5.0 < at["pan_deg"] < 115.0]
    assert turning
    assert {(at["aim_deg"], at["sees"], at["span_deg"]) for at in turning} == {(120.0, False, 20.0)}
    assert (told[-1]["from_deg"], told[-1]["cued_by"]) == (110.0, "look_at")
    assert show.news["covers"]["camera"]["turns"]
    beams = show.news["pointing"]["steered"]
    assert beams["search_deg"]
    assert all(-60.0 <= azimuth <= 60.0 for azimuth in beams["search_deg"] + beams["tracks_deg"])
    assert beams["width_deg"] == show.news["settings"]["steered"]["azimuth_beamwidth_deg"]
