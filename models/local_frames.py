"""The local frames of several sensors as columns, so that all are worked out together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.frames import Axes, Meridian
from plotfeed.models.state import Floats


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
