"""Category 250, plots of a radar that does not exist: layout and encoder."""

from __future__ import annotations

from plotfeed.models.state import Plots
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.asterix.codec.reports import Reports, measured
from plotfeed.proto.units import TIME_LSB_NS

CAT250 = category(
    250,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I250/010  2       SAC 8, SIC 8
2    I250/020  3       TOD 24: 1/128 s modulo 86400
3    I250/030  4       R 16: 1 m, AZ 16: 360/2^16 deg wraps
4    I250/040  2       EL ±16: 180/2^15 deg
""",
)


class PlotEncoder250:
    """Plots, as I250/010, 020, 030, and 040 if they have elevations."""

    def __init__(self, sac: int, sic: int, *, max_octets: int) -> None:
        self._reports = Reports(
            CAT250,
            ("I250/010", "I250/020", "I250/030"),
            ("I250/040",),
            constants={"I250/010/SAC": sac, "I250/010/SIC": sic},
            lsb={"I250/020": TIME_LSB_NS},
            max_octets=max_octets,
        )

    def blocks(self, plots: Plots) -> list[bytes]:
        """Data blocks of all plots, in their order."""
        if not len(plots):
            return []
        return self._reports.blocks(
            {
                "I250/020": plots.t_utc_ns,
                "I250/030/R": plots.range_m,
                "I250/030/AZ": plots.azimuth_deg,
                **measured(plots, {"I250/040": "elevation_deg"}),
            }
        )
