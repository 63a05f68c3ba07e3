"""Tracks of the tracker under test as the page shows them: their news, and all that are alive."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from plotfeed.feeds.page.frames import Kind, TrackFlag, section
from plotfeed.feeds.page.tracks import TrackNews, east_north_m
from plotfeed.models.frames import LocalFrame
from plotfeed.models.state import Floats, Ints

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
        return section(Kind.TRACKS, columns)

    def snapshot(self) -> bytes:
        """The latest of every track that is alive."""
        if not self._latest:
            return b""
        columns = zip(*self._latest.values(), strict=True)
        return section(Kind.TRACKS, {n: np.array(c) for n, c in zip(_NAMES, columns, strict=True)})

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
