"""What the page's viewers want of whole sessions, asked over its own WebSocket of real runs."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from support.page_replays import Begun, Viewer, with_page
from support.scene_files import scene_file, scene_text

from plotfeed.feeds.page.session_switch import new_path, recordings_in
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.replay.mcap.mcap_reader import McapReader


async def staged(scene: Scene, play: Any) -> list[str]:
    """The names of the scenes that ran while `play(viewer, begun)` did."""
    async with with_page(scene) as (feed, begun):
        await play(Viewer(feed), begun)
    return begun.names


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    monkeypatch.chdir(tmp_path)
    return load(scene_file(tmp_path, scene_text()))


@pytest.mark.asyncio
async def test_a_session_is_restarted_and_another_scene_chosen(scene: Scene) -> None:
    async def play(viewer: Viewer, begun: Begun) -> None:
        for wish in ({"restart": True}, {"scene": "section-4"}):
            begun.waiting.clear()
            assert (await viewer.ask(session=wish))["ok"]
            await begun.wait()

    names = await staged(scene, play)
    assert names == [scene.scene.name, scene.scene.name, "section-4"]


@pytest.mark.asyncio
async def test_a_recording_of_the_running_session_is_whole(scene: Scene, tmp_path: Path) -> None:
    async def play(viewer: Viewer, _begun: Begun) -> None:
        started = await viewer.ask(record={"start": True})
        assert started["ok"]
        assert not (await viewer.ask(record={"start": True}))["ok"]
        await viewer.until(lambda: viewer.session["record"].get("seconds", 0) > 0.2)
        assert (await viewer.ask(record={"stop": True}))["ok"]
        path = tmp_path / started["in_force"]["file"]
        with McapReader(path) as log:
            assert log.summary().messages > 0
            assert not log.damage
            assert [entry.name for entry in log.attachments()] == ["scene.toml"]

    await staged(scene, play)


@pytest.mark.asyncio
async def test_recordings_of_one_second_have_names_of_their_own(
    scene: Scene, tmp_path: Path
) -> None:
    async def play(viewer: Viewer, _begun: Begun) -> None:
        for _ in range(3):
            assert (await viewer.ask(record={"start": True}))["ok"]
            assert (await viewer.ask(record={"stop": True}))["ok"]

    await staged(scene, play)
    assert len(recordings_in(tmp_path)) == 3
    at = datetime(2026, 1, 1, 12, tzinfo=UTC)
    names = []
    for _ in range(3):
        path = new_path(tmp_path, "road", at)
        names.append(path.name)
        path.touch()
    stem = "road-20260101T120000Z"
    assert names == [f"{stem}.mcap", f"{stem}-2.mcap", f"{stem}-3.mcap"]


REFUSED: tuple[tuple[dict[str, Any], str], ...] = (
    ({"session": {"scene": "nowhere"}}, "there is no 'nowhere'"),
    ({"session": {}}, "expected restart or scene"),
    ({"session": 5}, "expected restart or scene"),
    ({"record": {"stop": True}}, "none runs"),
    ({"record": {}}, "expected start or stop"),
    ({"replay": {"file": "x.mcap"}}, "expected load"),
    ({"replay": {"load": "x.mcap"}}, "there is no recording 'x.mcap'"),
    ({"replay": {"paused": True}}, "none runs"),
    ({"clock": {"paused": True}}, "real time cannot be held"),
    ({"sensor": "nobody", "set": {}}, "there is no 'nobody'"),
)


@pytest.mark.asyncio
async def test_what_cannot_be_done_is_said_and_the_session_goes_on(scene: Scene) -> None:
    async def play(viewer: Viewer, _begun: Begun) -> None:
        for command, words in REFUSED:
            answer = await viewer.ask(**command)
            assert not answer["ok"], command
            assert words in answer["error"]

    assert len(await staged(scene, play)) == 1
