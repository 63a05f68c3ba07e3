"""Categories 048 and 034, a radar's plots, north markers and sectors: encoders.

A radar sends the plots of a sector first and then the sector message with the azimuth at which
that sector ends, both in one datagram; at north it sends a north marker.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.state import Ints, Plots
from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Constant, Encoder, blocks_of_one
from plotfeed.proto.asterix.codec.reports import Parts, Reports, checked_position, measured
from plotfeed.proto.asterix.layout_048 import CAT034, CAT048
from plotfeed.proto.units import FOOT_M, NM_M, TIME_LSB_NS

RHO_LSB_M = NM_M / 256  # I048/040
PRIMARY = 1  # I048/020/TYP: single primary detection
NORTH_MARKER, SECTOR_CROSSING = 1, 2  # I034/000

OPTIONAL = {
    "I048/130/PRL": "run_length_deg",
    "I048/130/PAM": "amplitude_dbm",
    "I048/110": "height_m",
    "I048/120/CAL/CAL": "range_rate_m_s",
}
"""Parts that are sent where their columns are measured."""


class PlotEncoder048:
    """Plots of a primary radar, as I048/010, 140, 020, 040, and of 130, 110, 120 what is measured.

    `geoid_undulation_m` is the height of mean sea level above the WGS-84 ellipsoid where the plots
    are, one for all or (n,): they have heights above the latter, I048/110 above the former. The
    Doppler speed of 120 is the range rate in whole m/s; the standard leaves its sign open: here a
    positive one recedes. Several radars have a SAC, SIC and limit of octets each, in sequences.
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        simulated: bool = True,
        max_octets: int | Sequence[int] = UDP_OCTETS,
    ) -> None:
        self._reports = Reports(
            CAT048,
            ("I048/010", "I048/140", "I048/020", "I048/040"),
            ("I048/130/PRL", "I048/130/PAM", "I048/110", "I048/120/CAL"),
            constants={
                "I048/010/SAC": sac,
                "I048/010/SIC": sic,
                "I048/020/TYP": PRIMARY,
                "I048/020/SIM": int(simulated),
                "I048/020/RDP": 0,
                "I048/020/SPI": 0,
                "I048/020/RAB": 0,
                "I048/120/CAL/D": 0,
            },
            lsb={"I048/140": TIME_LSB_NS, "I048/040/RHO": RHO_LSB_M, "I048/110": 25 * FOOT_M},
            max_octets=max_octets,
        )

    def blocks(self, plots: Plots, geoid_undulation_m: ArrayLike = 0.0) -> list[bytes]:
        """Data blocks of all plots of one radar, in their order, none longer than `max_octets`.

        A column of nothing but NaN is not measured; one with some NaN is an EncodeError.
        """
        return self.blocks_by(plots, Parts.whole(len(plots)), geoid_undulation_m)[0]

    def blocks_by(
        self, plots: Plots, parts: Parts, geoid_undulation_m: ArrayLike = 0.0
    ) -> list[list[bytes]]:
        """Data blocks of each part of the plots; all of them measure the same."""
        if not len(plots):
            return [[] for _ in range(len(parts))]
        optional = measured(plots, OPTIONAL)
        if "I048/110" in optional:
            optional["I048/110"] = plots.height_m - np.asarray(geoid_undulation_m)
        columns = {
            "I048/140": plots.t_utc_ns,
            "I048/040/RHO": plots.range_m,
            "I048/040/THETA": plots.azimuth_deg,
            **optional,
        }
        return self._reports.blocks_by(columns, parts)


class ServiceEncoder034:
    """North markers and sector crossings, each a data block of one record.

    Several radars have a SAC, SIC, antenna period and place each, in sequences. `sources` are the
    numbers of the radars that the messages are of, as the times (n,). Places are latitude and
    longitude, degrees, and height above the ellipsoid, metres, (3,) or (n, 3): I034/120 rounds them
    to 2.1e-5 deg and whole metres.
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        antenna_period_s: float | Sequence[float],
        place: ArrayLike,
    ) -> None:
        source: dict[str, Constant] = {"I034/010/SAC": sac, "I034/010/SIC": sic}
        lsb = {"I034/030": TIME_LSB_NS}
        latitude_deg, longitude_deg, height_m = np.atleast_2d(np.asarray(place, np.float64)).T
        checked_position(latitude_deg, longitude_deg, field="I034/120")
        of_north: dict[str, Constant] = {
            "I034/000": NORTH_MARKER,
            "I034/041": antenna_period_s,
            "I034/120/HGT": height_m.tolist(),
            "I034/120/LAT": latitude_deg.tolist(),
            "I034/120/LON": longitude_deg.tolist(),
        }
        self._north = Encoder(
            CAT034,
            ("I034/010", "I034/000", "I034/030", "I034/041", "I034/120"),
            constants=source | of_north,
            lsb=lsb,
        )
        self._sector = Encoder(
            CAT034,
            ("I034/010", "I034/000", "I034/030", "I034/020"),
            constants=source | {"I034/000": SECTOR_CROSSING},
            lsb=lsb,
        )

    def north_markers(self, t_utc_ns: ArrayLike, sources: Ints | None = None) -> list[bytes]:
        """Antennas pass north; I034/010, 000, 030, 041, 120."""
        return blocks_of_one(self._north, self._north.records({"I034/030": t_utc_ns}, sources))

    def sector_crossings(
        self, t_utc_ns: ArrayLike, azimuth_deg: ArrayLike, sources: Ints | None = None
    ) -> list[bytes]:
        """Antennas pass the azimuths at which sectors end; I034/010, 000, 030, 020."""
        columns = {"I034/030": t_utc_ns, "I034/020": azimuth_deg}
        return blocks_of_one(self._sector, self._sector.records(columns, sources))
