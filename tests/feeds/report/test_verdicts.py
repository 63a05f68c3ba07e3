"""Verdicts are right as often as the report says, in scenes of everything; faults are named."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats
from support.ledgers import record_session
from support.random_scenes import SECONDS, random_tree
from support.scene_files import toml_of
from support.significance import FALSE_ALARM_RATE, assert_chance

from plotfeed.feeds.report.figures import judged_of, report
from plotfeed.feeds.report.ledger_reading import read
from plotfeed.feeds.report.verdicts import FALSE_VERDICTS, Judged

SCENES = 80
"""Judged together: a fault of 1 in 20 scenes is seen with 3 chances in 4, of 1 in 10 nearly always.

Right scenes fail three times or more in fewer than one run of 10,000.
"""
LEVELS = (0.1, 0.01, 0.001)


@dataclass
class Reports:
    """Of some scenes."""

    figures: list[Judged]
    wrong: list[str]
    plots: int = 0
    not_compared: int = 0


def reports_of(seeds: range, folder: Path) -> Reports:
    found = Reports([], [])
    for seed in seeds:
        scene = folder / f"{seed}.toml"
        scene.write_text(toml_of(random_tree(seed)))
        record = record_session(scene, folder / f"{seed}.mcap", SECONDS)
        told = report(record, read(record))
        record.unlink()
        assert not told.notes
        found.figures += judged_of(told.links, told.sensors)
        found.wrong += [f"{seed}: {verdict}" for verdict in told.verdicts.wrong]
        for sensor in told.sensors:
            assert not sensor.plots_from or sensor.joined == sensor.plots
            found.plots += sensor.joined
            found.not_compared += sensor.not_compared
    return found


def test_what_is_right_is_called_wrong_as_seldom_as_is_said(tmp_path: Path) -> None:
    found = reports_of(range(SCENES), tmp_path)
    most = stats.binom.isf(FALSE_ALARM_RATE, SCENES, FALSE_VERDICTS)
    assert len({line.partition(":")[0] for line in found.wrong}) <= most, found.wrong
    by_chance = [f for f in found.figures if f.has_chance and not math.isnan(f.p)]
    of_errors = [f for f in by_chance if "error" in f.what]
    assert len(of_errors) > 480
    assert found.not_compared < found.plots / 10
    for figures in (by_chance, of_errors):
        p = np.array([figure.p for figure in figures])
        for level in LEVELS:
            # Figures of one sensor hang together: height with elevation, all ranges with each.
            independent = len(p) // 2
            few = stats.binom.sf((p < level).sum() // 2 - 1, independent, level)
            assert_chance(float(few), f"{(p < level).mean():.4f} of {len(p)} below {level}")
