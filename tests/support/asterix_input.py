"""Inputs that several ASTERIX tests share: plots, tracks, and any records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from random import Random
from typing import Any

import numpy as np

from plotfeed.models.state import Plots
from plotfeed.proto.asterix.codec.encode import Slot, profile
from plotfeed.proto.asterix.codec.layout import (
    DAY_LSB,
    Category,
    Characters,
    Compound,
    Explicit,
    Extended,
    Fixed,
    Group,
    Item,
    Repetitive,
    is_time_of_day,
)
from plotfeed.proto.tracks.encode_tracks import Tracks


def plots(**columns: Any) -> Plots:
    """Plots with those columns, and not measured in the others; all are as long as the longest."""
    n = max(np.size(column) for column in columns.values())
    given = {"t_utc_ns": 0, "drone": 0, "range_m": 1000.0, "azimuth_deg": 0.0} | columns
    return Plots.of(**{name: np.broadcast_to(np.asarray(v), (n,)) for name, v in given.items()})


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


def flags_of(chosen: set[int]) -> bytes:
    """The octets that say that those items are there, counted from 0."""
    octets = [0] * (max(chosen, default=0) // 7 + 1)
    for slot in chosen:
        octets[slot // 7] |= 0x80 >> slot % 7
    return bytes(octet | (i < len(octets) - 1) for i, octet in enumerate(octets))


def group_octets(group: Group, rng: Random, *, more: bool) -> bytes:
    """Any octets; its extension bit, if it has one, says whether another follows."""
    octets = rng.randbytes(group.octets)
    return octets[:-1] + bytes([octets[-1] & 0xFE | more]) if group.fx else octets


def item_octets(item: Item, rng: Random) -> bytes:
    """Any octets that the item can be."""
    match item:
        case Fixed(_, group) if is_time_of_day(item):
            return rng.randrange(DAY_LSB).to_bytes(group.octets, "big")
        case Fixed(_, group):
            return rng.randbytes(group.octets)
        case Extended(_, groups):
            n = rng.randint(1, len(groups))
            return b"".join(group_octets(groups[i], rng, more=i < n - 1) for i in range(n))
        case Repetitive(_, group):
            n = rng.randint(1, 3)
            parts = [group_octets(group, rng, more=i < n - 1) for i in range(n)]
            return (b"" if group.fx else bytes([n])) + b"".join(parts)
        case Explicit():
            inside = rng.randbytes(rng.randrange(6))
            return bytes([len(inside) + 1]) + inside
        case Compound(_, subfields):
            return slots_octets(subfields, rng)


def slots_octets(slots: Sequence[Item | None], rng: Random, *always: int) -> bytes:
    """Flags, and what they say is there: any items, and those."""
    assigned = {i: item for i, item in enumerate(slots) if item is not None}
    chosen = {*rng.sample(list(assigned), rng.randint(1, len(assigned))), *always}
    items = (item_octets(assigned[i], rng) for i in sorted(chosen))
    return flags_of(chosen) + b"".join(items)
