"""Recordings replayed from the page: asked over its WebSocket, measured on a broker."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, mosquitto
from support.command import plotfeed
from support.mqtt_client import Client, Heard
from support.page_sessions import Begun, with_page
from support.page_updates import Frame, read_frame
from support.scene_files import radar, scene_text
from support.waiting import PATIENCE_S

from plotfeed.feeds.page import page_replay
from plotfeed.feeds.page.page_replay import NOT_NOW
from plotfeed.feeds.page.updates import SectionKind
from plotfeed.feeds.replaying.replay_settings import Moment, Selection
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.mcap.mcap_writer import McapWriter
from plotfeed.replay.recorded import Recorded

NS = 1_000_000_000
TRACKS = "lab/tracks"
SESSION_S = 20
Act = Callable[["Viewer", Client, Begun], Any]


class Viewer:
    """A page's end of the feed, which keeps what it is shown."""

    def __init__(self, feed: Any) -> None:
        self._feed = feed
        self.frames: list[Frame] = []
        self.session: dict[str, Any] = {}
        self.scene = ""

    async def ask(self, **command: Any) -> dict[str, Any]:
        await self._feed.send(json.dumps({"number": 7, "command": command}))
        async with asyncio.timeout(PATIENCE_S):
            while (answer := await self._heard()) is None or answer.get("number") != 7:
                pass
        return answer

    async def done(self, **command: Any) -> Any:
        answer = await self.ask(**command)
        assert answer["ok"], answer
        return answer["in_force"]

    async def until(self, holds: Callable[[], Any]) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not holds():
                await self._heard()

    async def load(self, name: str = "session.mcap") -> None:
        """Until it plays."""
        await self.done(replay={"load": name})
        await self.until(lambda: self.replay.get("position_s", 0) > 0)

    @property
    def replay(self) -> dict[str, Any]:
        found: dict[str, Any] = self.session.get("replay", {})
        return found

    @property
    def is_at_end(self) -> bool:
        return (
            bool(self.replay["paused"]) and self.replay["position_s"] == self.replay["duration_s"]
        )

    async def _heard(self) -> dict[str, Any] | None:
        heard = await self._feed.recv()
        if isinstance(heard, str):
            return dict(json.loads(heard))
        self.frames.append(read_frame(heard))
        self.session = self.frames[-1].news.get("session", self.session)
        self.scene = self.frames[-1].news.get("scene", {"name": self.scene})["name"]
        return None


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a session that publishes under another prefix than the one that runs beside the page."""
    folder = tmp_path_factory.mktemp("record")
    text = scene_text(
        start_utc="2026-01-01T12:00:00Z", port=1883, mqtt='prefix = "lab"', sensors=radar("lab")
    )
    scene = folder / "lab.toml"
    scene.write_text(f'{text}\n[page]\ntracks_topic = "{TRACKS}"\n'.replace('"test"', '"lab"'))
    how = ["--broker", "none", "--speed", "max", "--duration", SESSION_S]
    done = plotfeed("run", scene, "--record", folder / "session.mcap", *how)
    assert done.returncode == 0, done.stderr
    return folder / "session.mcap"


@pytest.fixture(scope="module")
def sent(record: Path) -> list[Recorded]:
    """What a replay sends of it."""
    takes = Selection().takes
    with McapReader(record) as log:
        return [m for m in log.messages() if takes(m.topic, m.content_type, m.stage)]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, record: Path) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "live").mkdir()
    (tmp_path / "session.mcap").write_bytes(record.read_bytes())
    return tmp_path


@pytest.fixture
def play(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Act], Any]]:
    """Plays with a page of a live session, and gives the names of the scenes that ran."""
    port, scene = free_port(), folder / "live" / "live.toml"
    scene.write_text(scene_text(port=port))

    async def run(act: Act) -> list[str]:
        client = await asyncio.to_thread(Client, port, 5, "lab/#", "plotfeed/#")
        try:
            async with with_page(load(scene), f"mqtt://127.0.0.1:{port}") as (feed, begun):
                await act(Viewer(feed), client, begun)
                return begun.names
        finally:
            await asyncio.to_thread(client.close)

    with mosquitto(tmp_path_factory.mktemp("broker"), port):
        yield run


def of_lab(client: Client, since: int = 0) -> list[Heard]:
    return [m for m in client.heard[since:] if m.topic.startswith("lab/") and m.topic != TRACKS]


def recorded_ns(sent: list[Recorded]) -> dict[str, int]:
    """When messages were recorded that nothing else is like, by their ids."""
    return {f"{m.topic} {dict(m.properties)['id']}": m.log_time_ns for m in sent if has_id(m)}


def has_id(message: Recorded) -> bool:
    return message.topic.endswith(("/plots", "/048", "/034"))


def shifts_ns(heard: list[Heard], sent: list[Recorded]) -> list[tuple[int, int]]:
    """When messages were recorded, and by how much later they say that they are now."""
    stamps = {f"{m.topic} {dict(m.properties)['id']}": dict(m.properties)["time"]
              for m in sent if has_id(m)}  # fmt: skip
    times, found = recorded_ns(sent), []
    for message in heard:
        key = f"{message.topic} {message.user_properties.get('id')}"
        if key in times:
            now, then = (
                Moment.parse(t).utc_ns for t in (message.user_properties["time"], stamps[key])
            )
            found.append((times[key], (now or 0) - (then or 0)))
    return found


@pytest.mark.asyncio
async def test_a_recording_is_loaded_and_its_messages_come_as_of_now(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: Client, begun: Begun) -> None:
        await viewer.until(lambda: viewer.session.get("recordings") == ["session.mcap"])
        await viewer.load()
        assert viewer.scene == "lab"
        assert viewer.replay["file"] == "session.mcap"
        assert viewer.replay["duration_s"] == pytest.approx(SESSION_S, abs=0.2)
        await viewer.done(clock={"speed": 20})
        await viewer.until(lambda: viewer.is_at_end)
        await asyncio.to_thread(client.wait_for, lambda _: len(of_lab(client)) >= len(sent))
        assert begun.names == ["test"]

    async def checked(viewer: Viewer, client: Client, begun: Begun) -> None:
        before_ns = WallClock().now_ns()
        await act(viewer, client, begun)
        heard = of_lab(client)
        assert Counter(m.topic for m in heard) == Counter(m.topic for m in sent)
        shifts = shifts_ns(heard, sent)
        assert len(shifts) > 300
        for was_ns, shift_ns in shifts:
            assert before_ns <= was_ns + shift_ns <= WallClock().now_ns() + NS
        batches = [m.payload for m in heard if m.topic == "lab/lab/plots"]
        batch = next(b for b in map(pb.PlotBatch.FromString, batches) if b.plots)
        assert before_ns - NS < batch.plots[0].time_utc_ns < WallClock().now_ns()
        await viewer.until(lambda: any(len(f.of(SectionKind.PLOTS)) for f in viewer.frames))

    await play(checked)


@pytest.mark.asyncio
async def test_twice_the_speed_is_twice_the_recorded_time(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: Client, _begun: Begun) -> None:
        await viewer.load()
        await viewer.done(replay={"speed": 2})
        since = len(client.heard)
        await viewer.until(lambda: len(shifts_ns(of_lab(client, since), sent)) > 60)
        shifts = shifts_ns(of_lab(client, since), sent)[20:]
        for (was_a, shift_a), (was_b, shift_b) in pairwise(shifts):
            # Half of the recorded time, the rest of it is in the shift.
            assert abs((shift_b - shift_a) + (was_b - was_a) / 2) < 1000
        assert viewer.session["clock"] == {"kind": "replay", "paused": False, "speed": 2.0}

    await play(act)


@pytest.mark.asyncio
async def test_a_seek_back_brings_the_same_again_and_one_ahead_leaves_some_out(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: Client, _begun: Begun) -> None:
        await viewer.load()
        await viewer.until(lambda: viewer.replay["position_s"] >= 2.0)
        await viewer.done(replay={"paused": True})
        await asyncio.sleep(0.3)
        since, from_ns = len(client.heard), sent[0].log_time_ns + NS
        before = {was_ns for was_ns, _ in shifts_ns(of_lab(client), sent)}
        assert (await viewer.done(replay={"position_s": 1.0}))["paused"]
        await viewer.done(replay={"paused": False})
        await viewer.until(lambda: len(shifts_ns(of_lab(client, since), sent)) > 20)
        again = [was_ns for was_ns, _ in shifts_ns(of_lab(client, since), sent)]
        wanted = sorted(at_ns for at_ns in recorded_ns(sent).values() if at_ns >= from_ns)
        assert again[:20] == wanted[:20]
        assert before >= set(wanted[:20])
        since = len(client.heard)
        await viewer.done(replay={"skip_s": 10.0})
        first_ns = sent[0].log_time_ns

        def times_ns() -> list[int]:
            return [was_ns - first_ns for was_ns, _ in shifts_ns(of_lab(client, since), sent)]

        await viewer.until(lambda: [t for t in times_ns() if t > 11 * NS])
        assert not [t for t in times_ns() if 5 * NS < t < 11 * NS]

    await play(act)


@pytest.mark.asyncio
async def test_a_pause_holds_everything_until_it_goes_on(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: Client, _begun: Begun) -> None:
        await viewer.load()
        await viewer.done(clock={"paused": True, "speed": 1})
        await viewer.until(lambda: viewer.session["clock"]["paused"])
        await asyncio.sleep(0.3)
        heard, position_s = len(client.heard), viewer.replay["position_s"]
        viewer.frames.clear()
        await viewer.until(lambda: len(viewer.frames) > 10)
        assert len(client.heard) == heard
        assert len({frame.now_ms for frame in viewer.frames}) == 1
        assert viewer.replay["position_s"] == position_s
        # It can be moved along, and shows what there was, but sends nothing.
        await viewer.done(replay={"position_s": 8.0})
        await viewer.until(lambda: viewer.replay["position_s"] == 8.0)
        await viewer.until(lambda: viewer.frames[-1].is_snapshot)
        assert len(viewer.frames[-1].column(SectionKind.PLOTS, "sensor")) > 10
        await viewer.until(lambda: len({frame.now_ms for frame in viewer.frames[-5:]}) == 1)
        assert len(client.heard) == heard
        await viewer.done(replay={"paused": False})
        await asyncio.to_thread(client.wait_for, has_id_of, heard)
        times = [was_ns for was_ns, _ in shifts_ns(of_lab(client, heard), sent)]
        assert min(times) >= sent[0].log_time_ns + 8 * NS

    def has_id_of(message: Heard) -> bool:
        return message.topic.startswith("lab/") and "id" in message.user_properties

    await play(act)


@pytest.mark.asyncio
async def test_a_recording_lasts_as_long_as_anything_in_it(
    play: Callable[[Act], Any], folder: Path, record: Path
) -> None:
    """Its last message need not be one that is sent again, as the ledger is not."""
    with McapReader(record) as log:
        attachment, first = log.attachment("scene.toml"), list(log.messages())[:40]
    assert attachment is not None
    last = replace(
        first[-1], topic="lab/truth", payload=b"", log_time_ns=first[-1].log_time_ns + NS
    )
    with (folder / "silent.mcap").open("wb") as file:
        log_writer = McapWriter(file, attachments=[attachment], library="plotfeed test")
        for message in (*first, last):
            log_writer.write(message)
        log_writer.close()

    async def act(viewer: Viewer, _client: Client, _begun: Begun) -> None:
        await viewer.load("silent.mcap")
        await viewer.until(lambda: viewer.is_at_end)
        assert viewer.replay["duration_s"] > 1.0
        await viewer.done(replay={"paused": False})
        await viewer.until(lambda: 0 < viewer.replay["position_s"] < 0.9)

    await play(act)


@pytest.mark.asyncio
async def test_at_its_end_it_stands_and_can_be_moved_back_or_played_again(
    play: Callable[[Act], Any],
) -> None:
    async def act(viewer: Viewer, client: Client, _begun: Begun) -> None:
        await viewer.load()
        await viewer.done(replay={"position_s": 1e6})
        await viewer.until(lambda: viewer.is_at_end)
        heard = len(of_lab(client))
        await viewer.done(replay={"position_s": 2.0})
        assert viewer.session["clock"]["paused"]
        await viewer.done(replay={"position_s": SESSION_S - 1})
        await viewer.until(lambda: viewer.replay["position_s"] == SESSION_S - 1)
        await viewer.done(replay={"paused": False})
        await viewer.until(lambda: viewer.is_at_end)
        assert len(of_lab(client)) > heard
        await viewer.done(replay={"paused": False})  # once more from the beginning
        await viewer.until(lambda: 0 < viewer.replay["position_s"] < 5)

    await play(act)


@pytest.mark.parametrize(
    "leave", [{"session": {"restart": True}}, {"replay": {"stop": True}}], ids=str
)
@pytest.mark.asyncio
async def test_leaving_goes_back_to_a_session(
    play: Callable[[Act], Any], leave: dict[str, Any]
) -> None:
    async def act(viewer: Viewer, client: Client, begun: Begun) -> None:
        await viewer.load()
        begun.waiting.clear()
        await viewer.done(**leave)
        await begun.wait()
        since = len(client.heard)
        await viewer.until(lambda: viewer.scene == "test" and not viewer.replay)
        assert viewer.session["clock"]["kind"] == "wall"
        assert viewer.session["notes"] == []
        topic = "plotfeed/radar/plots"
        await asyncio.to_thread(client.wait_for, lambda m: m.topic == topic, since)
        assert not [m for m in of_lab(client, since) if not m.retained]

    assert await play(act) == ["test", "test"]


@pytest.mark.asyncio
async def test_another_scene_or_recording_takes_the_place_of_a_replay(
    play: Callable[[Act], Any], folder: Path
) -> None:
    async def act(viewer: Viewer, _client: Client, begun: Begun) -> None:
        (folder / "again.mcap").write_bytes((folder / "session.mcap").read_bytes())
        await viewer.load()
        await viewer.done(replay={"load": "again.mcap"})
        await viewer.until(lambda: viewer.replay["file"] == "again.mcap")
        begun.waiting.clear()
        await viewer.done(session={"scene": "section-4"})
        await begun.wait()
        await viewer.until(lambda: viewer.scene == "section-4")

    assert await play(act) == ["test", "section-4"]


@pytest.mark.asyncio
async def test_what_the_page_itself_recorded_is_replayed_with_the_settings_of_then(
    play: Callable[[Act], Any],
) -> None:
    async def act(viewer: Viewer, client: Client, begun: Begun) -> None:
        await viewer.done(sensor="radar", set={"pfa": 1e-4})
        file = (await viewer.done(record={"start": True}))["file"]
        await asyncio.to_thread(client.wait_for, lambda _: len(client.on("plotfeed/truth")) > 30)
        assert file not in viewer.session["recordings"]
        await viewer.done(record={"stop": True})
        await viewer.until(lambda: file in viewer.session["recordings"])
        await viewer.load(file)
        told: dict[str, Any] = {}
        for frame in viewer.frames:
            told |= frame.news
        assert told["settings"]["radar"]["pfa"] == 1e-4
        assert begun.names == ["test"]

    await play(act)


@pytest.mark.asyncio
async def test_what_makes_no_sense_in_a_replay_is_refused(play: Callable[[Act], Any]) -> None:
    async def act(viewer: Viewer, _client: Client, _begun: Begun) -> None:
        await viewer.load()
        for command in (
            {"sensor": "lab", "set": {"pfa": 1e-5}},
            {"sensor": "lab", "reset": True},
            {"record": {"start": True}},
            {"clock": {"step_s": 1}},
        ):
            assert (await viewer.ask(**command))["error"] == NOT_NOW
        assert viewer.session["refuses"] == dict.fromkeys(("sensor", "step", "record"), NOT_NOW)
        assert any("Times" in note for note in viewer.session["notes"])
        for wish, words in (
            ({"speed": 0}, "expected 0.001 to 10000"),
            ({"speed": "fast"}, "expected a number"),
            ({"paused": 1}, "expected true or false"),
            ({"position_s": None}, "expected a number"),
            ({"position_s": float("nan")}, "expected a number"),
            ({"skip_s": 10**400}, "expected a number"),
            ({"skip_s": 1, "file": "x.mcap"}, "expected load"),
            ({"paused": True, "speed": 0}, "expected 0.001 to 10000"),
            ({}, "expected load"),
            (5, "expected load"),
        ):
            answer = await viewer.ask(replay=wish)
            assert not answer["ok"]
            assert words in answer["error"]
        assert not viewer.replay["paused"]

    await play(act)


@pytest.mark.asyncio
async def test_what_cannot_be_replayed_is_refused_and_the_session_goes_on(
    play: Callable[[Act], Any], folder: Path
) -> None:
    whole = (folder / "session.mcap").read_bytes()
    (folder / "live" / "beside.mcap").write_bytes(whole)
    (folder / "cut.mcap").write_bytes(whole[: len(whole) // 60])
    (folder / "foreign.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    (folder / "text.toml").write_text("")

    async def act(viewer: Viewer, _client: Client, _begun: Begun) -> None:
        for name in (
            "live/beside.mcap",
            "../session.mcap",
            str(folder / "session.mcap"),
            "./session.mcap",
            "text.toml",
            "foreign.mcap",
            "nothing.mcap",
            "",
            5,
            None,
            ["session.mcap"],
            "x" * 1000,
        ):
            answer = await viewer.ask(replay={"load": name})
            assert answer["ok"] is False
            assert "there is no recording" in answer["error"]
            assert len(answer["error"]) < 150
        answer = await viewer.ask(replay={"load": "cut.mcap"})
        assert answer["error"].startswith("cut.mcap: ")
        for wish in ({"paused": True}, {"stop": True}, {"position_s": 5}):
            assert (await viewer.ask(replay=wish))["error"] == "replay: none runs"
        await viewer.until(lambda: len(viewer.frames) > 5)
        assert not viewer.replay

    assert await play(act) == ["test"]


@pytest.mark.asyncio
async def test_after_a_replay_that_fails_a_session_says_so(
    play: Callable[[Act], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def torn(_path: Path) -> McapReader:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(page_replay, "McapReader", torn)

    async def act(viewer: Viewer, _client: Client, begun: Begun) -> None:
        begun.waiting.clear()
        await viewer.done(replay={"load": "session.mcap"})
        await begun.wait()
        await viewer.until(lambda: viewer.session.get("notes"))
        assert viewer.session["notes"] == ["The replay has ended: Input/output error"]
        assert viewer.session["replay"] == {}

    assert await play(act) == ["test", "test"]


@pytest.mark.asyncio
async def test_tracks_that_are_published_now_are_shown_in_recorded_time(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: Client, _begun: Begun) -> None:
        await viewer.load()
        await viewer.done(replay={"position_s": 9.0})
        track = {"track": 4, "latitude_deg": 40.46, "longitude_deg": -3.72}
        shown = lambda: [f for f in viewer.frames if len(f.of(SectionKind.TRACKS))]  # noqa: E731
        while not shown():
            client.publish(TRACKS, json.dumps(track).encode())
            count = len(viewer.frames)
            await viewer.until(lambda: len(viewer.frames) > count)  # noqa: B023
        t_ms = shown()[-1].column(SectionKind.TRACKS, "t_utc_ms")[0] - sent[0].log_time_ns / 1e6
        assert 0 <= t_ms <= SESSION_S * 1e3

    await play(act)
