"""A recording tells what the running process did wrong: its judge asks the scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import pytest
from support.every_kind import SENSORS
from support.ledgers import record_session

from plotfeed.feeds.lab.gathering import FeedReport
from plotfeed.feeds.lab.judge import Against
from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.testing import held

SITE = {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}
SIGMAS = {f"{quantity} sigma" for quantity in ("range", "azimuth", "elevation")}
FAULTS: dict[str, tuple[type, str, str, float, set[str]]] = {
    "MIMO radar sees less": (PolarRadar, "pd", "mimo", 0.6, {"Pd"}),
    "microphones hear less": (MicrophoneArray, "pd", "microphones", 0.6, {"Pd"}),
    "radar errs and says so": (PolarRadar, "sigmas", "active", 2.5, SIGMAS),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_running_process_is_named(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In 40 s; what works too well for chance is named with all ranges that show it."""
    kind, method, sensor, factor, named = FAULTS[fault]
    right: Callable[..., Any] = getattr(kind, method)
    scale = 0.05 if sensor == "microphones" else 1.0
    drones = [held(f"d{i}", 60 * i + 5.0, 12.0, 2000.0 * scale, rcs_m2=1.0) for i in range(5)]
    tree = {"scene": {"name": "faulty", "seed": 4, "site": SITE}, "drone": drones}
    tree["sensor"] = [SENSORS[sensor] | {"report": ["plots"], "sic": 1}]
    scene = tmp_path / "scene.toml"
    scene.write_text(toml_of(tree))
    with monkeypatch.context() as patched:
        patched.setattr(kind, method, lambda self, *of: factor * right(self, *of))
        record = record_session(scene, tmp_path / "record.mcap", 40.0)
    for against in get_args(Against):
        wrong = {each.name for each in FeedReport(record, against).verdicts.wrong}
        assert named <= wrong
        assert all(name.startswith("Pd") for name in wrong - named)
