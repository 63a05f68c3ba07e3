"""The keys of weather and of jammers: of one sensor, or of all of them for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import Field, ValidationError

from plotfeed.feeds.scene.fields import (
    ForAWhile,
    Frequency,
    Location,
    Name,
    Positive,
    SceneTable,
)


class WeatherKeys(SceneTable):
    """Weather, the same as far as a sensor reaches."""

    rain_mm_h: Annotated[float, Field(ge=0, le=300)] = 0.0
    """Weakens the echoes of radars by their frequency (ITU-R P.838-3)."""
    polarisation: Literal["horizontal", "vertical", "circular"] = "horizontal"
    """Of the radars that the rain weakens."""
    rain_echo: bool = False
    """Whether rain also sends echoes back, to active radars, and drowns targets as if no Doppler
    filter helped."""
    vapour_g_m3: Annotated[float, Field(ge=0, le=50)] | None = None
    """Of water in the air; with it, gases weaken the echoes of radars (ITU-R P.676), below 54 GHz.
    7.5 is usual, 15 sultry."""
    wind_m_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    """At microphones, whose noise it adds to."""


class WeatherSpell(WeatherKeys, ForAWhile):
    """Weather of all sensors for a while; of spells that overlap, the later one counts."""

    table: ClassVar[str] = "weather"


class JammerKeys(Location):
    """A transmitter of noise, and its place."""

    eirp_w: Positive
    """What it radiates towards the sensor, over isotropic."""
    frequency_hz: Frequency
    """Centre of its band."""
    bandwidth_hz: Positive
    """Over which it spreads its noise; receivers beside it hear nothing."""
    sidelobe_db: Annotated[float, Field(ge=-200, le=0)] = -25.0
    """By which a radar hears it beside its beam, at least; below the beam's gain."""


class JammerSpell(JammerKeys, ForAWhile):
    """A jammer of all sensors for a while."""

    table: ClassVar[str] = "jammer"

    id: Name
    """By which sensors know it."""


S = TypeVar("S", WeatherSpell, JammerSpell)


def with_spells(tree: dict[str, Any]) -> dict[str, Any]:
    """A scene's tree in which sensors have its weather and jammers among their events.

    What is not right in these is left for whoever checks the tables themselves.
    """
    events = [
        *(_event(spell, {"weather": _keys(spell)}) for spell in _spells(tree, WeatherSpell)),
        *(_event(j, {"jamming": {j.id: _keys(j)}}) for j in _spells(tree, JammerSpell)),
    ]
    sensors = list(tree["sensor"])
    for n, sensor in enumerate(sensors):
        own = sensor.get("event", []) if isinstance(sensor, dict) else None
        if events and isinstance(own, list | tuple):
            sensors[n] = {**sensor, "event": [*own, *events]}
    return {**tree, "sensor": sensors}


def _spells(tree: dict[str, Any], kind: type[S]) -> Iterator[S]:
    tables = tree.get(kind.table)
    for table in tables if isinstance(tables, list | tuple) else ():
        with suppress(ValidationError):
            yield kind.model_validate(table)


def _keys(spell: WeatherSpell | JammerSpell) -> dict[str, Any]:
    return spell.model_dump(exclude_unset=True, exclude={"from_s", "to_s", "id"})


def _event(spell: WeatherSpell | JammerSpell, changes: dict[str, Any]) -> dict[str, Any]:
    until = {} if spell.to_s is None else {"to_s": spell.to_s}
    return {"from_s": spell.from_s, **until, "set": changes}
