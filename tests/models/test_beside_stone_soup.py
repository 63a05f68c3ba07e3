"""GOSPA and OSPA of a long run beside Stone Soup's, which has an environment of its own."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from plotfeed.models.track_metrics import set_score

ROOT = Path(__file__).parents[3]
PYTHON = Path(os.environ.get("PLOTFEED_STONESOUP", ROOT / ".venv-stonesoup" / "bin" / "python"))
PROGRAM = ROOT / "tests" / "support" / "stonesoup_scores.py"


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_sets_of_any_size_score_alike(order: float) -> None:
    if not PYTHON.exists():
        pytest.skip("Stone Soup is not installed")
    rng = np.random.default_rng(1)
    steps = [
        [rng.uniform(0, 300, (rng.integers(0, 8), 2)), rng.uniform(0, 300, (rng.integers(1, 8), 2))]
        for _ in range(200)
    ]
    asked = {
        "cutoff_m": 60.0,
        "order": order,
        "steps": [[drones.tolist(), tracks.tolist()] for drones, tracks in steps],
    }
    done = subprocess.run(
        [PYTHON, PROGRAM], input=json.dumps(asked), capture_output=True, text=True, check=True
    )
    theirs = json.loads(done.stdout)
    for k, (drones, tracks) in enumerate(steps):
        score = set_score(cdist(drones, tracks), 60.0, order)
        told = theirs["gospa"][k]
        assert score.gospa_m(order) == pytest.approx(told["distance"], abs=1e-9)
        assert score.localisation == pytest.approx(told["localisation"], abs=1e-7)
        assert (score.missed, score.false) == pytest.approx((told["missed"], told["false"]))
        assert score.ospa_m <= theirs["ospa"][k] + 1e-9
        if order == 1.0:
            assert score.ospa_m == pytest.approx(theirs["ospa"][k], abs=1e-9)
