"""What no two sensors of a scene may share: SAC and SIC in ASTERIX, and the numbers of tracks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sensors import SENSORS, SensorKeys
from plotfeed.feeds.scene.sensors.sensor_keys import TrackingSensorKeys
from plotfeed.models.track_lives import MAX_TRACKS

LAST_CODE = 255
FEWEST_NUMBERS = 1000
"""That a sensor must have for its tracks; where there are too many sensors, none has its own."""
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
    sac = sensor.get("sac")
    sacs: Iterable[int] = range(LAST_CODE + 1)
    if sac is not None:
        sacs = [sac] if isinstance(sac, int) else []
    codes = ((area, sic) for area in sacs for sic in range(1, LAST_CODE + 1))
    found = next((each for each in codes if each not in taken), None)
    if found is None:
        return sensor
    taken.add(found)
    sac, sic = found
    return {**sensor, **({"sac": sac} if sac else {}), "sic": sic}


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


def with_track_numbers(sensors: Sequence[Any]) -> list[Any]:
    """Tables of sensors, those that report tracks with an even share of their numbers each.

    A sensor that states its own keeps them, one that is alone has all, and so has each where all
    report in ASTERIX, whose records say of whom they are.
    """
    formats = [_track_formats(sensor) for sensor in sensors]
    tracking = [n for n, names in enumerate(formats) if names]
    share = MAX_TRACKS // max(len(tracking), 1)
    is_asterix = all(REPORT_FORMATS[name].categories for names in formats for name in names)
    found = list(sensors)
    if is_asterix or len(tracking) < 2 or share < FEWEST_NUMBERS:
        return found
    for place, n in enumerate(tracking):
        tracks = sensors[n].get("tracks", {})
        if isinstance(tracks, dict):
            numbers = (place * share + 1, (place + 1) * share)
            found[n] = {**sensors[n], "tracks": {"numbers": numbers, **tracks}}
    return found


def _track_formats(sensor: Any) -> list[str]:
    """The formats of tracks in which a table's sensor reports."""
    if not isinstance(sensor, dict) or not isinstance(sensor.get("report"), list | tuple):
        return []
    kind = SENSORS.get(str(sensor.get("type")))
    if kind is None or not issubclass(kind, TrackingSensorKeys):
        return []
    names = [name for name in sensor["report"] if isinstance(name, str) and name in REPORT_FORMATS]
    return [name for name in names if REPORT_FORMATS[name].tells_tracks]
