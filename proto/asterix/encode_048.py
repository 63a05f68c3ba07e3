"""What the emulated radars send: plots in category 048, north and sectors in category 034.

A radar sends the plots of a sector first and then the sector message with the azimuth at which
that sector ends, both in one datagram; at north it sends a north marker.
"""

from __future__ import annotations

from plotfeed.models.state import Plots
from plotfeed.proto.asterix.cat034 import CAT034
from plotfeed.proto.asterix.cat048 import CAT048
from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Encoder, Reports, blocks_of, measured
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

    `geoid_undulation_m` is the height of mean sea level above the WGS-84 ellipsoid at the sensor:
    plots have heights above the latter, I048/110 above the former. The Doppler speed of 120 is the
    range rate in whole m/s; the standard leaves its sign open: here a positive one recedes.
    """

    def __init__(
        self,
        sac: int,
        sic: int,
        *,
        simulated: bool = True,
        geoid_undulation_m: float = 0.0,
        max_octets: int = UDP_OCTETS,
    ) -> None:
        self._geoid_undulation_m = geoid_undulation_m
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

    def blocks(self, plots: Plots) -> list[bytes]:
        """Data blocks of all plots, in their order, none longer than `max_octets`.

        A column of nothing but NaN is not measured; one with some NaN is an EncodeError.
        """
        if not len(plots):
            return []
        optional = measured({path: getattr(plots, name) for path, name in OPTIONAL.items()})
        if "I048/110" in optional and self._geoid_undulation_m:
            optional["I048/110"] = plots.height_m - self._geoid_undulation_m
        return self._reports.blocks(
            {
                "I048/140": plots.t_utc_ns,
                "I048/040/RHO": plots.range_m,
                "I048/040/THETA": plots.azimuth_deg,
                **optional,
            }
        )


class ServiceEncoder034:
    """North markers and sector crossings, each a data block of one record."""

    def __init__(self, sac: int, sic: int, *, antenna_period_s: float) -> None:
        source: dict[str, float | str] = {"I034/010/SAC": sac, "I034/010/SIC": sic}
        lsb = {"I034/030": TIME_LSB_NS}
        self._north = Encoder(
            CAT034,
            ("I034/010", "I034/000", "I034/030", "I034/041"),
            constants=source | {"I034/000": NORTH_MARKER, "I034/041": antenna_period_s},
            lsb=lsb,
        )
        self._sector = Encoder(
            CAT034,
            ("I034/010", "I034/000", "I034/030", "I034/020"),
            constants=source | {"I034/000": SECTOR_CROSSING},
            lsb=lsb,
        )

    def north_marker(self, t_utc_ns: int) -> bytes:
        """The antenna passes north; I034/010, 000, 030, 041."""
        return _block(self._north.record(t_utc_ns), self._north)

    def sector_crossing(self, t_utc_ns: int, azimuth_deg: float) -> bytes:
        """The antenna passes the azimuth at which a sector ends; I034/010, 000, 030, 020."""
        return _block(self._sector.record(t_utc_ns, azimuth_deg), self._sector)


def _block(record: bytes, encoder: Encoder) -> bytes:
    return blocks_of(encoder.category, record, encoder.record_length)[0]
