"""Plots from octets of ASTERIX: where the records of each category tell of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from itertools import chain
from typing import Any

from plotfeed.proto.asterix.cat015 import Geometry
from plotfeed.proto.asterix.categories import CATEGORIES, PLOT_ITEMS, TRACK_ITEMS
from plotfeed.proto.asterix.codec.decode import Record, decode, decode_lenient
from plotfeed.proto.asterix.codec.layout import Compound, Fixed, Item, Named, Quantity
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.report_format import PlotItems
from plotfeed.proto.utc import NS, nearest_utc_ns

# Columns that the ranges of 015 are of, where a record says that its sensor is multistatic.
MULTISTATIC = {"range_m": "bistatic_range_m", "sigma_range_m": "sigma_bistatic_range_m"}


@cache
def steps_of(category: int) -> Mapping[str, float]:
    """Steps in which a category tells columns of plots, in their units; none for other formats."""
    items = PLOT_ITEMS.get(category)
    if items is None:
        return {}
    parts = dict(chain.from_iterable(map(_parts_of, CATEGORIES[category].uap)))
    found = {name: parts[path] for name, path in items.columns.items()}
    steps = {
        name: part.lsb * items.units.get(name, 1.0)
        for name, part in found.items()
        if isinstance(part, Quantity)
    }
    return steps | {own: steps[name] for name, own in MULTISTATIC.items() if name in steps}


def _parts_of(item: Item | None, path: str = "") -> Iterator[tuple[str, Named]]:
    """Named parts of an item by their paths, but for those that repeat."""
    if isinstance(item, Compound):
        for subfield in item.subfields:
            yield from _parts_of(subfield, f"{path}{item.name}/")
    elif isinstance(item, Fixed):
        fields = item.group.fields
        for part, _ in fields:
            yield (
                (f"{path}{item.name}" if len(fields) == 1 else f"{path}{item.name}/{part.name}"),
                part,
            )


def plots_in_asterix(payload: bytes, near_utc_ns: int) -> MeasuredPlots:
    """Plots of all records of categories that have any; raises `DecodeError`.

    A time of day is of the day that brings it nearest to `near_utc_ns`.
    """
    records = (record for record in decode(payload) if record.category in PLOT_ITEMS)
    told = (_told(record, near_utc_ns) for record in records)
    return MeasuredPlots.of(plot for plot in told if plot is not None)


def told_of_plots_and_tracks(payload: bytes, near_utc_ns: int) -> list[dict[str, Any]] | None:
    """What is told of each plot and track of the records that are whole, by column.

    None without a record that could be any.
    """
    records = [record for record in decode_lenient(payload)[0] if _items_of(record)]
    if not records:
        return None
    return [told for told in (_told(record, near_utc_ns) for record in records) if told is not None]


def plots_and_tracks_in(payload: bytes, near_utc_ns: int) -> MeasuredPlots | None:
    """Plots and tracks of the records that are whole; None without one that could be any."""
    told = told_of_plots_and_tracks(payload, near_utc_ns)
    return None if told is None else MeasuredPlots.of(told)


def _items_of(record: Record) -> PlotItems | None:
    return PLOT_ITEMS.get(record.category) or TRACK_ITEMS.get(record.category)


def _told(record: Record, near_utc_ns: int) -> dict[str, Any] | None:
    """What a record tells of a plot, by column; None if it says that it is none."""
    items = _items_of(record) or PLOT_ITEMS[record.category]
    part, values = items.plots_alone
    if part and record.get(part) not in values:
        return None
    told: dict[str, Any] = {"category": record.category}
    is_multistatic = record.get("I015/020/MOMU") == Geometry.MULTISTATIC
    for item, columns in _columns_by_item(record.category).items():
        if item not in record.items:
            continue
        for name, path in columns:
            value = record.get(path)
            if value is None:
                continue
            if name == "t_utc_ns" and isinstance(value, float):
                value = nearest_utc_ns(round(value * NS), near_utc_ns)
            elif name == "address" and isinstance(value, int):
                value = f"{value:06X}"
            elif isinstance(value, float):
                value *= items.units.get(name, 1.0)
            told[MULTISTATIC.get(name, name) if is_multistatic else name] = value
    return told


@cache
def _columns_by_item(category: int) -> dict[str, list[tuple[str, str]]]:
    """Columns and where they stand, by the items that a record may lack."""
    items = PLOT_ITEMS.get(category) or TRACK_ITEMS[category]
    place = f"I{category:03d}/010"
    of_all = {"sac": f"{place}/SAC", "sic": f"{place}/SIC"}
    of_all |= {"t_utc_ns": CATEGORIES[category].time, **items.columns}
    found: dict[str, list[tuple[str, str]]] = {}
    for name, path in of_all.items():
        found.setdefault("/".join(path.split("/")[:2]), []).append((name, path))
    return found
