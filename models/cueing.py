"""Which of several cues a mount turns to, how long it stays, and when it sees: pure decisions.

It follows what it looks at by the newer plots near there; when the dwell is over it goes to the
next one clockwise, so that nobody waits for ever; and where there is nothing, it goes home.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plotfeed.models.frames import wrap_180, wrap_360
from plotfeed.models.pointing import Aim, Mount, Pointing, moved, slew_s
from plotfeed.models.state import NS, Floats

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
