from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from support import made_up_session
from support.brokers import free_port, mosquitto
from support.chromium import chromium, looking
from support.command import plotfeed
from support.made_up_session import MadeUpSession
from support.page_replays import SESSION_S, TRACKS, Act, Viewer, with_page
from support.page_server import Served, on_stage
from support.scene_files import radar, scene_text

from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.scene import load
from plotfeed.proto.utc import NS
from plotfeed.testing import MqttReceiver

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture
def stage() -> MadeUpSession:
    """After four seconds, at which its time stands: on any machine there is the same to see."""
    stage = MadeUpSession(View(), made_up_session.scene(16))
    for _ in range(40):
        stage.advance(stage.now_ns + NS // 10)
    stage.stand()
    return stage


@pytest.fixture
def served(stage: MadeUpSession) -> Iterator[Served]:
    with on_stage(stage) as served:
        yield served


@pytest.fixture
def goes_on(served: Served, stage: MadeUpSession) -> None:
    """Its time runs, for tests of what that brings."""
    served.call(lambda: stage.stand(paused=False))


@pytest.fixture
def page(browser: Browser, served: Served) -> Iterator[Page]:
    with looking(browser, served.url) as page:
        yield page


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
        client = await asyncio.to_thread(MqttReceiver, port, 5, "lab/#", "plotfeed/#")
        try:
            async with with_page(load(scene), f"mqtt://127.0.0.1:{port}") as (feed, begun):
                await act(Viewer(feed), client, begun)
                return begun.names
        finally:
            await asyncio.to_thread(client.close)

    with mosquitto(tmp_path_factory.mktemp("broker"), port):
        yield lambda act: asyncio.run(run(act))
