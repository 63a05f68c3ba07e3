"""Category 205, bearings of radio direction finders, one record a data block: encoder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import IntEnum

import numpy as np

from plotfeed.models.state import Floats, Ints, Plots, Texts
from plotfeed.proto.asterix.codec.encode import Constant
from plotfeed.proto.asterix.codec.reports import (
    Parts,
    Reports,
    checked_position,
    looked_up,
    measured,
)
from plotfeed.proto.asterix.layout_205 import CAT205
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.units import TIME_LSB_NS, decibels

DBUV_AT_0_DBM = 90 + 10 * math.log10(50)  # 0 dBm into 50 ohm, over 1 µV
BEST_QUALITY = 255
REPORTS = 1 << 8  # I205/040 counts so far, then from 0


class Message205(IntEnum):
    """The type of a report of a bearing, I205/000."""

    SYSTEM_BEARING = 2
    SENSOR_DATA = 5


class BearingEncoder205:
    """Bearings, as I205/010, 000, 030, 040, 050, 070, and of 180, 190, 200 what is measured.

    Latitude and longitude are the sensor's. `sensor` is its I205/170, which the standard asks for
    where sensors share a source. `channel_names` has a name of seven characters, digits and a
    point, for each channel of the plots; without it I205/090 is not sent. `best_snr_db` is the SNR
    from which on the quality of a signal is the best there is, 255; it is 0 at 0 dB. Several
    sensors have a SAC, SIC, latitude and longitude each, in sequences.
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        latitude_deg: float | Sequence[float],
        longitude_deg: float | Sequence[float],
        message: Message205 = Message205.SENSOR_DATA,
        sensor: int | None = None,
        channel_names: Mapping[int, str] | None = None,
        best_snr_db: float = 40.0,
    ) -> None:
        checked_position(latitude_deg, longitude_deg, field="I205/050")
        self._channel_names = channel_names
        self._db_a_step = best_snr_db / BEST_QUALITY
        constants: dict[str, Constant] = {
            "I205/010/SAC": sac,
            "I205/010/SIC": sic,
            "I205/000": message,
            "I205/050/LAT": latitude_deg,
            "I205/050/LON": longitude_deg,
        }
        always = ["I205/010", "I205/000", "I205/030", "I205/040", "I205/050", "I205/070"]
        if sensor is not None:
            constants["I205/170"] = sensor
            always.append("I205/170")
        self._reports = Reports(
            CAT205,
            always,
            ("I205/090", "I205/180", "I205/190", "I205/200"),
            constants=constants,
            lsb={"I205/030": TIME_LSB_NS},
            one_a_block=True,
        )

    def blocks(self, plots: Plots, sent_utc_ns: int, *, first_report: int = 0) -> list[bytes]:
        """A data block a plot of one sensor, sent at that time and numbered from there on.

        A column of nothing but NaN is not measured; one with some NaN is an EncodeError.
        """
        sent, first = (np.array([number], np.int64) for number in (sent_utc_ns, first_report))
        return self.blocks_by(plots, Parts.whole(len(plots)), sent, first)[0]

    def blocks_by(
        self, plots: Plots, parts: Parts, sent_utc_ns: Ints, first_report: Ints
    ) -> list[list[bytes]]:
        """A data block a plot, by the parts of the plots; all of them measure the same.

        Each part has a time at which it is sent, and a number of its first plot, (m,).
        """
        if not len(plots):
            return [[] for _ in range(len(parts))]
        columns: dict[str, Floats | Ints | Texts] = {
            "I205/030": np.repeat(sent_utc_ns, parts.lengths()),
            "I205/040": parts.numbered_from(first_report) % REPORTS,
            "I205/070": plots.azimuth_deg,
        }
        level = measured(plots, {"I205/180": "amplitude_dbm"})
        columns |= {path: dbm + DBUV_AT_0_DBM for path, dbm in level.items()}
        snr = measured(plots, {"I205/190": "snr"})
        columns |= {path: self._quality(path, ratio) for path, ratio in snr.items()}
        columns |= measured(plots, {"I205/200": "elevation_deg"})
        if self._channel_names is not None:
            path = "I205/090"
            names = looked_up(self._channel_names, plots.channel, "name for channel", path)
            columns[path] = names
        return self._reports.blocks_by(columns, parts)

    def _quality(self, path: str, snr: Floats) -> Ints:
        if not (snr > 0).all():
            raise EncodeError("an SNR is not above 0", field=path)
        steps = np.rint(decibels(snr) / self._db_a_step)
        quality: Ints = np.clip(steps, 0, BEST_QUALITY).astype(np.int64)
        return quality
