"""Scenes with the values that varied keys have: a level of all of them, and the scene at it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice, product
from pathlib import Path
from typing import Any

from plotfeed.feeds.scene.problems import in_a_line
from plotfeed.feeds.scene.scene import Scene, SceneError, from_tree, load, parsed
from plotfeed.feeds.scene.varied_keys import VariedKey, varied_tree
from plotfeed.proto.errors import PlotfeedError

MAX_LEVELS = 10_000
SCENES_AT_HAND = 16
MOST_PROBLEMS = 3  # Of a level that cannot be, told in a line


@dataclass(frozen=True, slots=True)
class SweepLevel:
    """A scene with the values that keys have at this level."""

    number: int
    scene: str  # What it is called among those that are compared
    file: str
    text: str  # Of the file, as it was when the sweep began
    changes: tuple[tuple[str, str], ...]  # Paths of keys, and their values as JSON

    @property
    def values(self) -> list[Any]:
        """The values, in the order of the keys."""
        return list(self.by_path().values())

    def by_path(self) -> dict[str, Any]:
        """The values by the paths of keys."""
        return {path: json.loads(value) for path, value in self.changes}

    def __str__(self) -> str:
        return ", ".join([self.scene, *(f"{path}={value}" for path, value in self.changes)])


def levels_of(files: Sequence[Path], varied: Sequence[VariedKey]) -> list[SweepLevel]:
    """All levels, the last key's values in turn first; each is a scene that can be run.

    Raises `PlotfeedError` in one line for a key or value that no scene can have, and what `load`
    raises for a scene without any change.
    """
    paths = [key.path for key in varied]
    if len(set(paths)) < len(paths):
        raise PlotfeedError("--vary: a key is there twice")
    scenes = [load(file) for file in files]
    for file, scene in zip(files, scenes, strict=True):
        if not scene.text:
            raise PlotfeedError(f"{file}: holds nothing")
    if len({path.resolve() for path in files}) < len(files):
        raise PlotfeedError("a scene is there twice")
    called = [scene.scene.name for scene in scenes]  # or else, where two are called so, its file
    compared = [
        (name if called.count(name) == 1 else str(file), file, scene)
        for name, file, scene in zip(called, files, scenes, strict=True)
    ]
    several = product(compared, product(*([(k.path, v) for v in k.values] for k in varied)))
    levels = [
        SweepLevel(number, name, str(file.resolve()), scene.text, changes)
        for number, ((name, file, scene), changes) in enumerate(islice(several, MAX_LEVELS + 1))
    ]
    if len(levels) > MAX_LEVELS:
        raise PlotfeedError(f"--vary: more than {MAX_LEVELS} combinations")
    for level in levels:
        scene_of(level)
    return levels


@lru_cache(SCENES_AT_HAND)
def scene_of(level: SweepLevel) -> Scene:
    """The scene of a level; raises `PlotfeedError` in one line where there can be none such."""
    file = Path(level.file)
    scene = parsed(level.text.encode(), file)
    if not level.changes:
        return scene
    changes = [(path, json.loads(value)) for path, value in level.changes]
    try:
        return from_tree(varied_tree(level.text, changes), file)
    except SceneError as error:
        asked = " ".join(f"{path}={value}" for path, value in level.changes)
        told = ((_named(key, scene), text) for key, text in error.problems[:MOST_PROBLEMS])
        raise PlotfeedError(f"--vary {asked}: {in_a_line(told)}") from None


def _named(key: str, scene: Scene) -> str:
    """A key of a problem with the sensor's id in place of its number."""
    for i, sensor in enumerate(scene.sensor):
        if key.startswith(f"sensor[{i}]"):
            return f"sensor.{sensor.id}{key.removeprefix(f'sensor[{i}]')}"
    return key
