"""Stories of a scene: what they may say, and those that any scene has."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.scene_files import scene_file, scene_text

from plotfeed.feeds.scene.scene import SceneError, load

USUAL = {"bad-link", "outage", "drift", "jamming", "swarm"}
STORY = """
[[story]]
id = "rain"
title = "A shower"
change = [{ sensor = "radar", set = { weather = { rain_mm_h = 20.0 } } }]
"""


def test_a_scene_tells_stories_of_its_own_and_in_place_of_the_usual(tmp_path: Path) -> None:
    own = STORY + STORY.replace("rain", "outage", 1)
    scene = load(scene_file(tmp_path, scene_text() + own))
    assert scene.stories.keys() == USUAL | {"rain"}
    assert scene.stories["outage"].title == "A shower"
    assert scene.stories["rain"].sets == {"radar": {"weather": {"rain_mm_h": 20.0}}}


REFUSED = {
    'sensor = "nobody", set = { pfa = 1e-4 }': "no sensor has the id 'nobody'",
    'sensor = "radar", set = { pfa = 2.0 }': "change[0].set: pfa",
    'sensor = "radar", set = { id = "other" }': "cannot change while the sensor is at work",
    'sensor = "radar"': "expected set with a sensor",
    'sensor = "radar", set = { pfa = 1e-4 }, drone = "visitor"': "expected either sensor or drone",
    'drone = "visitor"': "expected contingency or claim with a drone",
    'drone = "nobody", contingency = { kind = "hold" }': "the scene flies no 'nobody'",
    'drone = "visitor", contingency = { kind = "hold", at_s = 3.0 }': "when the story begins",
    'drone = "visitor", claim = { freeze = true }': "it is not [cooperative]",
}


@pytest.mark.parametrize(("change", "why"), REFUSED.items())
def test_a_story_that_cannot_be_told_is_refused_by_its_key(
    tmp_path: Path, change: str, why: str
) -> None:
    text = f'{scene_text()}\n[[story]]\nid = "x"\nchange = [{{ {change} }}]\n'
    with pytest.raises(SceneError) as refused:
        load(scene_file(tmp_path, text))
    assert "story[0]" in str(refused.value)
    assert why in str(refused.value)


SWARM = """
[[story]]
id = "x"
[[story.swarm]]
id = "{id}"
number = 2
formation = {{ kind = "line", spacing_m = 10.0 }}
speed_m_s = 10.0
path = [
    {{ east_m = 0.0, north_m = 0.0, above_site_m = 9.0 }},
    {{ east_m = 9.0, north_m = 0.0, above_site_m = 9.0 }},
]
"""


def test_a_swarm_of_a_story_has_names_of_its_own_and_waits(tmp_path: Path) -> None:
    scene = load(scene_file(tmp_path, scene_text() + SWARM.format(id="bees")))
    assert scene.fleet.waiting_names == ["bees-1", "bees-2"]
    assert scene.fleet.names == ["visitor"]
    with pytest.raises(SceneError, match=r"story\[0\]\.swarm\[0\]\.id: .*used twice"):
        load(scene_file(tmp_path, scene_text() + SWARM.format(id="visitor")))
    with pytest.raises(SceneError, match=r"story\[0\].*has changes or swarms"):
        load(scene_file(tmp_path, scene_text() + '[[story]]\nid = "x"\n'))
    with pytest.raises(SceneError, match=r"story\[1\]\.id: .*used twice"):
        load(scene_file(tmp_path, scene_text() + STORY + STORY))
