"""Ray is started on loopback alone, and what hinders it is told in a line."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from plotfeed.feeds.console import extras
from plotfeed.feeds.lab.runs import EngineError, connected
from plotfeed.proto.errors import PlotfeedError

STARTED = """
import json
from plotfeed.feeds.lab.runs import connected

with connected(None, 2) as ray:
    (node,) = ray.nodes()
    found = ray.get(ray.remote(lambda: 6 * 7).remote())
    print(json.dumps([found, node["NodeManagerAddress"], ray.cluster_resources()["CPU"]]))
print(json.dumps(ray.is_initialized()))
"""


def test_ray_works_on_loopback_and_is_gone_afterwards() -> None:
    pytest.importorskip("ray")
    done = subprocess.run(
        [sys.executable, "-c", STARTED], capture_output=True, text=True, timeout=600, check=False
    )
    if "Ray cannot be started" in done.stderr:  # a machine that is far too busy
        pytest.skip("Ray cannot be started here")
    assert done.returncode == 0, done.stderr
    found, gone = map(json.loads, done.stdout.splitlines())
    assert found == [42, "127.0.0.1", 2.0]
    assert gone is False


def test_where_ray_is_not_installed_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    with pytest.raises(PlotfeedError, match=r"plotfeed\[fleet\]"), connected(None, 1):
        pass


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "127.0.0.1:ray"])
def test_a_cluster_that_is_not_there_is_told_of(address: str) -> None:
    pytest.importorskip("ray")
    said = r"^Ray.*(does not answer|expected HOST:PORT)"
    with pytest.raises(EngineError, match=said), connected(address, None):
        pass
