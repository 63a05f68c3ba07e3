from __future__ import annotations

import pytest

from plotfeed.feeds.transport import patience


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patience, "BACKOFF_S", (0.01,))
