"""How tracks are scored."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from plotfeed.proto.errors import PlotfeedError


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreSettings:
    """How tracks are scored; raises `PlotfeedError` for what cannot be."""

    cutoff_m: float = 50.0
    """Further from a drone than this, a track is none of it: c of GOSPA and OSPA, and the gate."""
    order: float = 2.0
    """p of GOSPA and OSPA."""
    switch_m: float = 25.0
    """What a switch of tracks costs in T-GOSPA."""
    step_s: float = 1.0
    """Of the grid on which sets are compared."""
    stale_s: float = 5.0
    """A track whose last report is older than this is not there."""
    dimensions: int = 0
    """2 for distances over the ground, 3 for those in space, 0 for 3 where all reports tell a
    height."""
    window_steps: int = 10
    """Over which whole tracks are compared by OSPA(2) and T-GOSPA; 0 for neither."""
    confirm_steps: int = 2
    """A track is a drone's from so many steps on at which that one was nearest."""
    end_steps: int = 3
    """And until it has been beyond the cut-off for so many."""
    future_s: float = 1.0
    """A report may be of a time so much later than it was received, for clocks differ."""
    max_speed_m_s: float = 150.0
    """Between two reports of a track nothing flies faster."""
    counts_tentative: bool = False
    """Whether tracks count that the tracker does not hold to be confirmed."""
    protected_deg: tuple[float, float] | None = None
    """Latitude and longitude of what is protected; without it the scene's site is."""

    def __post_init__(self) -> None:
        for name, (least, most) in BOUNDS.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise PlotfeedError(f"{name}: expected {least:g} to {most:g}, not {value:g}")
        if self.dimensions == 1:
            raise PlotfeedError("dimensions: expected 2 or 3, or 0 for what is told, not 1")
        if self.protected_deg is not None:
            latitude_deg, longitude_deg = self.protected_deg
            if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
                raise PlotfeedError("protected_deg: expected a latitude and a longitude in degrees")

    @classmethod
    def of(cls, values: dict[str, Any]) -> ScoreSettings:
        """Settings by their names, as a profile has them; raises `PlotfeedError`."""
        known = {each.name: each.default for each in fields(cls)}
        for name, value in values.items():
            if name not in known:
                raise PlotfeedError(f"{name}: expected one of {', '.join(known)}")
            usual = known[name]
            if name == "protected_deg":
                is_pair = isinstance(value, list | tuple) and len(value) == 2
                good = is_pair and all(_is_number(part) for part in value)
            elif isinstance(usual, bool):
                good = isinstance(value, bool)
            elif isinstance(usual, int):
                good = isinstance(value, int) and not isinstance(value, bool)
            else:
                good = _is_number(value)
            if not good:
                raise PlotfeedError(f"{name}: {str(value)[:40]!r} is not what is expected there")
        given: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in values.items()
        }
        return cls(**given)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


BOUNDS = {
    "cutoff_m": (0.1, 1e5),
    "order": (1.0, 8.0),
    "switch_m": (0.0, 1e5),
    "step_s": (0.05, 3600.0),
    "stale_s": (0.05, 3600.0),
    "dimensions": (0, 3),
    "window_steps": (0, 100),
    "confirm_steps": (1, 100),
    "end_steps": (1, 100),
    "future_s": (0.0, 3600.0),
    "max_speed_m_s": (1.0, 1e4),
}
"""Of numbers, least and most."""
