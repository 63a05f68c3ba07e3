"""plotfeed's own messages from structures of arrays, and plots from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from google.protobuf.message import DecodeError as ProtobufDecodeError
from numpy.typing import NDArray

from plotfeed.models.state import Floats, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.units import decibels
from plotfeed.proto.varint import varint

VARINT, DOUBLE, MESSAGE = 0, 1, 2  # Wire types
TIME_OCTETS = 9  # Of a time since 1970 that is not years before 1973 nor centuries ahead
EARLIEST_NS, LATEST_NS = 1 << 7 * (TIME_OCTETS - 1), (1 << 7 * TIME_OCTETS) - 1
MOST_IN_AN_OCTET = 127
_FIELDS = pb.Plot.DESCRIPTOR.fields_by_name
_OF_BATCH = pb.PlotBatch.DESCRIPTOR.fields_by_name["plots"].number << 3 | MESSAGE


def rows_of(plots: Plots, doubles: dict[str, Floats]) -> NDArray[np.void] | None:
    """Each plot as a field of its batch, (n,); None where they are not of one length.

    `doubles` are the columns that may be left out where they are NaN. At least one plot.
    """
    t_utc_ns, held = plots.t_utc_ns, vars(plots)
    if t_utc_ns.min() < EARLIEST_NS or t_utc_ns.max() > LATEST_NS:
        return None
    if any(name in held and any(held[name]) for name in ("kind", "identity")):
        return None
    known = {}
    for name, column in doubles.items():
        missing = np.isnan(column)
        if not missing.any():
            known[name] = column
        elif not missing.all():
            return None
    channel = held.get("channel")
    if channel is not None and not channel.any():
        channel = None
    if channel is not None and (channel.min() < 1 or channel.max() > MOST_IN_AN_OCTET):
        return None
    return _filled(t_utc_ns, channel, known)


def _filled(
    t_utc_ns: NDArray[np.int64], channel: NDArray[np.int64] | None, known: dict[str, Floats]
) -> NDArray[np.void]:
    tags = {"time_utc_ns": _tag("time_utc_ns", VARINT)}
    tags |= {name: _tag(name, DOUBLE) for name in known}
    if channel is not None:
        tags["channel"] = _tag("channel", VARINT)
    names = sorted(tags, key=lambda name: _FIELDS[name].number)
    sizes = {"time_utc_ns": TIME_OCTETS, "channel": 1}
    template, places = b"", {}
    for name in names:
        template += tags[name]
        places[name] = len(template)
        template += bytes(sizes.get(name, 8))
    head = varint(_OF_BATCH) + varint(len(template))
    template = head + template
    formats: dict[str, object] = {"time_utc_ns": f"{TIME_OCTETS}u1", "channel": "u1"}
    rows = np.repeat(np.frombuffer(template, f"V{len(template)}"), len(t_utc_ns))
    view = rows.view(
        np.dtype(
            {
                "names": names,
                "formats": [formats.get(name, "<f8") for name in names],
                "offsets": [len(head) + places[name] for name in names],
                "itemsize": len(template),
            }
        )
    )
    shifts = np.arange(0, 7 * TIME_OCTETS, 7)
    view["time_utc_ns"] = t_utc_ns[:, None] >> shifts & 0x7F | _MORE
    for name, column in known.items():
        view[name] = column
    if channel is not None:
        view["channel"] = channel
    return rows


_MORE = np.array([0x80] * (TIME_OCTETS - 1) + [0])


def _tag(name: str, wire_type: int) -> bytes:
    return varint(_FIELDS[name].number << 3 | wire_type)


# Of numbers that plots may lack; `Plots` has no decibels, which are worked out.
_PLOT_COLUMNS = [field.name for field in _FIELDS.values() if field.type == field.TYPE_DOUBLE]
_TEXTS = ("kind", "identity")
_SCAN, _SECTOR = (
    varint(pb.PlotBatch.DESCRIPTOR.fields_by_name[name].number << 3) for name in ("scan", "sector")
)
MANY = 8  # Plots from which on it is faster to fill rows of octets than objects of protobuf


def plot_batches(
    sensors: Sequence[str],
    scans: Sequence[int],
    sectors: Sequence[int],
    plots: Plots,
    by: Sequence[int],
) -> list[bytes]:
    """Serialised PlotBatches of sectors, (m,); what is NaN is left out.

    The plots of sector i are the rows from `by[i]` up to `by[i + 1]`, (m+1,).
    """
    heads = list(map(_head, sensors, scans, sectors))
    if not len(plots):
        return heads
    held = vars(plots)
    doubles = {name: held[name] for name in _PLOT_COLUMNS if held.get(name) is not None}
    if held.get("snr") is not None:
        doubles["snr_db"] = decibels(plots.snr)
    if len(plots) >= MANY and (rows := rows_of(plots, doubles)) is not None:
        octets, length = rows.tobytes(), rows.itemsize
        return [
            head + octets[first * length : after * length]
            for head, (first, after) in zip(heads, pairwise(by), strict=True)
        ]
    # Protobuf's messages may be put together by joining their octets.
    batches = _one_by_one(plots, doubles, by)
    return [head + batch.SerializeToString() for head, batch in zip(heads, batches, strict=True)]


@lru_cache(maxsize=4096)
def _sensor(sensor: str) -> bytes:
    return pb.PlotBatch(sensor=sensor).SerializeToString()


def _head(sensor: str, scan: int, sector: int) -> bytes:
    """A batch without plots."""
    head = _sensor(sensor)
    if scan:
        head += _SCAN + varint(scan)
    if sector:
        head += _SECTOR + varint(sector)
    return head


def _one_by_one(
    plots: Plots, doubles: Mapping[str, Floats], by: Sequence[int]
) -> Iterator[pb.PlotBatch]:
    """Batches of plots alone."""
    held = vars(plots)
    columns = [(name, column.tolist()) for name, column in doubles.items()]
    columns += [(name, held[name].tolist()) for name in ("channel", *_TEXTS) if name in held]
    times = plots.t_utc_ns.tolist()
    for first, after in pairwise(by):
        batch = pb.PlotBatch()
        for i in range(first, after):
            # A number that is not equal to itself is NaN.
            known = {name: values[i] for name, values in columns if values[i] == values[i]}
            batch.plots.add(time_utc_ns=times[i], **known)
        yield batch


def batch_in(payload: bytes) -> pb.PlotBatch:
    """Batch of plots of our own format; raises `DecodeError`."""
    try:
        return pb.PlotBatch.FromString(payload)
    except ProtobufDecodeError:
        raise DecodeError(f"{len(payload)} octets that are not a PlotBatch") from None


def plots_in_batch(payload: bytes, _near_utc_ns: int = 0) -> MeasuredPlots:
    """Plots of an encoded batch, whose times need none that is near; raises `DecodeError`."""
    return plots_of_batches([batch_in(payload)])


def plots_of_batches(batches: Sequence[pb.PlotBatch]) -> MeasuredPlots:
    """Plots of batches, in their order."""
    return MeasuredPlots.of(
        {"t_utc_ns": plot.time_utc_ns, "sensor": batch.sensor, "channel": plot.channel}
        | {field.name: value for field, value in plot.ListFields()}
        for batch in batches
        for plot in batch.plots
    )
