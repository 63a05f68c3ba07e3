"""Verdicts are right as often as the report says, in scenes of everything; faults are named."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable

import numpy as np
import pytest
from scipy import stats
from support.random_scenes import JudgedScene, every_name, judged_scene, names_in, random_tree
from support.significance import FALSE_ALARM_RATE, assert_chance

from plotfeed.feeds.lab.judge import FALSE_RATES

# Seeds of scenes that together have all there is to draw, and are soon judged: a
# fault of 1 in 5 scenes is seen with 4 chances in 5, of 2 in 5 almost always.
#
# Right scenes fail so often in fewer than one run of 10,000. `make verdicts` judges 200 of them.
SCENES = (3, 4, 10, 12, 13, 22, 26, 31, 32, 34, 36, 37, 38, 39)
MANY = 200
OF_ERRORS = re.compile("azimuth|(bistatic )?range|elevation|height")
LEVELS = (0.1, 0.01, 0.001)


def drawn(seeds: Iterable[int]) -> Counter[str]:
    return Counter(name for seed in seeds for name in names_in(random_tree(seed)))


def test_scenes_that_are_judged_have_all_that_a_scene_can_name() -> None:
    """Each kind of sensor, way of scanning, table of any sensor, table of a scene, and system.

    Many scenes have each table of each kind of sensor.
    """
    alone = {name for name in every_name() if "." not in name}
    of_any = {name.partition(".")[2] for name in every_name()} - {""}
    found = drawn(SCENES).keys()
    assert alone <= found
    assert of_any <= {name.partition(".")[2] for name in found}
    assert every_name() <= drawn(range(MANY)).keys()


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[JudgedScene]:
    folder = tmp_path_factory.mktemp("scenes")
    return [judged_scene(seed, folder) for seed in SCENES]


def test_what_is_right_is_called_wrong_as_seldom_as_is_said(scenes: list[JudgedScene]) -> None:
    most = stats.binom.isf(FALSE_ALARM_RATE, len(SCENES), FALSE_RATES["asked"])
    wrong = {scene.seed: scene.wrong for scene in scenes if scene.wrong}
    assert len(wrong) <= most, wrong
    by_chance = [figure for scene in scenes for figure in scene.figures]
    of_errors = [figure for figure in by_chance if OF_ERRORS.match(figure.name)]
    assert len(of_errors) > 5 * len(SCENES)
    for figures in (by_chance, of_errors):
        p = np.array([figure.p for figure in figures])
        for level in LEVELS:
            # Figures of one sensor hang together: height with elevation, all ranges with each.
            independent = len(p) // 2
            few = stats.binom.sf((p < level).sum() // 2 - 1, independent, level)
            assert_chance(float(few), f"{(p < level).mean():.4f} of {len(p)} below {level}")


def test_nothing_that_was_sent_is_left_out_without_a_word(scenes: list[JudgedScene]) -> None:
    assert not any(scene.notes for scene in scenes)
    assert not any(scene.lost for scene in scenes)
    plots = sum(scene.plots.total() for scene in scenes)
    assert sum(scene.not_compared for scene in scenes) < plots / 10
    judged = Counter(subject for scene in scenes for subject in scene.judged())
    assert all(math.isfinite(figure.p) for scene in scenes for figure in scene.figures)
    for kind in ("acoustic", "active_radar", "camera", "mimo_radar", "passive_radar"):
        assert judged[kind, "errors"], kind
        assert judged[kind, "false alarms"], kind
