"""Category 205, bearings of radio direction finders, a record a block: layout, encoder, format.

EUROCONTROL-SPEC-0149, category 205, edition 1.0; `codec.layout` explains the table. I205/030 is the
time of transmission, not of measurement. A bearing starts at I205/050 (I205/070) or at I205/060
(I205/080), which are positions of the sensor in messages of types 2 and 5. The category has no item
for the error of a bearing, the time of its measurement or what the emission says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING

from plotfeed.proto.asterix.cat025 import CAT025, STATUS
from plotfeed.proto.asterix.codec.encode import Parts, Reports, checked_position, measured
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.lazy_numpy import np
from plotfeed.proto.report_format import PlotItems, SentCategory, asterix
from plotfeed.proto.units import decibels

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from plotfeed.models.state import Floats, Ints, Plots

CAT205 = category(
    205,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I205/010  2       SAC 8, SIC 8
2    I205/015  1       SID 8
3    I205/000  1       TYPE 8
4    I205/030  3       TOD 24: 1/128 s modulo 86400
5    I205/040  1       NUMBER 8
6    I205/090  7       CHANNEL 7x8
7    I205/050  8       LAT ±32: 180/2^25 deg refused, LON ±32: 180/2^25 deg refused
8    I205/060  6       X ±24: 1/2 m, Y ±24: 1/2 m
9    I205/070  2       BEARING 16: 0.01 deg modulo 360
10   I205/080  2       BEARING 16: 0.01 deg modulo 360
11   I205/100  1       QUALITY 8
12   I205/110  1       RADIUS 8: 100 m
13   I205/120  1+1n    repeated: SENSOR 8
14   I205/130  8       LAT ±32: 180/2^25 deg refused, LON ±32: 180/2^25 deg refused
15   I205/140  6       X ±24: 1/2 m, Y ±24: 1/2 m
16   I205/150  1       RADIUS 8: 100 m
17   I205/160  2       TRN 16
18   I205/170  1       SENSOR 8
19   I205/180  2       LEVEL ±16: 0.01 dBµV
20   I205/190  1       QUALITY 8
21   I205/200  2       ELEVATION ±16: 0.01 deg
22   I205/SP   1+n     octets behind their count
""",
)

DBUV_AT_0_DBM = 90 + 10 * math.log10(50)  # 0 dBm into 50 ohm, over 1 µV
BEST_QUALITY, BEST_SNR_DB = 255, 40.0  # from which on it is the best that there is
REPORTS = 1 << 8  # I205/040 counts so far, then from 0


class Message205(IntEnum):
    """The type of a report of a bearing, I205/000."""

    SYSTEM_BEARING = 2
    SENSOR_DATA = 5


# Its time is that of sending.
FORMAT = asterix(
    {205: SentCategory("bearings"), 25: STATUS},
    layouts=(CAT205, CAT025),
    needs_azimuth=True,
    plot_items=PlotItems(
        columns={"azimuth_deg": "I205/070", "elevation_deg": "I205/200", "identity": "I205/090"},
        plots_alone=("I205/000", (Message205.SYSTEM_BEARING, Message205.SENSOR_DATA)),
    ),
)


class BearingEncoder205(Reports):
    """Bearings, as I205/010, 000, 030, 040, 050, 070, and of 180, 190, 200 what is measured.

    Latitude and longitude are the sensor's. The quality of a signal grows with the SNR in decibels
    and is 0 at 0 dB. Several sensors
    have a SAC, SIC, latitude and longitude each, in sequences. Further, `blocks` takes the time at
    which all are sent and the number of the first, `blocks_by` both of each part, (m,).
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        latitude_deg: float | Floats,
        longitude_deg: float | Floats,
    ) -> None:
        checked_position(latitude_deg, longitude_deg, field="I205/050")
        super().__init__(
            CAT205,
            ("I205/010", "I205/000", "I205/030", "I205/040", "I205/050", "I205/070"),
            ("I205/180", "I205/190", "I205/200"),
            constants={
                "I205/010/SAC": sac,
                "I205/010/SIC": sic,
                "I205/000": Message205.SENSOR_DATA,
                "I205/050/LAT": latitude_deg,
                "I205/050/LON": longitude_deg,
            },
            one_a_block=True,
        )

    def _columns(
        self, plots: Plots, parts: Parts, sent_utc_ns: ArrayLike, first_report: ArrayLike = 0
    ) -> Mapping[str, ArrayLike]:
        columns: dict[str, Floats | Ints] = {
            "I205/030": np.repeat(np.atleast_1d(sent_utc_ns), parts.lengths()),
            "I205/040": parts.numbered_from(np.atleast_1d(first_report)) % REPORTS,
            "I205/070": plots.azimuth_deg,
        }
        level = measured(plots, {"I205/180": "amplitude_dbm"})
        columns |= {path: dbm + DBUV_AT_0_DBM for path, dbm in level.items()}
        for path, snr in measured(plots, {"I205/190": "snr"}).items():
            if not (snr > 0).all():
                raise EncodeError("an SNR is not above 0", field=path)
            steps = np.rint(decibels(snr) / (BEST_SNR_DB / BEST_QUALITY))
            columns[path] = np.clip(steps, 0, BEST_QUALITY).astype(np.int64)
        columns |= measured(plots, {"I205/200": "elevation_deg"})
        return columns
