"""Inputs that several ASTERIX tests share: plots, and the payloads of a recording."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.models.state import Plots
from plotfeed.proto.asterix.layout import (
    Category,
    Characters,
    Compound,
    Extended,
    Fixed,
    Item,
)
from plotfeed.proto.asterix.profile import Slot, profile

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


def _paths(item: Item) -> list[str]:
    match item:
        case Fixed(name):
            return [name]
        case Extended(name, groups):
            return [name, f"{name}/{groups[-1].fields[0][0].name}"]
        case Compound(name, subfields):
            return [f"{name}/{sub.name}" for sub in subfields if isinstance(sub, Fixed)]
        case _:
            return []


def text_constants(category: Category) -> dict[str, float | str]:
    """A text for every part of characters."""
    return {
        slot.path: (slot.part.alphabet[1:5] * 2)[: slot.part.count]
        for slot in profile(category, every_path(category)).slots
        if isinstance(slot.part, Characters)
    }


def numeric_slots(category: Category) -> list[Slot]:
    """Every slot of a record of everything, without those of characters."""
    slots = profile(category, every_path(category)).slots
    return [slot for slot in slots if not isinstance(slot.part, Characters)]
