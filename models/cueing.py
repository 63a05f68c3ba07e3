"""Where a mount points, which of several cues it turns to, how long it stays, and when it sees.

It follows what it looks at by the newer plots near there; when the dwell is over it goes to the
next one clockwise, so that nobody waits for ever; and where there is nothing, it goes home.

Each axis of the mount goes there as fast as its bounds of rate and acceleration let it and comes to
rest; the zoom goes evenly in the logarithm of the field of view.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models import optics
from plotfeed.models.frames import enu_to_aer, wrap_180, wrap_360
from plotfeed.models.numerics import as_floats
from plotfeed.models.state import NS, Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Motor:
    """The bounds of one axis."""

    rate_deg_s: float
    acceleration_deg_s2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """What turns a sensor. `zoom_s` is from the widest field of view to the narrowest."""

    pan: Motor
    tilt: Motor
    tilt_min_deg: float
    tilt_max_deg: float
    settle_s: float
    field_min_deg: float
    field_max_deg: float
    zoom_s: float

    def reachable(self, aim: Aim) -> Aim:
        """The nearest to an aim that mount and lens can have."""
        return Aim(
            pan_deg=float(wrap_360(aim.pan_deg)),
            tilt_deg=min(max(aim.tilt_deg, self.tilt_min_deg), self.tilt_max_deg),
            field_deg=min(max(aim.field_deg, self.field_min_deg), self.field_max_deg),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim:
    """A direction from true north and above the horizon, and a horizontal field of view."""

    pan_deg: float
    tilt_deg: float
    field_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Pointing:
    """Where a mount points at a time, and how fast it turns."""

    t_utc_ns: int
    pan_deg: float
    tilt_deg: float
    field_deg: float
    pan_rate_deg_s: float = 0.0
    tilt_rate_deg_s: float = 0.0


def at_rest(aim: Aim, t_utc_ns: int) -> Pointing:
    """Pointing there, without moving."""
    return Pointing(
        t_utc_ns=t_utc_ns, pan_deg=aim.pan_deg, tilt_deg=aim.tilt_deg, field_deg=aim.field_deg
    )


def moved(state: Pointing, aim: Aim, mount: Mount, t_utc_ns: int) -> Pointing:
    """Pointing at a later time, if the aim is that until then."""
    dt_s = (t_utc_ns - state.t_utc_ns) / NS
    on_deg, pan_rate = _turned(
        _to_pan_deg(state, aim, mount), state.pan_rate_deg_s, mount.pan, dt_s
    )
    to_tilt_deg = aim.tilt_deg - state.tilt_deg
    up_deg, tilt_rate = _turned(to_tilt_deg, state.tilt_rate_deg_s, mount.tilt, dt_s)
    zoom, step = float(np.log(aim.field_deg / state.field_deg)), _zoom_rate(mount) * dt_s
    zoomed_deg = state.field_deg * float(np.exp(np.copysign(step, zoom)))
    return replace(
        state,
        t_utc_ns=t_utc_ns,
        pan_deg=float(wrap_360(state.pan_deg + on_deg)),
        tilt_deg=state.tilt_deg + up_deg,
        field_deg=aim.field_deg if abs(zoom) <= step else zoomed_deg,
        pan_rate_deg_s=pan_rate,
        tilt_rate_deg_s=tilt_rate,
    )


def slew_s(state: Pointing, aim: Aim, mount: Mount) -> float:
    """How long it takes until all of it is at rest there, without settling."""
    zoom = abs(np.log(aim.field_deg / state.field_deg))
    return max(
        sum(_phases(_to_pan_deg(state, aim, mount), state.pan_rate_deg_s, mount.pan)[:3]),
        sum(_phases(aim.tilt_deg - state.tilt_deg, state.tilt_rate_deg_s, mount.tilt)[:3]),
        float(zoom / _zoom_rate(mount)) if zoom else 0.0,
    )


def _to_pan_deg(state: Pointing, aim: Aim, mount: Mount) -> float:
    """How far round it goes: the shorter way from where it can stop, whenever that is asked."""
    way_deg, rate_deg_s = float(wrap_180(aim.pan_deg - state.pan_deg)), state.pan_rate_deg_s
    left_deg = way_deg - rate_deg_s * abs(rate_deg_s) / (2 * mount.pan.acceleration_deg_s2)
    return way_deg if abs(left_deg) <= 180.0 else way_deg - math.copysign(360.0, left_deg)


def _phases(
    distance_deg: float, rate_deg_s: float, motor: Motor
) -> tuple[float, float, float, float, float]:
    """Seconds of gaining speed, of going on and of slowing down; the way's sign, and the peak."""
    a = motor.acceleration_deg_s2
    stopped_deg = rate_deg_s * abs(rate_deg_s) / (2 * a)
    sign = 1.0 if distance_deg >= stopped_deg else -1.0
    ahead_deg, rate = sign * distance_deg, sign * rate_deg_s
    peak = min(motor.rate_deg_s, float(np.sqrt(max(a * ahead_deg + rate * rate / 2, 0.0))))
    peak = max(peak, rate)
    gaining_s, slowing_s = (peak - rate) / a, peak / a
    even_deg = ahead_deg - (2 * peak * peak - rate * rate) / (2 * a)
    return gaining_s, max(even_deg, 0.0) / peak if peak else 0.0, slowing_s, sign, peak


