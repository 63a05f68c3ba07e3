from __future__ import annotations

import pytest

from plotfeed.feeds.transport import ways_out


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ways_out, "BACKOFF_S", (0.01,))
