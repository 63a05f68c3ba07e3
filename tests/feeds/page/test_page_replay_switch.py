"""Recordings that take a session's place on the page, or may not, and what comes after them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.page_replays import Act, Begun, Viewer, of_lab
from support.waiting import until

from plotfeed.feeds.page import page_replay
from plotfeed.feeds.page.page_replay import NOT_NOW, REFUSES
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.testing import MqttMessage, MqttReceiver


@pytest.mark.parametrize(
    "leave", [{"session": {"restart": True}}, {"replay": {"stop": True}}], ids=str
)
@pytest.mark.asyncio
async def test_leaving_goes_back_to_a_session(
    play: Callable[[Act], Any], leave: dict[str, Any]
) -> None:
    async def act(viewer: Viewer, client: MqttReceiver, begun: Begun) -> None:
        await viewer.load()
        begun.waiting.clear()
        await viewer.done(**leave)
        await begun.wait()
        await viewer.until(lambda: viewer.scene == "test" and not viewer.replay)
        assert viewer.session["clock"]["kind"] == "wall"
        assert viewer.session["notes"] == []
        for _ in range(2):  # from the first of the session's messages to another
            since = len(client.heard)
            await until(lambda: of_session(client, since))  # noqa: B023 - at once
        assert not [m for m in of_lab(client, since) if not m.retained]

    assert await play(act) == ["test", "test"]


def of_session(client: MqttReceiver, since: int) -> list[MqttMessage]:
    return [m for m in client.heard[since:] if m.topic == "plotfeed/radar/plots"]


@pytest.mark.asyncio
async def test_another_scene_or_recording_takes_the_place_of_a_replay(
    play: Callable[[Act], Any], folder: Path
) -> None:
    async def act(viewer: Viewer, _client: MqttReceiver, begun: Begun) -> None:
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
    async def act(viewer: Viewer, client: MqttReceiver, begun: Begun) -> None:
        await viewer.done(sensor="radar", set={"pfa": 1e-4})
        file = (await viewer.done(record={"start": True}))["file"]
        await until(lambda: len(client.on("plotfeed/truth")) > 30)
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
    async def act(viewer: Viewer, _client: MqttReceiver, _begun: Begun) -> None:
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

    async def act(viewer: Viewer, _client: MqttReceiver, _begun: Begun) -> None:
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

    async def act(viewer: Viewer, _client: MqttReceiver, begun: Begun) -> None:
        begun.waiting.clear()
        await viewer.done(replay={"load": "session.mcap"})
        await begun.wait()
        await viewer.until(lambda: viewer.session.get("notes"))
        assert viewer.session["notes"] == ["The replay has ended: Input/output error"]
        assert viewer.session["replay"] == {}

    assert await play(act) == ["test", "test"]
