"""The drones as the page shows them: those that are there, and those that lately went."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.page.frames import Kind, section
from plotfeed.models.frames import LocalFrame
from plotfeed.models.state import Floats, TruthState

SHOWN_AFTER_NS = 30_000_000_000
"""A drone that went is shown this long where it was last."""


class Drones:
    """Every drone of a session by its index, where it is or was last."""

    def __init__(self, site: LocalFrame) -> None:
        self.names: Sequence[str] = ()
        self.changed = False
        """Whether there is a name that was not told."""
        self._site = site
        self._seen_utc_ns = np.zeros(0, np.int64)
        self._enu: Floats = np.zeros((0, 5))
        self._now_ns = 0

    def take(self, now_utc_ns: int, state: TruthState, names: Sequence[str]) -> None:
        """Those that are there now; `names` are of all that there ever were."""
        self.changed = self.changed or len(names) != len(self.names)
        self.names = tuple(names) if self.changed else self.names
        more = len(names) - len(self._seen_utc_ns)
        if more > 0:
            self._seen_utc_ns = np.concatenate([self._seen_utc_ns, np.zeros(more, np.int64)])
            self._enu = np.concatenate([self._enu, np.zeros((more, 5))])
        self._now_ns = now_utc_ns
        self._seen_utc_ns[state.drone] = now_utc_ns
        self._enu[state.drone, :3] = self._site.from_ecef(state.position_ecef_m)
        velocity = self._site.rotate_from_ecef(state.velocity_ecef_m_s)
        self._enu[state.drone, 3:] = velocity[:, :2]

    def section(self) -> bytes:
        """All of them; a drone that is there has been gone for 0 ms."""
        gone_ns = self._now_ns - self._seen_utc_ns
        shown = np.flatnonzero((self._seen_utc_ns > 0) & (gone_ns <= SHOWN_AFTER_NS))
        columns: dict[str, ArrayLike] = dict(
            zip(
                ("east_m", "north_m", "up_m", "velocity_east_m_s", "velocity_north_m_s"),
                self._enu[shown].T,
                strict=True,
            )
        )
        return section(Kind.DRONES, {"drone": shown, "gone_ms": gone_ns[shown] / 1e6, **columns})
