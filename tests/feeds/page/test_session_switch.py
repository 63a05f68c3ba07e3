"""What viewers want of whole sessions and of recordings, asked over the page's own WebSocket.

Sessions are real ones, and what is sent is measured on a broker.
"""

from __future__ import annotations

import asyncio
import io
import json
import os
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from support.page_replays import SESSION_S, TRACKS, Act, Begun, Viewer, of_lab
from support.page_updates import news_of
from support.recordings import mcap_of
from support.waiting import until

from plotfeed.feeds.page import page_replay
from plotfeed.feeds.page.page_replay import NOT_NOW, REFUSES
from plotfeed.feeds.page.page_sessions import MAX_LISTED, new_path, recordings_in
from plotfeed.feeds.page.updates import SectionKind
from plotfeed.feeds.replaying.replay_settings import ReplaySettings
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Recorded
from plotfeed.testing import MqttReceiver

NS = 1_000_000_000
Play = Callable[[Act], Any]


@pytest.fixture(scope="module")
def sent(record: Path) -> list[Recorded]:
    """What a replay sends of it."""
    takes = ReplaySettings().takes
    with McapReader(record) as log:
        return [m for m in log.messages() if takes(m.topic, m.content_type, m.stage)]


REFUSED: tuple[tuple[dict[str, Any], str], ...] = (
    ({"session": {"scene": "nowhere"}}, "there is no 'nowhere'"),
    ({"session": {}}, "expected restart or scene"),
    ({"session": 5}, "expected restart or scene"),
    ({"record": {"stop": True}}, "none runs"),
    ({"record": {}}, "expected start or stop"),
    ({"replay": {"file": "x.mcap"}}, "expected load"),
    *(({"replay": wish}, "replay: none runs") for wish in ({"paused": 1}, {"stop": 1})),
    ({"clock": {"paused": True}}, "real time cannot be held"),
    ({"sensor": "nobody", "set": {}}, "there is no 'nobody'"),
)
NO_RECORDINGS = (
    *("live/beside.mcap", "../session.mcap", "./session.mcap", "text.toml", "foreign.mcap"),
    *("nothing.mcap", "", 5, None, ["session.mcap"], "x" * 1000),
)


