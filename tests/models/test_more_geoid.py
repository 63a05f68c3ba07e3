"""The geoid of the package against the file of EGM96 that it is made of."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
from support.doc_commands import doc_command
from support.given_files import places

from plotfeed.models.frames import GRID_FILE, unpacked

(EGM96,) = places("geoid/egm96-15.pgm")


def test_the_grid_is_what_the_script_makes_of_egm96_and_as_far_from_it_as_it_says() -> None:
    script = doc_command("write_geoid")
    fine_m = script["pgm_undulations_m"](EGM96)
    kept = files("plotfeed.models").joinpath(GRID_FILE).read_bytes()
    assert (unpacked(kept) == np.rint(10 * fine_m[::2, ::2]).astype(np.int16)).all()
    assert len(kept) < 166_000
    error_m, area = script["errors_m"](fine_m)
    assert round(float(np.sqrt((error_m**2).mean())), 2) == 0.13
    assert round(float(np.sqrt((error_m**2 * area).sum())), 2) == 0.14
    assert (np.abs(error_m) <= 1.35).mean() >= 0.999
    assert round(float(np.abs(error_m).max()), 1) == 3.9
    # On the nodes that it keeps nothing but rounding to decimetres is left.
    assert np.abs(error_m[::2, ::2]).max() <= 0.05 + 1e-9
    assert fine_m.min() > -107.1
    assert fine_m.max() < 85.4
