"""Unmanned aircraft that say where they are, in category 129: one report a data block."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.proto.asterix.cat129 import CAT129
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.asterix.codec.encode import Reports, checked_position
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS
from plotfeed.proto.errors import DecodeError, EncodeError
from plotfeed.proto.units import TIME_LSB_NS

CATEGORY = 129
DAY_S = 86_400
SERIAL_LENGTH, MAKER_LENGTH, COUNTRY_LENGTH = 12, 3, 2


@dataclass(frozen=True, slots=True, kw_only=True)
class UasReport:
    """Who is where, and when since midnight UTC; "" and NaN for what was not sent.

    Altitude is above mean sea level, height above ground. `accuracy_m` is the radius that holds
    half of the positions.
    """

    serial: str
    manufacturer: str
    model: str
    country: str
    t_of_day_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    height_m: float
    accuracy_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    climb_m_s: float

    @property
    def identity(self) -> str:
        """The serial number, or whatever else was sent of its name."""
        others = (self.country, self.manufacturer, self.model)
        return self.serial or "-".join(filter(None, others))


def is_block_129(payload: bytes) -> bool:
    """Whether octets look like one data block of the category, and nothing else."""
    return (
        len(payload) > HEADER_OCTETS
        and payload[0] == CATEGORY
        and int.from_bytes(payload[1:HEADER_OCTETS], "big") == len(payload)
    )


def read_129(data: bytes) -> list[UasReport]:
    """The reports in data blocks, of which all must be of category 129.

    A name that is not printable ASCII, whose encoding the standard leaves open, is in hexadecimal.
    One without a time of the day or a position on the globe is a DecodeError.
    """
    return [_report(record) for record in decode(data)]


def _report(record: Record) -> UasReport:
    def number(path: str) -> float:
        value = record.get(path)
        return value if isinstance(value, float) else math.nan

    def text(path: str) -> str:
        value = record.get(path)
        if not isinstance(value, str):
            return ""
        name = value.rstrip(" \0")
        readable = name.isascii() and name.isprintable()
        return name if readable else value.encode("latin-1").hex()

    if record.category != CAT129.number:
        raise DecodeError(f"category {record.category}, not 129", at_octet=record.at_octet)
    for path in ("I129/070", "I129/080/LAT"):
        if record.get(path) is None:
            raise DecodeError(f"a report without {path[:8]}", at_octet=record.at_octet)
    if number("I129/070") > DAY_S:  # a day's whole length is what a sender without modulo sends
        raise DecodeError("a time beyond midnight", at_octet=record.at_octet)
    report = UasReport(
        serial=text("I129/040"),
        manufacturer=text("I129/020"),
        model=text("I129/030"),
        country=text("I129/050"),
        t_of_day_s=number("I129/070") % DAY_S,
        latitude_deg=number("I129/080/LAT"),
        longitude_deg=number("I129/080/LON"),
        altitude_m=number("I129/090"),
        height_m=number("I129/100"),
        accuracy_m=number("I129/110") or math.nan,
        velocity_east_m_s=number("I129/185/VX"),
        velocity_north_m_s=number("I129/185/VY"),
        climb_m_s=number("I129/220"),
    )
    if abs(report.latitude_deg) > 90 or abs(report.longitude_deg) > 180:
        raise DecodeError("a position off the globe", at_octet=record.at_octet)
    return report


class TargetEncoder129:
    """Reports of unmanned aircraft of one make, as I129/010, 040, 050, 070, 080 and what is given.

    That is 020 and 030 here, 090, 100, 110, 185 and 220 with each call. The source is 0/0 for what
    comes from the air, as the standard advises.
    """

    def __init__(
        self,
        sac: int = 0,
        sic: int = 0,
        *,
        country: str,
        manufacturer: str = "",
        model: str = "",
    ) -> None:
        constants: dict[str, float | str] = {
            "I129/010/SAC": sac,
            "I129/010/SIC": sic,
            "I129/050": _padded(country, COUNTRY_LENGTH, "I129/050"),
        }
        for path, name in (("I129/020", manufacturer), ("I129/030", model)):
            if name:
                constants[path] = _padded(name, MAKER_LENGTH, path)
        always = ("I129/010", "I129/040", "I129/070", "I129/080")
        self._reports = Reports(
            CAT129,
            (*always, *(path for path in constants if path.count("/") == 1)),
            ("I129/090", "I129/100", "I129/110", "I129/185", "I129/220"),
            constants=constants,
            lsb={"I129/070": TIME_LSB_NS},
            one_a_block=True,
        )

    def blocks(
        self,
        serials: Sequence[str],
        t_utc_ns: ArrayLike,
        latitude_deg: ArrayLike,
        longitude_deg: ArrayLike,
        *,
        altitude_m: ArrayLike | None = None,
        height_m: ArrayLike | None = None,
        accuracy_m: ArrayLike | None = None,
        velocity_m_s: ArrayLike | None = None,
    ) -> list[bytes]:
        """A data block for each serial number, of columns (n,); velocity is (n, 3), east-north-up.

        The standard wants an altitude above mean sea level or a height above ground.
        """
        checked_position(latitude_deg, longitude_deg, field="I129/080")
        columns: dict[str, Any] = {
            "I129/040": [_padded(serial, SERIAL_LENGTH, "I129/040") for serial in serials],
            "I129/070": t_utc_ns,
            "I129/080/LAT": latitude_deg,
            "I129/080/LON": longitude_deg,
        }
        optional = {"I129/090": altitude_m, "I129/100": height_m, "I129/110": accuracy_m}
        columns |= {path: column for path, column in optional.items() if column is not None}
        if velocity_m_s is not None:
            velocity = np.asarray(velocity_m_s, dtype=np.float64).reshape(-1, 3)
            axes = ("I129/185/VX", "I129/185/VY", "I129/220")
            columns |= dict(zip(axes, velocity.T, strict=True))
        return self._reports.blocks(columns) if len(serials) else []


def _padded(text: str, length: int, path: str) -> str:
    if not text.isascii() or not text.isprintable() or len(text) > length:
        raise EncodeError(f"{text!r} is not up to {length} characters of ASCII", field=path)
    return text.ljust(length)
