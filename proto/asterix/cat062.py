"""Category 062, system tracks: encoder for sensors that track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from plotfeed.models.state import Bools, Columns, Floats, Ints
from plotfeed.proto.asterix.codec.encode import UDP_OCTETS
from plotfeed.proto.asterix.codec.reports import Parts, Reports, checked_position, measured
from plotfeed.proto.asterix.layout_062 import CAT062
from plotfeed.proto.units import FOOT_M, TIME_LSB_NS

MONOSENSOR, GEOMETRIC_HEIGHT, RADAR_3D = 1, 1, 2  # I062/080: MON, MRH, SRC
ALTITUDE_LSB_M = 6.25 * FOOT_M  # I062/130
CLIMB_LSB_M_S = 6.25 * FOOT_M / 60  # I062/220

OPTIONAL = {
    "I062/130": "height_m",
    "I062/220": "climb_m_s",
    "I062/290/PSR": "age_s",
    "I062/500/APC/X": "sigma_east_m",
    "I062/500/APC/Y": "sigma_north_m",
}
"""Parts that are sent where their columns hold numbers."""

DEVIATIONS = {"I062/500/APC/X": "I062/100/X", "I062/500/APC/Y": "I062/100/Y"}
"""Standard deviations, and whose they are."""

STATUS_OF_OTHERS = "SPI FPC AFF STP KOS AMA MD4 ME MI MD5 SSR MDS ADS SUC AAC"
"""Parts of I062/080 that say 0: of transponders, flight plans and other sensors."""


@dataclass(frozen=True, kw_only=True)
class Tracks(Columns):
    """Tracks of a sensor at their own times; columns (n,), NaN for what it does not estimate.

    East and north are from the system's reference point, height is above the WGS-84 ellipsoid,
    age is that of the last plot in a track. `coasted` tracks are predicted without one, `first`
    and `last` reports begin and end a track.
    """

    track: Ints
    t_utc_ns: Ints
    latitude_deg: Floats
    longitude_deg: Floats
    east_m: Floats
    north_m: Floats
    velocity_east_m_s: Floats
    velocity_north_m_s: Floats
    height_m: Floats
    climb_m_s: Floats
    age_s: Floats
    sigma_east_m: Floats
    sigma_north_m: Floats
    tentative: Bools
    coasted: Bools
    first: Bools
    last: Bools


class TrackEncoder062:
    """Tracks of sensors, as I062/010, 070, 105, 100, 185, 040, 080, and what else they have.

    That is 130 (height), 220 (climb), 290 (PSR) and 500 (APC), which holds the rounding of 100 and
    is rounded up. Several sensors have a SAC, SIC and
    limit of octets each, in sequences.
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        simulated: bool = True,
        max_octets: int | Sequence[int] = UDP_OCTETS,
    ) -> None:
        status = {f"I062/080/{name}": 0 for name in STATUS_OF_OTHERS.split()}
        self._reports = Reports(
            CAT062,
            (
                "I062/010",
                "I062/070",
                "I062/105",
                "I062/100",
                "I062/185",
                "I062/040",
                "I062/080",
                "I062/080/CST",
            ),
            ("I062/130", "I062/220", "I062/290/PSR", "I062/500/APC"),
            constants={
                "I062/010/SAC": sac,
                "I062/010/SIC": sic,
                **status,
                "I062/080/MON": MONOSENSOR,
                "I062/080/MRH": GEOMETRIC_HEIGHT,
                "I062/080/SIM": int(simulated),
            },
            lsb={
                "I062/070": TIME_LSB_NS,
                "I062/130": ALTITUDE_LSB_M,
                "I062/220": CLIMB_LSB_M_S,
            },
            deviations=DEVIATIONS,
            max_octets=max_octets,
        )

    def blocks(self, tracks: Tracks) -> list[bytes]:
        """Data blocks of all tracks of one sensor, in their order, within `max_octets`.

        A column of nothing but NaN is not estimated; one with some NaN is an EncodeError.
        """
        return self.blocks_by(tracks, Parts.whole(len(tracks)))[0]

    def blocks_by(self, tracks: Tracks, parts: Parts) -> list[list[bytes]]:
        """Data blocks of each part of the tracks, all of which have estimates of the same."""
        if not len(tracks):
            return [[] for _ in range(len(parts))]
        checked_position(tracks.latitude_deg, tracks.longitude_deg, field="I062/105")
        optional = measured(tracks, OPTIONAL)
        return self._reports.blocks_by(
            {
                "I062/070": tracks.t_utc_ns,
                "I062/105/LAT": tracks.latitude_deg,
                "I062/105/LON": tracks.longitude_deg,
                "I062/100/X": tracks.east_m,
                "I062/100/Y": tracks.north_m,
                "I062/185/VX": tracks.velocity_east_m_s,
                "I062/185/VY": tracks.velocity_north_m_s,
                "I062/040": tracks.track,
                "I062/080/SRC": RADAR_3D if "I062/130" in optional else 0,
                "I062/080/CNF": tracks.tentative,
                "I062/080/TSE": tracks.last,
                "I062/080/TSB": tracks.first,
                "I062/080/CST": tracks.coasted,
                "I062/080/PSR": tracks.coasted,
                **optional,
            },
            parts,
        )
