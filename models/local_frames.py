"""The local frames of several sensors as columns, so that all are worked out together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.frames import Axes, Meridian
from plotfeed.models.state import Floats, Ints

A_HAIR_M = 1.0
"""More than all that is rounded."""


@dataclass(frozen=True, slots=True)
class LocalFrames(Axes):
    """Several frames: origins (..., 3), rotations (..., 3, 3), meridians each (...).

    What they are given has a row a frame, or broadcasts against that. To the last bit, each row is
    what its own frame alone makes of it.
    """

    origin_ecef_m: Floats
    rotation_from_ecef: Floats
    meridian: Meridian

    @classmethod
    def of(cls, frames: Sequence[Axes]) -> Axes:
        """Stack frames, one a row; a single one is itself, for it broadcasts against any rows."""
        if len(frames) == 1:
            return frames[0]
        meridians = zip(*(frame.meridian for frame in frames), strict=True)
        return cls(
            np.array([frame.origin_ecef_m for frame in frames]),
            np.array([frame.rotation_from_ecef for frame in frames]),
            tuple(np.array(part) for part in meridians),
        )

    def rows(self, which: NDArray[Any]) -> LocalFrames:
        """Frames at those indices, of any shape (...), which may recur."""
        return LocalFrames(
            self.origin_ecef_m[which],
            self.rotation_from_ecef[which],
            tuple(part[which] for part in self.meridian),
        )


def frames_at(frames: Axes, which: NDArray[Any]) -> Axes:
    """The frames of those rows; of a single one, itself."""
    return frames.rows(which) if isinstance(frames, LocalFrames) else frames


def rows_about(frames: Axes, positions_ecef_m: Floats, within_m: Floats) -> Ints:
    """Columns of positions (k, n, 3) that may be within distances (m,) of their frames, in order.

    By one sphere about all frames, which is quick; whoever is out of it, or NaN, is near none.
    """
    origins_m = np.atleast_2d(frames.origin_ecef_m)
    centre_m = origins_m.mean(axis=0)
    from_centre_m = np.sqrt(((origins_m - centre_m) ** 2).sum(axis=1)).max()
    radius_m = from_centre_m + np.max(within_m) + A_HAIR_M
    x, y, z = np.moveaxis(positions_ecef_m - centre_m, -1, 0)
    within = x * x + y * y + z * z <= radius_m * radius_m
    return np.flatnonzero(within.any(axis=0))
