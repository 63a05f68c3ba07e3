from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from support import page_stage, road
from support.chromium import chromium, looking
from support.page_server import Served, on_stage
from support.page_stage import Stage

from plotfeed.feeds.page.view import View

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture
def stage() -> Stage:
    stage = Stage(View(), page_stage.scene(16))
    for _ in range(40):
        stage.advance(stage.now_ns + road.NS // 10)
    return stage


@pytest.fixture
def served(stage: Stage) -> Iterator[Served]:
    with on_stage(stage) as served:
        yield served


@pytest.fixture
def page(browser: Browser, served: Served) -> Iterator[Page]:
    with looking(browser, served.url) as page:
        yield page
