"""Reads the frames of the page, apart from the code that writes them."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.page.updates import LAYOUTS, SectionKind

SNAPSHOT = 1
# Of what only who sees the truth is told.
TRUE_KINDS = {
    SectionKind.PLOT_TRUTHS,
    SectionKind.LOST_PLOTS,
    SectionKind.DRONES,
    SectionKind.TRUE_NEWS,
}


@dataclass(frozen=True)
class Section:
    kind: int
    rows: int
    first: int
    columns: dict[str, NDArray[Any]] = field(default_factory=dict)
    news: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Frame:
    is_snapshot: bool
    number: int
    now_ms: float
    sections: list[Section]

    def of(self, kind: SectionKind) -> list[Section]:
        return [section for section in self.sections if section.kind == kind]

    def column(self, kind: SectionKind, name: str) -> NDArray[Any]:
        """Of all sections of a kind, one after the other."""
        parts = [section.columns[name] for section in self.of(kind)]
        return np.concatenate(parts) if parts else np.zeros(0)

    @property
    def news(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for section in self.of(SectionKind.NEWS):
            found |= section.news
        return found


def read_frame(data: bytes) -> Frame:
    magic, flags, number, now_ms = struct.unpack_from("<4sIQd", data)
    assert magic == b"PLF1"
    return Frame(bool(flags & SNAPSHOT), number, now_ms, list(_sections(data, 24)))


def news_of(frames: Iterable[Frame]) -> dict[str, Any]:
    """What is known after those updates: of each item of news the latest."""
    found: dict[str, Any] = {}
    for frame in frames:
        found |= frame.news
    return found


def _sections(data: bytes, at: int) -> Iterator[Section]:
    while at < len(data):
        kind, rows, first, octets = struct.unpack_from("<4I", data, at)
        at += 16
        assert octets % 8 == 0
        body = data[at : at + octets]
        assert len(body) == octets
        at += octets
        if kind in (SectionKind.NEWS, SectionKind.TRUE_NEWS):
            yield Section(kind, rows, first, news=json.loads(body[:rows]))
        else:
            yield Section(kind, rows, first, dict(_columns(kind, rows, body)))


def _columns(kind: int, rows: int, body: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    at = 0
    for name, dtype in LAYOUTS[SectionKind(kind)]:
        octets = np.dtype(dtype).itemsize * rows
        yield name, np.frombuffer(body, f"<{dtype}", rows, at)
        padding = -octets % 8
        assert not any(body[at + octets : at + octets + padding])
        at += octets + padding
    assert at == len(body)