def _turned(
    distance_deg: float, rate_deg_s: float, motor: Motor, dt_s: float
) -> tuple[float, float]:
    """How far an axis has come after a time, degrees, and its rate then."""
    a = motor.acceleration_deg_s2
    gaining_s, even_s, slowing_s, sign, peak = _phases(distance_deg, rate_deg_s, motor)
    left_s = gaining_s + even_s + slowing_s - dt_s
    if left_s <= 0:
        return distance_deg, 0.0
    if left_s <= slowing_s:
        return distance_deg - sign * a * left_s * left_s / 2, sign * a * left_s
    if dt_s >= gaining_s:
        rest_deg = peak * (left_s - slowing_s) + peak * slowing_s / 2
        return distance_deg - sign * rest_deg, sign * peak
    return rate_deg_s * dt_s + sign * a * dt_s * dt_s / 2, rate_deg_s + sign * a * dt_s


def _zoom_rate(mount: Mount) -> float:
    """Rate of the field of view's logarithm, 1/s; infinite where there is nothing to wait for."""
    if not mount.zoom_s or mount.field_max_deg <= mount.field_min_deg:
        return float("inf")
    return float(np.log(mount.field_max_deg / mount.field_min_deg) / mount.zoom_s)


def to_mount(position_enu_m: Floats, pan_deg: ArrayLike, tilt_deg: ArrayLike) -> Floats:
    """Places by a mount's own axes, in which it points north and level; (n, 3)."""
    right_m, above_m, along_m = optics.picture_axes(position_enu_m, pan_deg, tilt_deg)
    return np.stack([right_m, along_m, above_m], axis=-1)


