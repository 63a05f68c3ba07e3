"""Many plots at once as protobuf of one length each, where they measure the same.

The octets are those that protobuf itself makes: fields in the order of their numbers, no defaults.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Floats, Plots
from plotfeed.proto import plotfeed_pb2 as pb
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
