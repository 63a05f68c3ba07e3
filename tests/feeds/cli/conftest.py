from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.brokers import free_port, own_broker


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[int]:
    port = free_port()
    with own_broker(tmp_path, port):
        yield port
