"""Commercial systems of several sensors: one table of a scene that stands for all of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated, Any, Literal, get_args

from pydantic import Field

from plotfeed.feeds.scene.presets.preset import (
    MAX_SHOWN,
    SYSTEMS,
    CatalogueTable,
    closest,
    names,
    preset,
    system_names,
    tree_of,
)
from plotfeed.models.frames import wrap_180

# Sensors that a system may have, as the ends of their ids.
MemberName = Literal["radar", "rf", "detector", "audio", "camera"]
MEMBERS: tuple[MemberName, ...] = get_args(MemberName)
OF_SYSTEM = frozenset({"id", "type"})  # Keys of its sensors that the system itself has
Problems = list[tuple[str, str]]


class Member(CatalogueTable):
    """One sensor of a system."""

    preset: str
    note: str
    """What the source says of it."""
    cued_by: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Of a sensor with a mount: those of the system that cue it, unless its keys say otherwise."""


class SystemPreset(CatalogueTable):
    """One commercial system."""

    name: str
    title: str
    maker: str
    source: str
    left_out: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """What the source says of the product and nothing stands for."""
    members: dict[MemberName, Member]
    """Sensors that it brings, by the ends of their ids."""


@cache
def system(name: str) -> SystemPreset:
    """The system of that name, one of `system_names`."""
    return SystemPreset.model_validate(tree_of(name, SYSTEMS))


def with_systems(tree: dict[str, Any]) -> tuple[dict[str, Any], Problems, dict[str, str]]:
    """A scene's tree with the sensors of its systems, what was wrong, and whose sensors they are.

    That is by the keys that sensors have in problems: `sensor[3]` is `system[0].radar`. What is no
    table is left to the scene's own checks.
    """
    tables, sensors = tree.get("system"), tree.get("sensor", [])
    if not isinstance(tables, list) or not isinstance(sensors, list):
        return tree, [], {}
    every, problems, whose = list(sensors), [], {}
    for i, table in enumerate(tables):
        if not isinstance(table, dict) or not isinstance(table.get("preset"), str):
            continue
        found = list(_problems(table))
        problems += [(f"system[{i}].{key}", text) for key, text in found]
        if found:
            continue
        for name, keys in _sensors(table):
            whose[f"sensor[{len(every)}]"] = f"system[{i}].{name}"
            every.append(keys)
    return {**tree, "sensor": every} if every else tree, problems, whose


def _problems(table: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    name = table["preset"]
    if name not in system_names():
        if name in names():
            yield "preset", f"{name} is one sensor: write [[sensor]]"
        else:
            hint = closest(name, system_names())
            yield "preset", f"no such system as {name[:MAX_SHOWN]!r}; {hint}"
        return
    members = system(name).members
    has = f"{name} has {', '.join(members)}"
    without = table.get("without", [])
    for n, other in enumerate(without if isinstance(without, list) else []):
        if other not in members:
            yield f"without[{n}]", f"{has}; not {str(other)[:MAX_SHOWN]!r}"
    for other in MEMBERS:
        if other in table and other not in members:
            yield other, has
    for of in ("every", *members):
        keys = table.get(of)
        for key in sorted(OF_SYSTEM & keys.keys()) if isinstance(keys, dict) else ():
            yield f"{of}.{key}", "is the system's to say"


def _sensors(table: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The sensors of a system that is in order, as tables of their own."""
    for name, member in system(table["preset"]).members.items():
        if name in table.get("without", ()):
            continue
        keys: dict[str, Any] = {"id": f"{table.get('id')}-{name}", "preset": member.preset}
        if "position_enu_m" in table:
            keys["position_enu_m"] = table["position_enu_m"]
        for of in ("every", name):
            own = table.get(of, {})
            keys |= own if isinstance(own, dict) else {}
        cuers = [of for of in member.cued_by if of not in table.get("without", ())]
        keys = _cued(keys, [f"{table.get('id')}-{of}" for of in cuers])
        yield name, _turned(keys, table.get("facing_deg", 0.0))


def _cued(keys: dict[str, Any], cuers: list[str]) -> dict[str, Any]:
    """Keys of a sensor that those cue, if it has a mount and says nothing else."""
    of_preset = preset(keys["preset"]).keys if keys.get("preset") in names() else {}
    mount = keys.get("mount", of_preset.get("mount"))
    if not cuers or not isinstance(mount, dict) or "cued_by" in mount:
        return keys
    return {**keys, "mount": {**mount, "cued_by": cuers}}


def _turned(keys: dict[str, Any], by_deg: Any) -> dict[str, Any]:
    """Keys of a sensor, with its preset's ways to look so much further clockwise."""
    if not by_deg or not isinstance(by_deg, int | float) or keys.get("preset") not in names():
        return keys
    of_preset = preset(keys["preset"]).sensor
    turn_deg = float(wrap_180(float(by_deg)))
    turned: dict[str, float] = {
        key: getattr(of_preset, key) + turn_deg
        for key in ("azimuth_min_deg", "azimuth_max_deg", "pan_deg")
        if key in type(of_preset).model_fields
    }
    span_deg = turned.get("azimuth_max_deg", 0.0) - turned.get("azimuth_min_deg", 0.0)
    return keys if span_deg >= 360 else turned | keys
