"""Parts as actors of Ray: it starts again what is killed, and `stop` ends all."""

from __future__ import annotations

import json
import logging
import os
import signal
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, mosquitto
from support.scene_files import DRONE, radar, scene_file, scene_text
from support.waiting import wait_until

from plotfeed.feeds.console.cluster import QUIET
from plotfeed.feeds.fleet.parts import start_of
from plotfeed.feeds.fleet.starters import start_parts, stop_parts
from plotfeed.feeds.scene.scene import load
from plotfeed.proto.errors import PlotfeedError
from plotfeed.testing import MqttReceiver

if find_spec("ray") is None:  # whose import takes long
    pytest.skip("could not import 'ray'", allow_module_level=True)


def test_ray_starts_a_part_again_whose_process_is_killed_and_ends_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RAY_AUTH_TOKEN", "f" * 64)
    port = free_port()
    scene = load(scene_file(tmp_path, scene_text(sensors=radar("a") + radar("b"), drones=DRONE)))
    asked: dict[str, Any] = {
        "parts": 2,
        "spares": 0,
        "start": start_of(None),
        "broker": f"mqtt://127.0.0.1:{port}",
        "duration_s": None,
    }
    with mosquitto(tmp_path, port), MqttReceiver(port, 5, "plotfeed/#") as client:

        def told(part: int) -> dict[str, Any]:
            said = [m.payload for m in [*client.heard] if m.topic == f"plotfeed/fleet/{part}"]
            return dict(json.loads(said[-1])) if said else {"state": "", "claim": 0}

        for name, value in (QUIET | {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}).items():
            os.environ.setdefault(name, value)
        import ray as at_work  # which reads them

        try:
            at_work.init(
                address="local", num_cpus=2, include_dashboard=False, logging_level=logging.ERROR,
                object_store_memory=128 << 20, log_to_driver=False, _node_ip_address="127.0.0.1",
            )  # fmt: skip
        except Exception as error:  # noqa: BLE001 - a machine that is far too busy
            pytest.skip(f"Ray cannot be started: {error}")
        try:
            start_parts(at_work, scene, **asked)
            wait_until(lambda: [told(k)["state"] for k in (1, 2)] == ["RUNNING"] * 2)
            with pytest.raises(PlotfeedError, match="has plotfeed-part-1 already"):
                start_parts(at_work, scene, **asked)
            os.kill(int(told(1)["worker"].rpartition(":")[2]), signal.SIGKILL)
            wait_until(lambda: (told(1)["claim"], told(1)["state"]) == (2, "RUNNING"))
            assert told(2)["claim"] == 1
            assert stop_parts(at_work, scene) == 2
            wait_until(lambda: [told(k)["state"] for k in (1, 2)] == ["ENDED"] * 2)
            assert stop_parts(at_work, scene) == 0
        finally:
            at_work.shutdown()
