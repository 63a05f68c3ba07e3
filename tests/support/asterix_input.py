"""Inputs that several ASTERIX tests share: plots, tracks, and the payloads of a recording."""

from __future__ import annotations

import struct
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.models.state import Plots
from plotfeed.proto.asterix.cat062 import Tracks
from plotfeed.proto.asterix.codec.encode import Slot, profile
from plotfeed.proto.asterix.codec.layout import (
    Category,
    Characters,
    Compound,
    Extended,
    Fixed,
    Item,
    Repetitive,
)

ETHERNET, UDP = 14, 8


def plots(**columns: Any) -> Plots:
    """Plots with those columns, and not measured in the others; all are as long as the longest."""
    n = max(np.size(column) for column in columns.values())
    given = {"t_utc_ns": 0, "drone": 0, "range_m": 1000.0, "azimuth_deg": 0.0} | columns
    return Plots.of(**{name: np.broadcast_to(np.asarray(v), (n,)) for name, v in given.items()})


def udp_payloads(pcap: Path) -> list[bytes]:
    """The UDP payloads of a little-endian pcap of Ethernet frames without VLAN tags."""
    data = pcap.read_bytes()
    assert data[:4] == bytes.fromhex("d4c3b2a1")
    payloads = []
    at = 24
    while at < len(data):
        (captured,) = struct.unpack_from("<8xI", data, at)
        frame = data[at + 16 : at + 16 + captured]
        at += 16 + captured
        udp = ETHERNET + (frame[ETHERNET] & 15) * 4
        (length,) = struct.unpack_from(">H", frame, udp + 4)
        payloads.append(frame[udp + UDP : udp + length])
    return payloads


def every_path(category: Category) -> list[str]:
    """Paths of everything in a category that fits a report profile."""
    return [path for item in category.uap if item for path in _paths(item)]


def _paths(item: Item, name: str = "") -> list[str]:
    name = name or item.name
    match item:
        case Extended(_, groups):
            return [name, f"{name}/{groups[-1].fields[0][0].name}"]
        case Compound(_, subfields):
            return [path for sub in subfields if sub for path in _paths(sub, f"{name}/{sub.name}")]
        case Repetitive():
            return [f"{name}*2"]
        case Fixed():
            return [name]
        case _:
            return []


def _text(part: Characters) -> str:
    """A text that every reader shows as it is."""
    usual = [character for character in "ABC1234" if character in part.alphabet]
    return "".join((usual * 4)[: part.count])


def text_constants(category: Category) -> dict[str, float | str]:
    """A text for every part of characters."""
    return {
        slot.path: _text(slot.part)
        for slot in profile(category, every_path(category)).slots
        if isinstance(slot.part, Characters)
    }


def numeric_slots(category: Category) -> list[Slot]:
    """Every slot of a record of everything, without those of characters."""
    slots = profile(category, every_path(category)).slots
    return [slot for slot in slots if not isinstance(slot.part, Characters)]


def tracks(**columns: Any) -> Tracks:
    """Tracks with those columns, not estimated or false in the others; as long as the longest."""
    n = max(np.size(column) for column in columns.values())
    flags = dict.fromkeys(("tentative", "coasted", "first", "last"), False)
    filled = dict.fromkeys((f.name for f in fields(Tracks)), np.nan)
    zeros = dict.fromkeys(
        ("latitude_deg", "longitude_deg", "east_m", "north_m"), 0.0
    ) | dict.fromkeys(("velocity_east_m_s", "velocity_north_m_s"), 0.0)
    given = filled | flags | zeros | {"track": 1, "t_utc_ns": 0} | columns
    return Tracks(**{name: np.broadcast_to(np.asarray(v), (n,)) for name, v in given.items()})
