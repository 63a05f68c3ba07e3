"""PX4's ULog (.ulg): positions of the estimator, or of the receiver where it logged no others."""

from __future__ import annotations

import io
import math
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log
from plotfeed.models.state import AltitudeReference, Floats
from plotfeed.proto.errors import PlotfeedError

ULOG_START = b"ULog\x01\x12\x35"
HEADER_OCTETS, MESSAGE_HEAD_OCTETS = 16, 3
# Of messages, as https://docs.px4.io/main/en/dev_log/ulog_file_format.html lists them.
KINDS = frozenset(bytes([octet]) for octet in b"BFIMPQARDLCSO")
ESTIMATE = "vehicle_global_position"
RECEIVERS = ("vehicle_gps_position", "sensor_gps")
FIX_3D = 3
US_NS = 1000
# 2001: a receiver that has no time yet says 0, or the beginning of its own.
EARLIEST_UTC_US = 10**15

OLD_PLACE, PLACE = ("lat", "lon", "alt"), ("latitude_deg", "longitude_deg", "altitude_msl_m")
Rows = dict[str, Any]  # Columns of a topic, by name; arrays (n,)


def read_ulog(data: bytes, options: FlightOptions, log: Log) -> None:
    """Take every position from the first three-dimensional fix on."""
    topics = _topics(data, log)
    receiver = next((topics[name] for name in RECEIVERS if name in topics), None)
    estimate = topics.get(ESTIMATE)
    rows = receiver if estimate is None else estimate
    if rows is None:
        raise PlotfeedError(f"no positions: neither {ESTIMATE} nor {' or '.join(RECEIVERS)}")
    name = next(name for name, each in topics.items() if each is rows)
    reference = options.altitude_reference or AltitudeReference.MEAN_SEA_LEVEL
    log.state(f"height in metres, above mean sea level: topic {name}")
    offset_ns, fixed_us = _clock_ns(receiver, options, log), _first_fix_us(receiver)
    times_us = rows["timestamp"]
    latitude, longitude, altitude = _positions(rows)
    velocity, accuracies = _velocity(rows), _accuracies(rows)
    fix = rows.get("fix_type")
    for i, t_us in enumerate(times_us.tolist()):
        where = f"{name} {i + 1}"
        if t_us < fixed_us or (fix is not None and fix[i] < FIX_3D):
            log.skip(where, "no three-dimensional fix yet")
        else:
            log.take(
                where,
                t_us * US_NS + offset_ns,
                (float(latitude[i]), float(longitude[i])),
                (float(altitude[i]), reference),
                velocity_enu_m_s=None if velocity is None else tuple(map(float, velocity[i])),
                **{
                    key: float(column[i])
                    for key, column in accuracies.items()
                    if math.isfinite(column[i]) and column[i] >= 0
                },
            )


def _topics(data: bytes, log: Log) -> dict[str, Rows]:
    """The first instance of each topic that has positions."""
    need_extra("pyulog", "ULog", "ulog")
    from pyulog import ULog

    whole = _wanted_messages(data, log)
    try:
        with redirect_stdout(io.StringIO()):  # the library prints what it thinks of a file
            found = ULog(io.BytesIO(whole), [ESTIMATE, *RECEIVERS])
    except Exception as error:  # ULogException mostly; others where a definition is damaged
        line = " ".join(str(error).split())[:200] or type(error).__name__
        raise PlotfeedError(f"not a ULog file that can be read: {line}") from error
    topics: dict[str, Rows] = {}
    for each in found.data_list:
        rows = each.data
        has_place = any({"timestamp", *names} <= rows.keys() for names in (OLD_PLACE, PLACE))
        if has_place and len(rows["timestamp"]) and each.name not in topics:
            topics[each.name] = rows
    return topics


def _wanted_messages(data: bytes, log: Log) -> bytes:
    """The log with its whole messages of wanted topics alone, up to the first that is damaged.

    The library seeks in what is damaged, for ever where it is cut short, and is slow in the rest.
    """
    parts, at, wanted = [data[:HEADER_OCTETS]], HEADER_OCTETS, set[bytes]()
    while at + MESSAGE_HEAD_OCTETS <= len(data):
        kind = data[at + 2 : at + 3]
        body = at + MESSAGE_HEAD_OCTETS
        end = body + int.from_bytes(data[at : at + 2], "little")
        if kind not in KINDS or end > len(data):
            break
        if kind == b"B" and any(data[body + 8 : body + 16].lstrip(b"\x01")):
            raise PlotfeedError("a ULog file with flags that nobody knows: it cannot be read")
        if kind == b"A" and data[body + 3 : end].decode("latin-1") in (ESTIMATE, *RECEIVERS):
            wanted.add(data[body + 1 : body + 3])
            parts.append(data[at:end])
        elif kind == b"F" or (kind == b"D" and data[body : body + 2] in wanted):
            parts.append(data[at:end])
        at = end
    if at < len(data):
        log.skip(f"offset {at}", f"{len(data) - at} octets that are no whole message")
    return b"".join(parts)


def _positions(rows: Rows) -> tuple[Floats, Floats, Floats]:
    """Latitude, longitude and altitude; of old receivers' topics in 1e-7 degrees and mm."""
    if "latitude_deg" in rows:
        return rows["latitude_deg"], rows["longitude_deg"], rows["altitude_msl_m"]
    latitude, longitude, altitude = (rows[name] for name in OLD_PLACE)
    if np.issubdtype(latitude.dtype, np.integer):
        return latitude * 1e-7, longitude * 1e-7, altitude * 1e-3
    return latitude, longitude, altitude


def _velocity(rows: Rows) -> Floats | None:
    """East, north and up, of columns north, east and down; (n, 3)."""
    for north, east, down in (("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"), ("vel_n", "vel_e", "vel_d")):
        if {north, east, down} <= rows.keys():
            return np.stack([rows[east], rows[north], -rows[down]], axis=-1).astype(np.float64)
    return None


def _accuracies(rows: Rows) -> dict[str, Floats]:
    """Standard deviations as the log states them."""
    names = {
        "horizontal_accuracy_m": "eph",
        "vertical_accuracy_m": "epv",
        "velocity_accuracy_m_s": "s_variance_m_s",
    }
    return {ours: rows[theirs] for ours, theirs in names.items() if theirs in rows}


def _clock_ns(receiver: Rows | None, options: FlightOptions, log: Log) -> int:
    """UTC less the log's time since boot, by the receiver; else the log begins when it is told."""
    if receiver is not None and "time_utc_usec" in receiver:
        utc_us, boot_us = receiver["time_utc_usec"], receiver["timestamp"]
        good = utc_us.astype(np.float64) >= EARLIEST_UTC_US
        if good.any():
            apart_us = utc_us[good].astype(np.int64) - boot_us[good].astype(np.int64)
            log.state("time: the receiver's UTC")
            return int(np.median(apart_us)) * US_NS
    if options.start_utc_ns is None:
        raise PlotfeedError(
            "no UTC in this log: the time of its start must be given (start_utc_ns)"
        )
    log.assume("the log has no UTC: its clock, since boot, begins at the start")
    return options.start_utc_ns


def _first_fix_us(receiver: Rows | None) -> int:
    """When the receiver first had a three-dimensional fix, by the log's clock."""
    if receiver is None or "fix_type" not in receiver:
        return 0
    fixed = np.flatnonzero(receiver["fix_type"] >= FIX_3D)
    return int(receiver["timestamp"][fixed[0]]) if len(fixed) else 2**63
