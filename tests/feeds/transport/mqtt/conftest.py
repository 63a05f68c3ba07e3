from __future__ import annotations

import pytest

from plotfeed.feeds.transport.mqtt import client


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "BACKOFF_S", (0.01,))