def test_what_cannot_be_done_is_said_and_the_session_goes_on(play: Play, folder: Path) -> None:
    whole = (folder / "session.mcap").read_bytes()
    (folder / "live" / "beside.mcap").write_bytes(whole)
    (folder / "cut.mcap").write_bytes(whole[: len(whole) // 60])
    (folder / "foreign.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    (folder / "text.toml").write_text("")

    async def act(viewer: Viewer, _client: MqttReceiver, _begun: Begun) -> None:
        for command, words in REFUSED:
            answer = await viewer.ask(**command)
            assert not answer["ok"], command
            assert words in answer["error"]
        for name in (*NO_RECORDINGS, str(folder / "session.mcap")):
            answer = await viewer.ask(replay={"load": name})
            assert answer["ok"] is False
            assert "there is no recording" in answer["error"]
            assert len(answer["error"]) < 150
        answer = await viewer.ask(replay={"load": "cut.mcap"})
        assert answer["error"].startswith("cut.mcap: ")
        await viewer.until(lambda: len(viewer.frames) > 5)
        assert not viewer.replay

    assert play(act) == ["test"]


def test_a_recording_of_the_running_session_is_whole_and_replayed_with_the_settings_of_then(
    play: Play, folder: Path
) -> None:
    async def act(viewer: Viewer, client: MqttReceiver, begun: Begun) -> None:
        for wish in ({"restart": True}, {"scene": "live"}):
            begun.waiting.clear()
            await viewer.done(session=wish)
            await begun.wait()
        await viewer.done(sensor="radar", set={"pfa": 1e-4})
        file = (await viewer.done(record={"start": True}))["file"]
        assert not (await viewer.ask(record={"start": True}))["ok"]
        so_far = len(client.on("plotfeed/truth"))
        await until(lambda: len(client.on("plotfeed/truth")) > so_far + 30)
        await viewer.until(lambda: viewer.session["record"].get("seconds", 0) > 0)
        assert file not in viewer.session["recordings"]
        await viewer.done(record={"stop": True})
        with McapReader(folder / file) as log:
            assert not log.damage
            assert [entry.name for entry in log.attachments()] == ["scene.toml"]
            recorded = [m.payload for m in log.messages() if m.topic == "plotfeed/truth"]
        heard = client.on("plotfeed/truth")
        first = heard.index(recorded[0])
        await until(lambda: len(client.on("plotfeed/truth")) >= first + len(recorded))
        heard = client.on("plotfeed/truth")[first:]
        assert recorded == heard[: len(recorded)]  # message after message, without a gap
        await viewer.until(lambda: file in viewer.session["recordings"])
        await viewer.load(file)
        assert news_of(viewer.frames)["settings"]["radar"]["pfa"] == 1e-4

    assert play(act) == ["test", "test", "test"]


def test_recordings_of_one_second_have_names_of_their_own(tmp_path: Path) -> None:
    at, names = datetime(2026, 1, 1, 12, tzinfo=UTC), []
    for _ in range(3):
        path = new_path(tmp_path, "road", at)
        names.append(path.name)
        path.touch()
    stem = "road-20260101T120000Z"
    assert names == [f"{stem}.mcap", f"{stem}-2.mcap", f"{stem}-3.mcap"]


def test_recordings_are_plotfeed_s_own_the_newest_first_and_not_too_many(tmp_path: Path) -> None:
    for number in range(MAX_LISTED + 5):
        path = tmp_path / f"{number:03}.mcap"
        path.write_bytes(mcap_of([]))
        os.utime(path, ns=(0, number * NS))
    foreign = io.BytesIO()
    writer = Writer(foreign)
    writer.start(library="another")
    writer.finish()
    for name, content in {
        "foreign.mcap": foreign.getvalue(),
        "nothing.mcap": b"",
        "text.mcap": b"not a recording at all, but long enough to look like it",
        "other.txt": (tmp_path / "000.mcap").read_bytes(),
    }.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "folder.mcap").mkdir()
    newest = [f"{number:03}.mcap" for number in range(MAX_LISTED + 4, 4, -1)]
    assert list(recordings_in(tmp_path)) == newest
    assert recordings_in(tmp_path / "nowhere") == {}


def test_a_recording_comes_as_of_now_at_the_speed_that_is_asked_for(
    play: Play, sent: list[Recorded]
) -> None:
    """Tracks that are published meanwhile are shown in recorded time."""

    async def act(viewer: Viewer, client: MqttReceiver, _begun: Begun) -> None:
        before_ns = pb.SensorStatus().time_utc
        before_ns.GetCurrentTime()
        await viewer.until(lambda: viewer.session.get("recordings") == ["session.mcap"])
        await viewer.load()
        assert (viewer.scene, viewer.replay["file"]) == ("lab", "session.mcap")
        assert viewer.replay["duration_s"] == pytest.approx(SESSION_S, abs=0.2)
        await viewer.done(replay={"speed": 2})
        clock = {"kind": "replay", "paused": False, "speed": 2.0}
        await viewer.until(lambda: viewer.session["clock"] == clock)
        await viewer.done(clock={"speed": 20})
        await viewer.until(lambda: viewer.is_at_end)
        await until(lambda: len(of_lab(client)) >= len(sent))
        heard = of_lab(client)
        assert Counter(m.topic for m in heard) == Counter(m.topic for m in sent)
        batches = [pb.PlotBatch.FromString(m.payload) for m in heard if m.topic.endswith("/plots")]
        plot = next(plot for batch in batches for plot in batch.plots)
        assert plot.time_utc_ns > before_ns.ToNanoseconds() - NS
        await viewer.until(lambda: any(frame.of(SectionKind.PLOTS) for frame in viewer.frames))
        await viewer.done(replay={"position_s": 9.0})
        track = {"track": 4, "latitude_deg": 40.46, "longitude_deg": -3.72}

        def is_shown() -> bool:
            client.publish(TRACKS, json.dumps(track).encode())
            return bool(viewer.frames[-1].of(SectionKind.TRACKS))

        await viewer.until(is_shown)
        t_ms = viewer.frames[-1].column(SectionKind.TRACKS, "t_utc_ms")[0]
        assert 0 <= t_ms - sent[0].log_time_ns / 1e6 <= SESSION_S * 1e3

    assert play(act) == ["test"]


def test_a_pause_holds_everything_and_a_seek_goes_on_from_there(
    play: Play, sent: list[Recorded]
) -> None:
    first_ns, ends = sent[0].log_time_ns, ("/plots", "/048", "/034")
    ids = {(m.topic, dict(m.properties).get("id", "")): m for m in sent if m.topic.endswith(ends)}

    async def act(viewer: Viewer, client: MqttReceiver, _begun: Begun) -> None:
        def recorded_s(since: int) -> list[float]:
            """When each of what has come had been recorded, since the recording's beginning."""
            keys = ((m.topic, m.user_properties.get("id", "")) for m in of_lab(client, since))
            return [(ids[key].log_time_ns - first_ns) / NS for key in keys if key in ids]

        await viewer.load()
        await viewer.until(lambda: viewer.replay["position_s"] >= 2.0)
        await viewer.done(clock={"paused": True, "speed": 1})
        await viewer.until(lambda: viewer.session["clock"]["paused"])
        heard, position_s = await viewer.settled(client), viewer.replay["position_s"]
        viewer.frames.clear()
        await viewer.until(lambda: len(viewer.frames) > 10)
        (now_ms,) = {frame.now_ms for frame in viewer.frames}
        assert now_ms - first_ns / 1e6 == pytest.approx(1e3 * position_s, abs=60.0)  # to a tenth
        assert viewer.replay["position_s"] == position_s
        # It can be moved along, and shows what there was, but sends nothing.
        for second in (4.0, 6.0, 8.0):  # as by a slider: the last one counts
            await viewer.done(replay={"position_s": second})
        await viewer.until(lambda: viewer.replay["position_s"] == 8.0)
        await viewer.until(lambda: viewer.frames[-1].is_snapshot)
        assert len(viewer.frames[-1].column(SectionKind.PLOTS, "sensor")) > 10
        await viewer.until(lambda: len({frame.now_ms for frame in viewer.frames[-5:]}) == 1)
        assert len(client.heard) == heard
        assert (await viewer.done(replay={"position_s": 1.0}))["paused"]
        await viewer.done(replay={"paused": False})
        await viewer.until(lambda: len(recorded_s(heard)) > 20)  # the same again
        times_s = [(m.log_time_ns - first_ns) / NS for m in ids.values()]
        assert recorded_s(heard)[:20] == [t_s for t_s in sorted(times_s) if t_s >= 1.0][:20]
        heard = len(client.heard)
        to_s = (await viewer.done(replay={"skip_s": 10.0}))["position_s"]  # to a tenth
        assert to_s >= 11.0
        await viewer.until(lambda: [t_s for t_s in recorded_s(heard) if t_s > to_s])
        assert not [t_s for t_s in recorded_s(heard) if -9.8 < t_s - to_s < -0.2]

    play(act)


def test_at_its_end_a_replay_stands_and_can_be_moved_back_or_played_again(
    play: Play, folder: Path, record: Path
) -> None:
    """It lasts as long as anything in it, though its last message is not one that is sent again."""
    with McapReader(record) as log:
        attachment, first = log.attachment("scene.toml"), list(log.messages())[:40]
    assert attachment is not None
    end_ns = first[-1].log_time_ns + NS
    last = first[-1]._replace(topic="lab/truth", payload=b"", log_time_ns=end_ns)
    (folder / "silent.mcap").write_bytes(mcap_of([*first, last], attachments=[attachment]))

    async def act(viewer: Viewer, client: MqttReceiver, _begun: Begun) -> None:
        await viewer.load("silent.mcap")
        await viewer.until(lambda: viewer.is_at_end)
        assert viewer.replay["duration_s"] > 1.0
        await viewer.settled(client)
        heard = len(of_lab(client))
        await viewer.done(replay={"paused": False})  # once more, however soon it is over
        await viewer.until(lambda: len(of_lab(client)) > heard)
        await viewer.load()
        await viewer.done(replay={"position_s": 1e6})
        await viewer.until(lambda: viewer.is_at_end)
        await viewer.settled(client)
        heard = len(of_lab(client))
        await viewer.done(replay={"position_s": 2.0})
        assert viewer.session["clock"]["paused"]
        await viewer.done(replay={"position_s": SESSION_S - 1})
        await viewer.until(lambda: viewer.replay["position_s"] == SESSION_S - 1)
        await viewer.done(replay={"paused": False})
        await viewer.until(lambda: viewer.is_at_end)
        await viewer.until(lambda: len(of_lab(client)) > heard)
        await viewer.done(replay={"paused": False})  # once more from the beginning
        await viewer.until(lambda: 0 < viewer.replay["position_s"] < SESSION_S - 1)

    play(act)


WRONG_IN_A_REPLAY: tuple[tuple[Any, str], ...] = (
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
)


def test_what_makes_no_sense_in_a_replay_is_refused_and_leaving_goes_back_to_a_session(
    play: Play, folder: Path
) -> None:
    (folder / "again.mcap").write_bytes((folder / "session.mcap").read_bytes())

    async def act(viewer: Viewer, client: MqttReceiver, begun: Begun) -> None:
        await viewer.load()
        for command in (
            {"sensor": "lab", "set": {"pfa": 1e-5}},
            {"sensor": "lab", "reset": True},
            {"story": "outage"},
            {"undo": True},
            {"record": {"start": True}},
            {"clock": {"step_s": 1}},
        ):
            assert (await viewer.ask(**command))["error"] == NOT_NOW
        assert viewer.session["refuses"] == dict.fromkeys(REFUSES, NOT_NOW)
        assert any("Times" in note for note in viewer.session["notes"])
        for wish, words in WRONG_IN_A_REPLAY:
            answer = await viewer.ask(replay=wish)
            assert not answer["ok"]
            assert words in answer["error"]
        assert not viewer.replay["paused"]
        await viewer.done(replay={"load": "again.mcap"})
        await viewer.until(lambda: viewer.replay["file"] == "again.mcap")
        begun.waiting.clear()
        await viewer.done(replay={"stop": True})
        await begun.wait()
        await viewer.until(lambda: viewer.scene == "test" and not viewer.replay)
        assert viewer.session["clock"]["kind"] == "wall"
        assert viewer.session["notes"] == []
        for _ in range(2):  # from the first of the session's messages to another
            since = len(client.heard)
            is_plots = lambda m: m.topic == "plotfeed/radar/plots"  # noqa: E731
            await asyncio.to_thread(client.wait_for, is_plots, since)
        assert not [m for m in of_lab(client, since) if not m.retained]
        await viewer.load()
        begun.waiting.clear()
        await viewer.done(session={"scene": "section-4"})
        await begun.wait()
        await viewer.until(lambda: viewer.scene == "section-4")

    assert play(act) == ["test", "test", "section-4"]


def test_after_a_replay_that_fails_a_session_says_so(
    play: Play, monkeypatch: pytest.MonkeyPatch
) -> None:
    def torn(_path: Path) -> McapReader:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(page_replay, "McapReader", torn)

    async def act(viewer: Viewer, _client: MqttReceiver, begun: Begun) -> None:
        begun.waiting.clear()
        await viewer.done(replay={"load": "session.mcap"})
        await begun.wait()
        await viewer.until(lambda: viewer.session.get("notes"))
        assert viewer.session["notes"] == ["The replay has ended: Input/output error"]
        assert viewer.session["replay"] == {}

    assert play(act) == ["test", "test"]
