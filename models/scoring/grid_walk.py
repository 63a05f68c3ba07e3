"""All steps of a grid, one after the other: sets beside sets, and which track is of which drone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from plotfeed.models.scoring.associations import NOBODY, TrackHolder
from plotfeed.models.scoring.set_metrics import set_score
from plotfeed.models.scoring.track_grid import GridRows
from plotfeed.models.scoring.trajectory_metrics import ospa2_m, t_gospa
from plotfeed.models.state import Bools, Columns, Floats, Ints


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkSettings:
    """How sets are compared."""

    cutoff_m: float
    order: float
    switch_m: float
    columns: int
    """Of points: `GROUND` or `SPACE`."""
    confirm_steps: int
    end_steps: int
    window_steps: int
    """Of OSPA(2) and T-GOSPA; 0 for neither."""


@dataclass(frozen=True, kw_only=True)
class StepScores(Columns):
    """Every step, (steps,): counts, and parts of GOSPA as sums of p-th powers."""

    drones: Ints
    tracks: Ints
    tracked: Ints
    """Drones that have a track."""
    assigned: Ints
    """Tracks that are of a drone."""
    localisation: Floats
    missed: Floats
    false: Floats
    ospa_m: Floats


@dataclass(frozen=True, kw_only=True)
class Assigned(Columns):
    """Tracks that are of a drone at a step, (n,), by step; `row` is that of the grid's rows."""

    step: Ints
    drone: Ints
    track: Ints
    row: Ints
    distance_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Walked:
    """What all steps came to."""

    steps: StepScores
    assigned: Assigned
    nearest: Ints
    """Of each of the grid's rows: the drone that was nearest then, -1 where none was there."""
    ospa2_m: Floats
    """Of each window."""
    window_parts: Floats
    """Localisation, missed, false and switching of T-GOSPA in each window, (windows, 4)."""


Held = tuple[Ints, Ints, Floats]
"""Drones, tracks and their distances at one step."""


def walk(truth: Floats, there: Bools, rows: GridRows, tracks: int, how: WalkSettings) -> Walked:
    """Go through a grid. Points of drones are (steps, drones, 4), whether they are there is beside.

    `rows` has tracks of numbers below `tracks`.
    """
    steps, drones = there.shape
    by = np.searchsorted(rows.step, np.arange(steps + 1)).tolist()
    holder = TrackHolder(
        drones, tracks, how.cutoff_m, confirm_steps=how.confirm_steps, end_steps=how.end_steps
    )
    parts = np.zeros((steps, 4))
    nearest = np.full(len(rows), NOBODY)
    found: list[tuple[Ints, Ints, Ints, Ints]] = []
    window: list[Held] = []
    ospa2: list[float] = []
    windows: list[tuple[float, ...]] = []
    for k in range(steps):
        a, b = by[k], by[k + 1]
        here, now = np.flatnonzero(there[k]), rows.track[a:b]
        distances_m = cdist(truth[k, here, : how.columns], rows.point[a:b, : how.columns])
        score = set_score(distances_m, how.cutoff_m, how.order)
        parts[k] = score.localisation, score.missed, score.false, score.ospa_m
        if len(here) and b > a:
            nearest[a:b] = here[np.argmin(distances_m, axis=0)]
        of, whose, since = holder.step(k, here, now, distances_m)
        if len(of):
            found.append((of, whose, since, np.full(len(of), k)))
        if how.window_steps:
            window.append((here, now, distances_m))
            if len(window) > how.window_steps or k == steps - 1:
                # Windows share the steps at their ends, so that no switch is between two of them.
                weights = np.ones(len(window))
                weights[0] -= 0.5 * (k >= len(window))
                weights[-1] -= 0.5 * (k < steps - 1)
                _judge(window, weights, how, ospa2, windows)
                window = window[-1:]
    assigned = _assigned(found, truth, rows, tracks, how.columns)
    pairs = np.unique(assigned.step * max(drones, 1) + assigned.drone)
    return Walked(
        steps=StepScores(
            drones=there.sum(axis=1),
            tracks=np.diff(by),
            tracked=np.bincount(pairs // max(drones, 1), minlength=steps),
            assigned=np.bincount(assigned.step, minlength=steps),
            localisation=parts[:, 0],
            missed=parts[:, 1],
            false=parts[:, 2],
            ospa_m=parts[:, 3],
        ),
        assigned=assigned,
        nearest=nearest,
        ospa2_m=np.array(ospa2),
        window_parts=np.array(windows).reshape(-1, 4),
    )


def _judge(
    window: list[Held],
    weights: Floats,
    how: WalkSettings,
    ospa2: list[float],
    windows: list[tuple[float, ...]],
) -> None:
    """Judge whole tracks over a window; one in which there is nothing is passed over."""
    drones = np.unique(np.concatenate([held[0] for held in window]))
    tracks = np.unique(np.concatenate([held[1] for held in window]))
    if not len(drones) and not len(tracks):
        return
    distances_m = np.full((len(window), len(drones), len(tracks)), np.inf)
    truth_there = np.zeros((len(window), len(drones)), np.bool_)
    track_there = np.zeros((len(window), len(tracks)), np.bool_)
    for k, (here, now, each_m) in enumerate(window):
        i, j = np.searchsorted(drones, here), np.searchsorted(tracks, now)
        truth_there[k, i] = track_there[k, j] = True
        distances_m[k, i[:, None], j] = each_m
    ospa2.append(ospa2_m(distances_m, truth_there, track_there, how.cutoff_m, how.order))
    windows.append(
        t_gospa(
            distances_m,
            truth_there,
            track_there,
            cutoff_m=how.cutoff_m,
            order=how.order,
            switch_m=how.switch_m,
            weights=weights,
        )
    )


def _assigned(
    found: list[tuple[Ints, Ints, Ints, Ints]],
    truth: Floats,
    rows: GridRows,
    tracks: int,
    columns: int,
) -> Assigned:
    """What was held, a row a step, the steps before it was confirmed among them."""
    none = np.zeros(0, np.int64)
    parts = zip(*found, strict=True) if found else ([none],) * 4
    of, whose, since, until = (np.concatenate(part) for part in parts)
    many = until - since + 1
    which = np.repeat(np.arange(len(of)), many)
    step = since[which] + np.arange(len(which)) - np.repeat(np.cumsum(many) - many, many)
    track, drone = of[which], whose[which]
    row = np.searchsorted(rows.step * tracks + rows.track, step * tracks + track)
    order = np.lexsort((track, step))
    step, drone, track, row = step[order], drone[order], track[order], row[order]
    apart = truth[step, drone, :columns] - rows.point[row, :columns]
    return Assigned(
        step=step,
        drone=drone,
        track=track,
        row=row,
        distance_m=np.sqrt((apart**2).sum(axis=1)),
    )
