"""The levels of a sweep: every scene with every combination of the values that are varied."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice, product
from pathlib import Path
from typing import Any

from plotfeed.feeds.recording.recorder import files_of
from plotfeed.feeds.scene.problems import in_a_line
from plotfeed.feeds.scene.scene import Scene, SceneError, from_tree, load, parsed
from plotfeed.feeds.scene.terrain_keys import HORIZONS
from plotfeed.feeds.sweep.varied_keys import VariedKey, varied_tree
from plotfeed.proto.errors import PlotfeedError

MAX_LEVELS = 10_000
SCENES_AT_HAND = 16
MOST_PROBLEMS = 3
"""Of a level that cannot be, told in a line."""


@dataclass(frozen=True, slots=True)
class SweepLevel:
    """A scene with the values that keys have at this level."""

    number: int
    scene: str
    """What it is called among those that are compared."""
    file: str
    text: str
    """Of the file, as it was when the sweep began."""
    changes: tuple[tuple[str, str], ...]
    """Paths of keys, and their values as JSON."""

    @property
    def values(self) -> list[Any]:
        """The values, in the order of the keys."""
        return [json.loads(value) for _, value in self.changes]

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
    compared = list(zip(_names(files, scenes), files, scenes, strict=True))
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


def _names(files: Sequence[Path], scenes: Sequence[Scene]) -> Iterator[str]:
    """What scenes call themselves, or else where two are called so, their files."""
    called = [scene.scene.name for scene in scenes]
    for file, name in zip(files, called, strict=True):
        yield name if called.count(name) == 1 else str(file)
    if len({path.resolve() for path in files}) < len(files):
        raise PlotfeedError("a scene is there twice")


@lru_cache(SCENES_AT_HAND)
def scene_of(level: SweepLevel) -> Scene:
    """The scene of a level; raises `PlotfeedError` in one line where there can be none such."""
    file = Path(level.file)
    scene = parsed(level.text.encode(), file)
    if not level.changes:
        return scene
    changes = [(path, json.loads(value)) for path, value in level.changes]
    try:
        found = from_tree(varied_tree(level.text, changes), file)
    except SceneError as error:
        asked = " ".join(f"{path}={value}" for path, value in level.changes)
        what = in_a_line((_named(key, scene), text) for key, text in error.problems[:MOST_PROBLEMS])
        raise PlotfeedError(f"--vary {asked}: {what}") from None
    return found


def _named(key: str, scene: Scene) -> str:
    """A key of a problem with the sensor's id in place of its number."""
    for i, sensor in enumerate(scene.sensor):
        if key.startswith(f"sensor[{i}]"):
            return f"sensor.{sensor.id}{key.removeprefix(f'sensor[{i}]')}"
    return key


def digests(levels: Iterable[SweepLevel]) -> dict[str, str]:
    """SHA-256 of each scene's text and of the files that it names, by the scene's name.

    Raises `PlotfeedError` for a file that is not there.
    """
    found = {}
    for level in levels:
        if level.scene not in found:
            found[level.scene] = _digest(level)
    return found


def _digest(level: SweepLevel) -> str:
    scene = parsed(level.text.encode(), Path(level.file))
    names = [name for name in files_of(scene) if name != HORIZONS]
    if scene.terrain is not None:
        names += [*scene.terrain.elevation, *scene.terrain.buildings]
    digest = hashlib.sha256(level.text.encode())
    for name in names:
        with scene.file(name).open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()
