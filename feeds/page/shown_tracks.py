"""Tracks of the tracker under test as the page shows them: what is new, and which are alive."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from plotfeed.feeds.lab.track_reports import ToldTrack, tracks_in
from plotfeed.feeds.page.shown import KEPT_NS
from plotfeed.feeds.page.updates import COUNT_MASK, LAYOUTS, SectionKind, TrackFlag, section
from plotfeed.feeds.telemetry.position_report import LATEST_UTC_NS
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import Floats
from plotfeed.proto.errors import DecodeError

MAX_TRACKS = 10_000
MAX_TOLD = 5_000  # Tracks of one message


def tracks_to_show(
    payload: bytes,
    content_type: str | None,
    now_utc_ns: int,
    site: LocalFrame,
    shown_ns: Callable[[int], int] = int,
) -> list[ToldTrack]:
    """The tracks in a message of any format, at times that the page shows; raises `DecodeError`.

    Those without a time are of now, those without a height at the site's.
    """

    def placed(told: ToldTrack) -> ToldTrack:
        east_m_s, north_m_s, _ = told.velocity_enu_m_s
        for name, value, most in (
            ("latitude_deg", told.latitude_deg, 90.0),
            ("longitude_deg", told.longitude_deg, 360.0),
            ("height_m", told.height_m, 1e5),
            ("velocity_east_m_s", east_m_s, 1e4),
            ("velocity_north_m_s", north_m_s, 1e4),
        ):
            if abs(value) > most or (math.isnan(value) and name.endswith("_deg")):
                raise DecodeError(f"{name}: expected a number of at most {most:g}, not {value:g}")
        t_utc_ns = now_utc_ns if told.t_utc_ns is None else told.t_utc_ns
        return replace(
            told,
            t_utc_ns=shown_ns(min(max(t_utc_ns, 0), LATEST_UTC_NS)),
            height_m=site.height_m if math.isnan(told.height_m) else told.height_m,
        )

    return [
        placed(told) for told in tracks_in(payload, content_type or "", now_utc_ns, site)[:MAX_TOLD]
    ]


class ShownTracks:
    """The last word on each track."""

    def __init__(self, site: LocalFrame) -> None:
        self._site = site
        self._waiting: list[ToldTrack] = []
        self._latest: dict[int, tuple[float, ...]] = {}
        self._names: dict[int, str] = {}
        self._numbers: dict[str, int] = {}
        self._free = 1 << 31

    def take(self, told: Sequence[ToldTrack]) -> None:
        """What a message said; beyond `MAX_TRACKS` between two updates nothing is taken."""
        self._waiting.extend(told[: MAX_TRACKS - len(self._waiting)])

    def news(self, now_utc_ns: int) -> bytes:
        """What is new since the last call."""
        waiting, self._waiting = self._waiting, []
        oldest_ms = (now_utc_ns - KEPT_NS) / 1e6
        self._latest = {k: row for k, row in self._latest.items() if row[0] >= oldest_ms}
        columns = self._columns([(told, self._number(told.name)) for told in waiting])
        for row in zip(*(column.tolist() for column in columns.values()), strict=True):
            self._latest[int(row[1])] = row
            if int(row[-1]) & TrackFlag.ENDED:
                del self._latest[int(row[1])]
        self._names = {number: self._names[number] for number in self._latest}
        self._numbers = {name: number for number, name in self._names.items()}
        return section(SectionKind.TRACKS, columns)

    def names(self) -> dict[int, str]:
        """Names of the tracks of which the page's number does not tell it."""
        told = self._names.items()
        return {number: name for number, name in told if name.rpartition(".")[2] != str(number)}

    def snapshot(self) -> bytes:
        """The latest of every track that is alive."""
        columns = list(zip(*self._latest.values(), strict=True)) or [()] * len(_NAMES)
        return section(
            SectionKind.TRACKS, {n: np.array(c) for n, c in zip(_NAMES, columns, strict=True)}
        )

    def _number(self, name: str) -> int:
        """The number of a track for the page, its own where that is free; -1 if all are taken."""
        if name in self._numbers:
            return self._numbers[name]
        if len(self._names) >= MAX_TRACKS:
            return -1
        own = _OWN_NUMBER.fullmatch(name)
        number = int(own[1]) if own else self._free
        while number in self._names or number > COUNT_MASK:
            number = self._free = (self._free + 1) & COUNT_MASK
        self._names[number], self._numbers[name] = name, number
        return number

    def _columns(self, told: Sequence[tuple[ToldTrack, int]]) -> Mapping[str, Floats]:
        """Columns of the tracks that have a number, (n,)."""
        rows = [
            (
                (each.t_utc_ns or 0) / 1e6,
                number,
                *(each.latitude_deg, each.longitude_deg, each.height_m),
                *each.velocity_enu_m_s[:2],
                TrackFlag.TENTATIVE * each.tentative
                | TrackFlag.COASTED * each.coasted
                | TrackFlag.ENDED * each.ended,
            )
            for each, number in told
            if number >= 0
        ]
        values = np.array(rows, np.float64).reshape(-1, 8).T
        enu_m = self._site.from_ecef(geodetic_to_ecef(*values[2:5]))
        values = np.stack([*values[:2], *enu_m.T[:2], *values[5:]])
        return dict(zip(_NAMES, values, strict=True))


# The number of a track in its name, perhaps after the identification of its source.
_OWN_NUMBER = re.compile(r"(?:\w+\.\w+\.)?(0|[1-9]\d{0,9})", re.ASCII)
_NAMES = tuple(name for name, _ in LAYOUTS[SectionKind.TRACKS])
