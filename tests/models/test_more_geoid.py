"""The geoid of the package against the file of EGM96 that it is made of."""

from __future__ import annotations

import importlib.util
from importlib.resources import files
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from support.given_files import places

from plotfeed.models.frames import GRID_FILE, unpacked

SCRIPT = Path(__file__).resolve().parents[2] / "docs/commands/write_geoid.py"
(EGM96,) = places("geoid/egm96-15.pgm")


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("write_geoid", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_grid_of_the_package_is_what_the_script_makes_of_egm96(script: ModuleType) -> None:
    fine_m = script.pgm_undulations_m(EGM96)
    grid_dm = np.rint(10 * fine_m[::2, ::2]).astype(np.int16)
    kept = files("plotfeed.models").joinpath(GRID_FILE).read_bytes()
    assert (unpacked(kept) == grid_dm).all()
    assert len(kept) < 166_000


def test_it_is_as_far_from_egm96_as_it_says(script: ModuleType) -> None:
    fine_m = script.pgm_undulations_m(EGM96)
    error_m, area = script.errors_m(fine_m)
    assert round(float(np.sqrt((error_m**2).mean())), 2) == 0.13
    assert round(float(np.sqrt((error_m**2 * area).sum())), 2) == 0.14
    assert (np.abs(error_m) <= 1.35).mean() >= 0.999
    assert round(float(np.abs(error_m).max()), 1) == 3.9
    # On the nodes that it keeps nothing but rounding to decimetres is left.
    assert np.abs(error_m[::2, ::2]).max() <= 0.05 + 1e-9
    assert fine_m.min() > -107.1
    assert fine_m.max() < 85.4
