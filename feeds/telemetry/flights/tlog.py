"""MAVLink telemetry logs (.tlog): microseconds of UTC, big-endian, before every MAVLink frame."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

STAMP_OCTETS = 8
MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
_SIGNED = 0x01
_SIGNATURE_OCTETS = 13
_GLOBAL_POSITION_INT = 33

_MAGIC = re.compile(b"[\xfd\xfe]")

Sender = tuple[int, int]
Decode = Callable[[bytes], Any | None]


@dataclass(frozen=True, slots=True)
class _Frame:
    """One MAVLink frame, and where in the file its stamp stands."""

    offset: int
    t_utc_ns: int
    octets: bytes

    @property
    def message_id(self) -> int:
        if self.octets[0] == MAGIC_V1:
            return self.octets[5]
        return int.from_bytes(self.octets[7:10], "little")

    @property
    def sender(self) -> Sender:
        at = 3 if self.octets[0] == MAGIC_V1 else 5
        return self.octets[at], self.octets[at + 1]


def read_tlog(data: bytes, options: FlightOptions, log: Log) -> None:
    """Take every GLOBAL_POSITION_INT of the vehicle that sent most of them."""
    reference = options.altitude_reference or AltitudeReference.MEAN_SEA_LEVEL
    decode = _decoder()
    frames = [f for f in _frames(data, decode, log) if f.message_id == _GLOBAL_POSITION_INT]
    senders = Counter(frame.sender for frame in frames)
    vehicle = senders.most_common(1)[0][0] if senders else None
    for frame in frames:
        where = f"offset {frame.offset}"
        if frame.sender != vehicle:
            log.skip(where, f"from system {frame.sender[0]}, not the one with most positions")
        elif (message := decode(frame.octets)) is None:
            log.skip(where, "damaged: its checksum is wrong")
        else:
            _take(where, frame.t_utc_ns, message, reference, log)


def _take(where: str, t_utc_ns: int, message: Any, reference: AltitudeReference, log: Log) -> None:
    if message.lat == 0 and message.lon == 0:
        log.skip(where, "position 0, 0: no GPS fix")
        return
    log.take(
        where,
        t_utc_ns=t_utc_ns,
        latitude_deg=message.lat * 1e-7,
        longitude_deg=message.lon * 1e-7,
        altitude_m=message.alt * 1e-3,
        altitude_reference=reference,
        # vx is north, vy east, vz down, cm/s
        velocity_enu_m_s=(message.vy * 0.01, message.vx * 0.01, -message.vz * 0.01),
    )


def _decoder() -> Decode:
    """A function from a frame to its message, or to None where no checksum proves it one."""
    try:
        from pymavlink.dialects.v20 import common
    except ImportError as error:
        raise PlotfeedError("tlog needs pymavlink: pip install 'plotfeed[mavlink]'") from error
    mavlink = common.MAVLink(None)

    def decode(frame: bytes) -> Any | None:
        try:
            message = mavlink.decode(bytearray(frame))
        except Exception:  # noqa: BLE001 - pymavlink raises what it likes at damaged frames
            return None
        return None if isinstance(message, common.MAVLink_unknown) else message

    return decode


def _frames(data: bytes, decode: Decode, log: Log) -> Iterator[_Frame]:
    """Every stamped frame; octets between them that are none are passed over and told."""
    bad_from = search_from = 0
    while (found := _MAGIC.search(data, search_from + STAMP_OCTETS)) is not None:
        offset = found.start() - STAMP_OCTETS
        octets = _frame_octets(data, found.start())
        frame = data[found.start() : found.start() + (octets or 0)]
        # Where the last frame ended the next is expected; elsewhere only a checksum tells.
        expected = octets and offset == bad_from and _followed(data, found.start() + octets)
        if octets is None or not (expected or decode(frame)):
            search_from = offset + 1
            continue
        if offset > bad_from:
            log.skip(f"offset {bad_from}", f"{offset - bad_from} octets that are no frame")
        stamp_us = int.from_bytes(data[offset : found.start()], "big")
        yield _Frame(offset, stamp_us * 1000, frame)
        search_from = bad_from = found.start() + octets
    if len(data) > bad_from:
        log.skip(f"offset {bad_from}", f"{len(data) - bad_from} octets that are no frame")


def _followed(data: bytes, end: int) -> bool:
    """Whether another stamped frame seems to begin there, or the file ends."""
    if end + STAMP_OCTETS >= len(data):
        return end == len(data)
    return data[end + STAMP_OCTETS] in (MAGIC_V1, MAGIC_V2)


def _frame_octets(data: bytes, start: int) -> int | None:
    """Length of the frame that starts there and is whole; None if none does."""
    if data[start] not in (MAGIC_V1, MAGIC_V2) or start + 3 > len(data):
        return None
    octets = data[start + 1] + 8
    if data[start] == MAGIC_V2:
        octets += 4 + (_SIGNATURE_OCTETS if data[start + 2] & _SIGNED else 0)
    return octets if start + octets <= len(data) else None


def looks_like_tlog(data: bytes) -> bool:
    """Whether a stamped frame stands at the start, and another after it or the end."""
    octets = _frame_octets(data, STAMP_OCTETS) if len(data) > STAMP_OCTETS else None
    if octets is None:
        return False
    after = STAMP_OCTETS + octets + STAMP_OCTETS
    return after >= len(data) or data[after] in (MAGIC_V1, MAGIC_V2)
