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


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """A file of a flight of 0.8 seconds, 1.1 km north of the site of tests."""
    path = tmp_path / "flight.csv"
    rows = [f"{1767268800 + i / 10},{40.46 + i * 1e-6},-3.73,700" for i in range(8)]
    path.write_text("\n".join(["time_s,latitude_deg,longitude_deg,altitude_m", *rows, ""]))
    return path