def from_mount(
    azimuth_deg: Floats, elevation_deg: Floats, pan_deg: ArrayLike, tilt_deg: ArrayLike
) -> tuple[Floats, Floats]:
    """Directions from true north and the horizon, of directions by a mount's axes; (n,) each."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    right, along = np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth)
    tilt, above = np.radians(tilt_deg), np.sin(elevation)
    level = along * np.cos(tilt) - above * np.sin(tilt)
    up = along * np.sin(tilt) + above * np.cos(tilt)
    turned_deg, elevation_deg, _ = enu_to_aer(np.stack([right, level, up], axis=-1))
    return wrap_360(turned_deg + as_floats(pan_deg)), elevation_deg


HOME = ""  # What a mount without a cue is cued by


@dataclass(frozen=True, slots=True, kw_only=True)
class CueRule:
    """A mount, where it is at home, how long it looks at a cue, and how old plots may be."""

    mount: Mount
    home: Aim
    dwell_ns: int
    max_age_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CueBatch:
    """What one source knows at a time: directions, (n,), the fields of view that they ask for."""

    t_utc_ns: int
    source: str
    pan_deg: Floats
    tilt_deg: Floats
    field_deg: Floats

    def aim(self, row: int) -> Aim:
        """One of them."""
        return Aim(
            pan_deg=float(self.pan_deg[row]),
            tilt_deg=float(self.tilt_deg[row]),
            field_deg=float(self.field_deg[row]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CuedState:
    """Where a mount points, what it is to look at, since when it sees that and until when."""

    pointing: Pointing
    aim: Aim
    source: str = HOME
    settled_ns: int = 0
    until_ns: int | None = None
    """When the dwell is over; None holds until something else is asked."""
    firm: bool = False
    """Whether plots are not to turn it away."""

    def sees(self, t_utc_ns: int) -> bool:
        """Whether it has settled by then."""
        return t_utc_ns >= self.settled_ns


def advanced(state: CuedState, rule: CueRule, t_utc_ns: int) -> CuedState:
    """State at a later time, with the same cue; a time that is past changes nothing."""
    if t_utc_ns <= state.pointing.t_utc_ns:
        return state
    return replace(state, pointing=moved(state.pointing, state.aim, rule.mount, t_utc_ns))


def turned_to(  # noqa: PLR0917
    state: CuedState, rule: CueRule, aim: Aim, source: str, dwell_ns: int | None, firm: bool = False
) -> CuedState:
    """State of a mount that begins to turn to another aim, and is to look so long when settled."""
    aim = rule.mount.reachable(aim)
    now_ns = state.pointing.t_utc_ns
    turning_s = slew_s(state.pointing, aim, rule.mount)
    settled_ns = now_ns + round((turning_s + rule.mount.settle_s) * NS) if turning_s else now_ns
    return replace(
        state,
        aim=aim,
        source=source,
        settled_ns=max(settled_ns, state.settled_ns if aim == state.aim else 0),
        until_ns=None if dwell_ns is None else settled_ns + dwell_ns,
        firm=firm,
    )


def after_plots(state: CuedState, rule: CueRule, batch: CueBatch) -> CuedState:
    """State after new plots, at the time of its pointing: it follows, or turns if it is free.

    Followed is the nearest, within half the field of view of where it looks.
    """
    if state.firm or not len(batch.pan_deg):
        return state
    if state.source == HOME:
        return turned_to(
            state, rule, batch.aim(next_clockwise(state, batch)), batch.source, rule.dwell_ns
        )
    away = away_deg(state.aim, batch)
    nearest = int(np.argmin(away))
    if away[nearest] > state.aim.field_deg / 2:
        return state
    return replace(state, aim=rule.mount.reachable(batch.aim(nearest)), source=batch.source)


def after_dwell(state: CuedState, rule: CueRule, latest: CueBatch | None) -> CuedState:
    """State when it has looked long enough: it turns to the next of the newest plots, or home."""
    now_ns = state.pointing.t_utc_ns
    if latest is None or not len(latest.pan_deg) or now_ns - latest.t_utc_ns > rule.max_age_ns:
        return turned_to(state, rule, rule.home, HOME, None)
    row = next_clockwise(state, latest)
    if away_deg(state.aim, latest)[row] <= state.aim.field_deg / 2:  # it is in view as it is
        aim = rule.mount.reachable(latest.aim(row))
        return replace(
            state, aim=aim, source=latest.source, until_ns=now_ns + rule.dwell_ns, firm=False
        )
    return turned_to(state, rule, latest.aim(row), latest.source, rule.dwell_ns)


def away_deg(aim: Aim, batch: CueBatch) -> Floats:
    """How far directions are from an aim, near it; (n,)."""
    across_deg = wrap_180(batch.pan_deg - aim.pan_deg) * np.cos(np.radians(aim.tilt_deg))
    return np.asarray(np.hypot(across_deg, batch.tilt_deg - aim.tilt_deg))


def next_clockwise(state: CuedState, batch: CueBatch) -> int:
    """The row of the next one clockwise; what is in view already comes last."""
    ahead_deg = wrap_360(batch.pan_deg - state.aim.pan_deg - state.aim.field_deg / 2)
    return int(np.argmin(ahead_deg))
