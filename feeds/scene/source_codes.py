"""Who says it in ASTERIX: a SAC and SIC for each sensor, which no other sensor of the scene has."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sensors import SensorKeys

LAST_CODE = 255
Source = tuple[int, int]
"""System area code and system identification code."""


def numbered(sensors: Iterable[Any]) -> list[Any]:
    """Tables of sensors, those without a `sic` with the first that is free of their `sac`.

    Free are 1 to 255, but for those that any sensor states; a sensor that states no `sac` either
    has 0, or the next that has room. What is no table, or states nonsense, is left as it is.
    """
    every = list(sensors)
    taken = {source for sensor in every if (source := _stated(sensor)) is not None}
    return [_numbered(sensor, taken) for sensor in every]


def _stated(sensor: Any) -> Source | None:
    if isinstance(sensor, SensorKeys):
        return sensor.sac, sensor.sic
    if not isinstance(sensor, dict) or not isinstance(sensor.get("sic"), int):
        return None
    sac = sensor.get("sac", 0)
    return (sac, sensor["sic"]) if isinstance(sac, int) else None


def _numbered(sensor: Any, taken: set[Source]) -> Any:
    if not isinstance(sensor, dict) or "sic" in sensor:
        return sensor
    found = next((each for each in _open_to(sensor) if each not in taken), None)
    if found is None:
        return sensor
    taken.add(found)
    sac, sic = found
    return {**sensor, **({"sac": sac} if sac else {}), "sic": sic}


def _open_to(sensor: dict[str, Any]) -> Iterator[Source]:
    """The codes that a sensor might have, the first before the others."""
    sac = sensor.get("sac")
    sacs: Iterable[int] = range(LAST_CODE + 1)
    if sac is not None:
        sacs = [sac] if isinstance(sac, int) else []
    return ((area, sic) for area in sacs for sic in range(1, LAST_CODE + 1))


def check_sources(sensors: Sequence[SensorKeys]) -> None:
    """Raise `ValueError` if two sensors that report in ASTERIX have one SAC and SIC.

    All go to the same brokers and files, where nothing else in a record tells them apart.
    """
    known: dict[Source, str] = {}
    for n, sensor in enumerate(sensors):
        if not any(REPORT_FORMATS[name].categories for name in sensor.report):
            continue
        source = sensor.sac, sensor.sic
        other = known.setdefault(source, sensor.id)
        if other != sensor.id:
            raise ValueError(
                f"sensor[{n}].sic: {other!r} and {sensor.id!r} both have sac {sensor.sac} and sic "
                f"{sensor.sic}, and both report in ASTERIX, which tells them apart by that alone; "
                "leave out sic, and they are numbered"
            )
