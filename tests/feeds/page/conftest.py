from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from support import made_up_session, road
from support.chromium import chromium, looking
from support.made_up_session import MadeUpSession
from support.page_server import Served, on_stage

from plotfeed.feeds.page.view import View

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture
def stage() -> MadeUpSession:
    stage = MadeUpSession(View(), made_up_session.scene(16))
    for _ in range(40):
        stage.advance(stage.now_ns + road.NS // 10)
    return stage


@pytest.fixture
def served(stage: MadeUpSession) -> Iterator[Served]:
    with on_stage(stage) as served:
        yield served


@pytest.fixture
def page(browser: Browser, served: Served) -> Iterator[Page]:
    with looking(browser, served.url) as page:
        yield page
