"""Category 129, unmanned aircraft that say where they are: layout and encoder.

An accuracy (circular error, 50 %) of 0 says unknown or above 255 m; it is rounded up. Sent from the
air, the source is 0/0.

EUROCONTROL-SPEC-0149-29, edition 1.2; `codec.layout` explains the table. No decoder that the tests
can run reads the category: the layout is as published descriptions of edition 1.2 have it.

I129/090 is above mean sea level, I129/100 above ground; I129/185 is east and north. No encoding is
stated for a serial number; it is read as ASCII. The standard gives I129/120 one octet in a table
but three in its description, which is followed here; it describes the first of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from plotfeed.proto.asterix.codec.encode import Reports, checked_position
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.lazy_numpy import np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

CAT129 = category(
    129,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I129/010  2       SAC 8, SIC 8
2    I129/015  2       DAC 8, DIC 8
3    I129/020  3       MANUFACTURER 3x8
4    I129/030  3       MODEL 3x8
5    I129/040  12      SERIAL 12x8
6    I129/050  2       COUNTRY 2x8
7    I129/070  3       TOD 24: 1/128 s modulo 86400
8    I129/080  8       LAT ±32: 180/2^30 deg refused, LON ±32: 180/2^30 deg refused
9    I129/090  3       ALTITUDE ±24: 0.1 m
10   I129/100  3       HEIGHT ±24: 0.1 m
11   I129/110  2       ACCURACY 16: 1 m
12   I129/120  3       UCC 2, ARC 2, AEC 4, _16
13   I129/SP   1+n     octets behind their count
14   I129/185  5       VX ±20: 0.01 m/s, VY ±20: 0.01 m/s
15   I129/220  3       _4, VZ ±20: 0.01 m/s
""",
)

SERIAL_LENGTH, COUNTRY_LENGTH = 12, 2
MOST_ACCURACY_M = 255.0


class TargetEncoder129:
    """Reports of unmanned aircraft, as I129/010, 040, 050, 070, 080, and what is given with each.

    That is 090, 100, 110, 185 and 220. The source is 0/0 for what comes from the air, as the
    standard advises.
    """

    def __init__(self, sac: int = 0, sic: int = 0, *, country: str) -> None:
        self._reports = Reports(
            CAT129,
            ("I129/010", "I129/040", "I129/050", "I129/070", "I129/080"),
            ("I129/090", "I129/100", "I129/110", "I129/185", "I129/220"),
            constants={
                "I129/010/SAC": sac,
                "I129/010/SIC": sic,
                "I129/050": _padded(country, COUNTRY_LENGTH, "I129/050"),
            },
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
            "I129/080/LAT": latitude_deg,
            "I129/080/LON": longitude_deg,
        }
        optional = {"I129/090": altitude_m, "I129/100": height_m, "I129/110": accuracy_m}
        columns |= {path: column for path, column in optional.items() if column is not None}
        if accuracy_m is not None:
            rounded_m = np.maximum(np.ceil(np.asarray(accuracy_m, np.float64)), 1.0)
            columns["I129/110"] = np.where(rounded_m > MOST_ACCURACY_M, 0.0, rounded_m)
        if velocity_m_s is not None:
            velocity = np.asarray(velocity_m_s, dtype=np.float64).reshape(-1, 3)
            axes = ("I129/185/VX", "I129/185/VY", "I129/220")
            columns |= dict(zip(axes, velocity.T, strict=True))
        return self._reports.one_each(t_utc_ns, np.zeros(len(serials), np.int64), columns)


def _padded(text: str, length: int, path: str) -> str:
    if not text.isascii() or not text.isprintable() or len(text) > length:
        raise EncodeError(f"{text!r} is not up to {length} characters of ASCII", field=path)
    return text.ljust(length)
