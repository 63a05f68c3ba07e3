"""The drones and the tracks of the tracker under test as the page shows them: their news."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.page.tracker_tracks import TrackNews, east_north_m
from plotfeed.feeds.page.updates import SectionKind, TrackFlag, section
from plotfeed.models.frames import LocalFrame
from plotfeed.models.state import Floats, Ints, TruthState

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
        return section(
            SectionKind.DRONES, {"drone": shown, "gone_ms": gone_ns[shown] / 1e6, **columns}
        )


KEPT_NS = 60_000_000_000
MAX_TRACKS = 10_000


class ShownTracks:
    """The last word on each track."""

    def __init__(self, site: LocalFrame) -> None:
        self._site = site
        self._waiting: list[TrackNews] = []
        self._rows_waiting = 0
        self._latest: dict[int, tuple[float, ...]] = {}

    def take(self, news: TrackNews) -> None:
        """What a message said; beyond `MAX_TRACKS` between two updates nothing is taken."""
        if len(news) and self._rows_waiting < MAX_TRACKS:
            self._waiting.append(news)
            self._rows_waiting += len(news)

    def news(self, now_utc_ns: int) -> bytes:
        """What is new since the last call."""
        waiting, self._waiting, self._rows_waiting = self._waiting, [], 0
        oldest_ms = (now_utc_ns - KEPT_NS) / 1e6
        self._latest = {k: row for k, row in self._latest.items() if row[0] >= oldest_ms}
        if not waiting:
            return b""
        columns = self._columns(TrackNews.joined(waiting))
        for row in zip(*(column.tolist() for column in columns.values()), strict=True):
            self._remember(row)
        return section(SectionKind.TRACKS, columns)

    def snapshot(self) -> bytes:
        """The latest of every track that is alive."""
        if not self._latest:
            return b""
        columns = zip(*self._latest.values(), strict=True)
        return section(
            SectionKind.TRACKS, {n: np.array(c) for n, c in zip(_NAMES, columns, strict=True)}
        )

    def _remember(self, row: tuple[float, ...]) -> None:
        track, flags = int(row[1]), int(row[-1])
        if flags & TrackFlag.ENDED:
            self._latest.pop(track, None)
        elif track in self._latest or len(self._latest) < MAX_TRACKS:
            self._latest[track] = row

    def _columns(self, news: TrackNews) -> Mapping[str, Floats | Ints]:
        east_m, north_m = east_north_m(news, self._site)
        values = (
            news.t_utc_ns / 1e6,
            news.track,
            east_m,
            north_m,
            news.velocity_east_m_s,
            news.velocity_north_m_s,
            news.flags,
        )
        return dict(zip(_NAMES, values, strict=True))


_NAMES = (
    "t_utc_ms",
    "track",
    "east_m",
    "north_m",
    "velocity_east_m_s",
    "velocity_north_m_s",
    "flags",
)
