from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.brokers import free_port, rumqttd


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[int]:
    port = free_port()
    with rumqttd(tmp_path, {"v5.1": ("127.0.0.1", port, "")}):
        yield port
