"""No process for each of these tests: what is tried here is what readers find, not where."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.read_here import found_here

from plotfeed.feeds.telemetry.flights import autopilot_logs, markup


@pytest.fixture(autouse=True, scope="package")
def read_here() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for module in (autopilot_logs, markup):
            patch.setattr(module, "read_apart", found_here)
        yield
