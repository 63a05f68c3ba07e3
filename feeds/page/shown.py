"""Plots, drones and tracks as the page shows them: what is new, and what has not faded yet."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from plotfeed.feeds.formats.told_tracks import ToldTrack, tracks_in
from plotfeed.feeds.page.scene_outline import Placements
from plotfeed.feeds.page.updates import (
    COUNT_MASK,
    LAYOUTS,
    PlotFlag,
    SectionKind,
    TrackFlag,
    section,
)
from plotfeed.feeds.telemetry.position_report import LATEST_UTC_NS
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import DRONE, Floats, Ints, Plots, Texts, TruthState, renamed
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.units import decibels

SHOWN_AFTER_NS = 30_000_000_000  # A drone that went is shown this long where it was last


class Drones:
    """The drones of a session by index, where each is or was last."""

    def __init__(self, site: LocalFrame) -> None:
        self.names: Sequence[str] = ()
        self.classes: dict[str, str] = {}  # Of those that are no drones, by index
        self.unseen: Mapping[str, str] = {}  # Those that no sensor will see, and why
        self.changed = False  # Whether there is a name or a class that was not told
        self._site = site
        self._told: Sequence[str] = ()
        self._seen_utc_ns = np.zeros(0, np.int64)
        self._enu: Floats = np.zeros((0, 5))
        self._now_ns = 0

    def take(
        self,
        now_utc_ns: int,
        state: TruthState,
        names: Sequence[str],
        target_class: Texts | None = None,
    ) -> None:
        """Take drones that are there now; `names` are of all, by index, and so are classes.

        Where a name changes, that is another list; one may grow as it is.
        """
        if names is not self._told or len(names) != len(self.names):
            others = renamed(self.names, names)
            self._seen_utc_ns[others[others < len(self._seen_utc_ns)]] = 0
            self._seen_utc_ns = self._seen_utc_ns[: len(names)]
            self._enu = self._enu[: len(names)]
            self._told, self.names, self.changed = names, tuple(names), True
        more = len(names) - len(self._seen_utc_ns)
        if more > 0:
            self._seen_utc_ns = np.concatenate([self._seen_utc_ns, np.zeros(more, np.int64)])
            self._enu = np.concatenate([self._enu, np.zeros((more, 5))])
        told = np.zeros(0, np.object_) if target_class is None else target_class[: len(names)]
        classes = {str(i): str(told[i]) for i in np.flatnonzero(told != DRONE).tolist()}
        if classes != self.classes:
            self.classes, self.changed = classes, True
        self._now_ns = now_utc_ns
        self._seen_utc_ns[state.drone] = now_utc_ns
        self._enu[state.drone, :3] = self._site.from_ecef(state.position_ecef_m)
        velocity = self._site.rotate_from_ecef(state.velocity_ecef_m_s)
        self._enu[state.drone, 3:] = velocity[:, :2]

    def news(self) -> dict[str, Any]:
        """Names, classes of those that are no drones, and which no sensor sees."""
        return {"drones": list(self.names), "classes": self.classes, "unseen": dict(self.unseen)}

    def section(self) -> bytes:
        """The section of all drones; one that is there has been gone for 0 ms."""
        gone_ns = self._now_ns - self._seen_utc_ns
        shown = np.flatnonzero((self._seen_utc_ns > 0) & (gone_ns <= SHOWN_AFTER_NS))
        rows = [shown, *self._enu[shown].T, gone_ns[shown] / 1e6]
        names = (name for name, _ in LAYOUTS[SectionKind.DRONES])
        return section(SectionKind.DRONES, dict(zip(names, rows, strict=True)))


# Plots and tracks that came longer ago are seen no more, however slowly a page lets them fade.
KEPT_NS = 60_000_000_000
MAX_KEPT = 30_000  # Plots for whoever joins late; older ones give way
MAX_NEW = 100_000  # Plots between two updates; what comes on top is not shown
# Sectors that are worked out at once: the session must not wait for all of an update's.
MAX_PARTS = 48
MAX_MERGED = 255


class _Arrived(NamedTuple):
    sensor: int
    plots: Plots
    sent_utc_ns: int  # 0 for what no message brought


@dataclass(frozen=True, slots=True)
class _Kept:
    at_utc_ns: int
    rows: int
    public: bytes
    truth: bytes


class PlotStore:
    """Plots of a scene, from when it is known what became of them until they have faded."""

    def __init__(self, placements: Placements) -> None:
        self._placements = placements
        self._waiting: list[_Arrived] = []
        self._new: list[tuple[bytes, bytes]] = []
        self._rows_new = 0
        self._kept: deque[_Kept] = deque()
        self._rows_kept = 0
        self._next_number = 0

    def take(self, sensor: int, plots: Plots, sent_utc_ns: int | None) -> None:
        """Plots of a sensor by number, and when a message brought them; None if none did."""
        if len(plots) and self._rows_new < MAX_NEW:
            self._waiting.append(_Arrived(sensor, plots, sent_utc_ns or 0))
            self._rows_new += len(plots)
            if len(self._waiting) >= MAX_PARTS:
                self._work_out()

    def sections(self, now_utc_ns: int) -> tuple[bytes, bytes]:
        """What is new since the last call: for everybody, and for who sees the truth besides."""
        self._work_out()
        public = b"".join(public for public, _ in self._new)
        truth = b"".join(truth for _, truth in self._new)
        if self._new:
            self._kept.append(_Kept(now_utc_ns, self._rows_new, public, truth))
            self._rows_kept += self._rows_new
        self._new, self._rows_new = [], 0
        while self._kept and (
            (self._rows_kept > MAX_KEPT and len(self._kept) > 1)
            or self._kept[0].at_utc_ns < now_utc_ns - KEPT_NS
        ):
            self._rows_kept -= self._kept.popleft().rows
        return public, truth

    def _work_out(self) -> None:
        """Sections of what waits."""
        waiting, self._waiting = self._waiting, []
        brought = [part for part in waiting if part.sent_utc_ns]
        lost = [part for part in waiting if not part.sent_utc_ns]
        public = truth = b""
        if brought:
            columns = self._columns(brought)
            public = section(SectionKind.PLOTS, columns, self._next_number)
            truth = section(SectionKind.PLOT_TRUTHS, columns, self._next_number)
            self._next_number += len(columns["sensor"])
        if lost:
            truth += section(SectionKind.LOST_PLOTS, self._columns(lost))
        if waiting:
            self._new.append((public, truth))

    def kept(self) -> tuple[bytes, bytes]:
        """Sections of all plots that have not faded: for everybody, and of their truth."""
        return b"".join(k.public for k in self._kept), b"".join(k.truth for k in self._kept)

    def _columns(self, parts: Sequence[_Arrived]) -> dict[str, Floats | Ints]:
        """Columns of every layout of plots, (n,)."""
        lengths = [len(part.plots) for part in parts]
        sensor = np.repeat(np.array([part.sensor for part in parts]), lengths)
        sent_utc_ns = np.repeat(np.array([part.sent_utc_ns for part in parts]), lengths)
        all_plots = [part.plots for part in parts]
        column = {name: np.concatenate([getattr(p, name) for p in all_plots]) for name in _TAKEN}
        measured = [column[name] for name in ("azimuth_deg", "elevation_deg", "range_m")]
        true = [column[f"true_{name}"] for name in ("azimuth_deg", "elevation_deg", "range_m")]
        east_m, north_m = self._placements.places_m(sensor, *measured)
        true_east_m, true_north_m = self._placements.places_m(sensor, *true)
        nowhere = np.isnan(column["azimuth_deg"])
        bearing = np.isnan(column["range_m"]) & ~nowhere
        latency_ns = np.where(sent_utc_ns, sent_utc_ns - column["t_utc_ns"], np.nan)
        return column | {
            "t_utc_ms": column["t_utc_ns"] / 1e6,
            "east_m": east_m,
            "north_m": north_m,
            "snr_db": decibels(column["snr"]),
            "latency_ms": latency_ns / 1e6,
            "sensor": sensor,
            "flags": bearing * int(PlotFlag.BEARING) + nowhere * int(PlotFlag.NOWHERE),
            "true_east_m": true_east_m,
            "true_north_m": true_north_m,
            "merged": np.concatenate([_merged(p) for p in all_plots]),
        }


_TAKEN = (
    "t_utc_ns",
    "range_m",
    "azimuth_deg",
    "elevation_deg",
    "height_m",
    "snr",
    "drone",
    "true_range_m",
    "true_azimuth_deg",
    "true_elevation_deg",
)


def _merged(plots: Plots) -> Ints:
    """Number of further drones behind each plot; (n,)."""
    others = plots.merged_drones
    if others is None:
        return np.zeros(len(plots), np.int64)
    return np.fromiter((min(len(o), MAX_MERGED) for o in others), np.int64, len(plots))


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
