"""Each effect that a scene may name is told of wherever a user would look for it, and measured."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import Any, get_args

import pytest

from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import SENSORS

ROOT = Path(__file__).parents[1]
NO_EFFECTS = {"link", "tracks", "mount", "cooperative", "page", "telemetry", "classifier", "layout"}
"""Tables that say how a sensor reports, turns, or is made."""


def optional_tables(model: type[SceneTable]) -> set[str]:
    """Keys of tables that a scene may leave out, and then nothing of them is modelled."""
    found = set()
    for name, field in model.model_fields.items():
        kinds = get_args(field.annotation)
        if type(None) in kinds and any(
            isinstance(k, type) and issubclass(k, SceneTable) for k in kinds
        ):
            found.add(name)
    return found - NO_EFFECTS


def keys() -> list[str]:
    of_sensors = set().union(*(optional_tables(kind) for kind in SENSORS.values()))
    return sorted(of_sensors | optional_tables(Scene) | {"jamming"})


@cache
def measured() -> set[str]:
    """Keys that the benchmark of effects names."""
    tree = ast.parse((ROOT / "tests" / "benchmarks" / "bench_effects.py").read_text())
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "EFFECTS":
            assert node.value is not None
            rows: dict[str, dict[str, Any]] = ast.literal_eval(node.value)
            return {key for row in rows.values() for key in row}
    raise AssertionError("no EFFECTS")


def text(name: str) -> str:
    return (ROOT / "docs" / name).read_text()


@pytest.mark.parametrize("key", keys())
def test_an_effect_is_in_the_limits_the_equations_and_the_benchmark(key: str) -> None:
    assert f"`{key}`" in text("limits.md")
    assert f"`{key}`" in text("equations.md") or f"`[{key}]`" in text("equations.md")
    assert key in measured()


def test_there_are_effects() -> None:
    assert {"bias", "doppler", "terrain", "weather"} <= set(keys())
