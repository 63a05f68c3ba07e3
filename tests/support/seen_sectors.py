"""What came of sectors of many sensors, as an engine works it out: what formats are given."""

from __future__ import annotations

from typing import Any

import numpy as np
from support.every_kind import EMITTER, GATE, PASSIVE, RF

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.formats import Batch
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, held, radar, rotating, scene

KINDS: dict[str, dict[str, Any]] = {
    "rotating": radar(scan=rotating(1.0, 32)),
    "staring": radar(pfa=1e-10),
    "passive": PASSIVE,
    "gate": GATE,
    "rf": RF | {"azimuth_floor_deg": 2.0},
}


def scene_of(
    kind: str, count: int, report: list[str], *, drones: int = 40, seed: int = 1, **more: Any
) -> Scene:
    """A scene of so many sensors of a kind, each with a SAC, SIC and place of its own.

    They see so many drones all around; `more` are other tables.
    """
    sensors = [
        KINDS[kind]
        | {"id": f"{kind}-{i}", "report": report, "sac": i % 256, "sic": i * 7 % 256}
        | {"position_enu_m": [10.0 * i, -5.0 * i, 0.1 * i]}
        for i in range(count)
    ]
    rng = np.random.default_rng(seed)
    loud = {"rcs_m2": 1.0, "emitters": [EMITTER]}
    places = rng.uniform((0, 5, 800), (360, 30, 3000), (drones, 3)).tolist()
    flying = [held(f"d{i}", *place, **loud) for i, place in enumerate(places)]
    return scene(sensors, flying, seed=seed, **more)


def seen(made: Scene, scans: int = 2) -> Batch:
    """All sectors of so many seconds, those of each sensor after each other."""
    engine = Engine(made, START_NS)
    return Batch.joined(list(engine.until(START_NS + scans * NS, messages=False)))
