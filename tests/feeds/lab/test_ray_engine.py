"""What hinders a cluster of Ray is told in a line."""

from __future__ import annotations

import pytest

from plotfeed.feeds.console import extras
from plotfeed.feeds.lab.runs import EngineError, connected
from plotfeed.proto.errors import PlotfeedError


def test_where_ray_is_not_installed_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    with pytest.raises(PlotfeedError, match=r"plotfeed\[fleet\]"), connected("127.0.0.1:1"):
        pass


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "127.0.0.1:ray"])
def test_a_cluster_that_is_not_there_is_told_of(address: str) -> None:
    pytest.importorskip("ray")
    said = r"^Ray.*(does not answer|expected HOST:PORT)"
    with pytest.raises(EngineError, match=said), connected(address):
        pass
