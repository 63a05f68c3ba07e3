"""Where a mount points: pan and tilt by bounded rates and accelerations, and the zoom of its lens.

Pure: what comes of a state, an aim and a time. Each axis goes there as fast as its bounds let it
and comes to rest; the zoom goes evenly in the logarithm of the field of view.
"""

from __future__ import annotations

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
    to_pan_deg = float(wrap_180(aim.pan_deg - state.pan_deg))
    on_deg, pan_rate = _turned(to_pan_deg, state.pan_rate_deg_s, mount.pan, dt_s)
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
    to_pan_deg = float(wrap_180(aim.pan_deg - state.pan_deg))
    zoom = abs(np.log(aim.field_deg / state.field_deg))
    return max(
        sum(_phases(to_pan_deg, state.pan_rate_deg_s, mount.pan)[:3]),
        sum(_phases(aim.tilt_deg - state.tilt_deg, state.tilt_rate_deg_s, mount.tilt)[:3]),
        float(zoom / _zoom_rate(mount)) if zoom else 0.0,
    )


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
