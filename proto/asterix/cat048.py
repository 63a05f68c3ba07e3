"""Categories 048 and 034, a radar's plots, north markers and sectors: layouts, encoders, format.

A radar sends the plots of a sector first and then the sector message with the azimuth at which
that sector ends, both in one datagram; at north it sends a north marker.

EUROCONTROL SUR.ET1.ST05.2000-STD-04-01 (ASTERIX part 4), monoradar target reports, standard UAP,
editions 1.21 to 1.32, and SUR.ET1.ST05.2000-STD-02b-01 (part 2b), monoradar service messages,
editions 1.27 to 1.29. The clause of an item is 5.2.<item>; `codec.layout` explains the tables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Parts, Reports, checked_places, measured
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.lazy_numpy import np
from plotfeed.proto.report_format import PlotItems, SentCategory, asterix
from plotfeed.proto.units import FOOT_M, NM_M

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from plotfeed.models.state import Plots

# Codes of modes 2, 3/A and C are octal and Gray. I048/110 is above mean sea level. Of what ends in
# EP, a bit says whether the value after it is populated.
CAT048 = category(
    48,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I048/010  2       SAC 8, SIC 8
2    I048/140  3       TOD 24: 1/128 s modulo 86400
3    I048/020  1+FX    TYP 3, SIM, RDP, SPI, RAB | TST, ERR, XPP, ME, MI, FOEFRI 2 | ADSBEP,
                       ADSBVAL, SCNEP, SCNVAL, PAIEP, PAIVAL, _1 | ACASXVEP, ACASXVVAL 4, POXPREP,
                       POXPRVAL | POACTEP, POACTVAL, DTFXPREP, DTFXPRVAL, DTFACTEP, DTFACTVAL, _1 |
                       IRMXPREP, IRMXPRVAL, IRMACTEP, IRMACTVAL, _3
4    I048/040  4       RHO 16: 1/256 NM, THETA 16: 360/2^16 deg wraps
5    I048/070  2       V, G, L, _1, MODE3A 4x3
6    I048/090  2       V, G, FL ±14: 1/4 FL refused
7    I048/130  1+n     SRL 8: 180/2^12 deg; SRR 8; SAM ±8: 1 dBm; PRL 8: 180/2^12 deg; PAM ±8: 1
                       dBm; RPD ±8: 1/256 NM; APD ±8: 180/2^13 deg
8    I048/220  3       ADDRESS 24
9    I048/240  6       IDENTIFICATION 8x6
10   I048/250  1+8n    repeated: MBDATA 56, BDS1 4, BDS2 4
11   I048/161  2       _4, TRN 12
12   I048/042  4       X ±16: 1/128 NM, Y ±16: 1/128 NM
13   I048/200  4       GSP 16: 2^-14 NM/s, HDG 16: 360/2^16 deg wraps
14   I048/170  1+FX    CNF, RAD 2, DOU, MAH, CDM 2 | TRE, GHO, SUP, TCC, _3
15   I048/210  4       SIGX 8: 1/128 NM, SIGY 8: 1/128 NM, SIGV 8: 2^-14 NM/s, SIGH 8: 180/2^11 deg
16   I048/030  1+FX    repeated: WE 7
17   I048/080  2       _4, QA4, QA2, QA1, QB4, QB2, QB1, QC4, QC2, QC1, QD4, QD2, QD1
18   I048/100  4       V, G, _2, MODEC 12, _4, QC1, QA1, QC2, QA2, QC4, QA4, QB1, QD1, QB2, QD2,
                       QB4, QD4
19   I048/110  2       _2, HEIGHT ±14: 25 ft
20   I048/120  1+n     CAL (D, _5, CAL ±10: 1 m/s); RDS (repeated: DOP 16: 1 m/s refused, AMB 16: 1
                       m/s refused, FRQ 16: 1 MHz refused)
21   I048/230  2       COM 3, STAT 3, SI, _1, MSSC, ARC, AIC, B1A, B1B 4
22   I048/260  7       ADVISORY 56
23   I048/055  1       V, G, L, MODE1 5
24   I048/050  2       V, G, L, _1, MODE2 4x3
25   I048/065  1       _3, QA4, QA2, QA1, QB2, QB1
26   I048/060  2       _4, QA4, QA2, QA1, QB4, QB2, QB1, QC4, QC2, QC1, QD4, QD2, QD1
27   I048/SP   1+n     octets behind their count
28   I048/RE   1+n     octets behind their count
""",
)

# I034/000 is 1 for a north marker, 2 for a sector crossing. I034/120 is in WGS-84, and its height
# above the ellipsoid.
CAT034 = category(
    34,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I034/010  2       SAC 8, SIC 8
2    I034/000  1       TYPE 8
3    I034/030  3       TOD 24: 1/128 s modulo 86400
4    I034/020  1       SECTOR 8: 360/2^8 deg wraps
5    I034/041  2       PERIOD 16: 1/128 s refused
6    I034/050  1+n     COM (NOGO, RDPC, RDPR, OVLRDP, OVLXMT, MSC, TSV, _1); -; -; PSR (ANT, CHAB
                       2, OVL, MSC, _3); SSR (ANT, CHAB 2, OVL, MSC, _3); MDS (ANT, CHAB 2, OVLSUR,
                       MSC, SCF, DLF, OVLSCF, OVLDLF, _7)
7    I034/060  1+n     COM (_1, REDRDP 3, REDXMT 3, _1); -; -; PSR (POL, REDRAD 3, STC 2, _2); SSR
                       (REDRAD 3, _5); MDS (REDRAD 3, CLU, _4)
8    I034/070  1+2n    repeated: TYP 5, COUNT 11
9    I034/100  8       RHOST 16: 1/256 NM, RHOEND 16: 1/256 NM, THETAST 16: 360/2^16 deg wraps,
                       THETAEND 16: 360/2^16 deg wraps
10   I034/110  1       TYP 8
11   I034/120  8       HGT ±16: 1 m refused, LAT ±24: 180/2^23 deg refused, LON ±24: 360/2^24 deg
                       wraps
12   I034/090  2       RNG ±8: 1/128 NM refused, AZM ±8: 180/2^13 deg refused
13   I034/RE   1+n     octets behind their count
14   I034/SP   1+n     octets behind their count
""",
)

RHO_LSB_M = NM_M / 256  # I048/040
PRIMARY = 1  # I048/020/TYP: single primary detection
NORTH_MARKER, SECTOR_CROSSING = 1, 2  # I034/000

# Parts that are sent where their columns are measured.
OPTIONAL = {
    "I048/130/PRL": "run_length_deg",
    "I048/130/PAM": "amplitude_dbm",
    "I048/110": "height_m",
    "I048/120/CAL/CAL": "range_rate_m_s",
}


FORMAT = asterix(
    {
        48: SentCategory("target reports"),
        34: SentCategory("north marker and sector crossings", rotates=True),
    },
    layouts=(CAT048, CAT034),
    tells_heights=True,
    tells_run_lengths=True,
    range_step_m=RHO_LSB_M,
    plot_items=PlotItems(
        columns={
            "range_m": "I048/040/RHO",
            "azimuth_deg": "I048/040/THETA",
            "altitude_m": "I048/110",
            "range_rate_m_s": "I048/120/CAL/CAL",
            "amplitude_dbm": "I048/130/PAM",
            "identity": "I048/240",
            "mode_3a": "I048/070/MODE3A",
            "address": "I048/220",
            "track": "I048/161",
            "flight_level": "I048/090/FL",
            "ssr_amplitude_dbm": "I048/130/SAM",
            "east_m": "I048/042/X",
            "north_m": "I048/042/Y",
        },
        units={"range_m": NM_M, "altitude_m": FOOT_M, "east_m": NM_M, "north_m": NM_M},
    ),
)


class PlotEncoder048(Reports):
    """Plots of a primary radar, as I048/010, 140, 020, 040, and of 130, 110, 120 what is measured.

    Further, `blocks` takes the height of mean sea level above the WGS-84 ellipsoid where the plots
    are, one for all or (n,): they have heights above the latter, I048/110 above the former. The
    Doppler speed of 120 is the range rate in whole m/s; the standard leaves its sign open: here a
    positive one recedes. Several radars have a SAC, SIC and limit of octets each, in sequences.
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        max_octets: int | Sequence[int] = UDP_OCTETS,
    ) -> None:
        super().__init__(
            CAT048,
            ("I048/010", "I048/140", "I048/020", "I048/040"),
            ("I048/130/PRL", "I048/130/PAM", "I048/110", "I048/120/CAL"),
            constants={
                "I048/010/SAC": sac,
                "I048/010/SIC": sic,
                "I048/020/TYP": PRIMARY,
                "I048/020/SIM": 1,
                "I048/020/RDP": 0,
                "I048/020/SPI": 0,
                "I048/020/RAB": 0,
                "I048/120/CAL/D": 0,
            },
            lsb={"I048/040/RHO": RHO_LSB_M, "I048/110": 25 * FOOT_M},
            max_octets=max_octets,
        )

    def _columns(
        self, plots: Plots, _parts: Parts, geoid_undulation_m: ArrayLike = 0.0
    ) -> Mapping[str, ArrayLike]:
        optional = measured(plots, OPTIONAL)
        if "I048/110" in optional:
            optional["I048/110"] = plots.height_m - np.asarray(geoid_undulation_m)
        return {
            "I048/140": plots.t_utc_ns,
            "I048/040/RHO": plots.range_m,
            "I048/040/THETA": plots.azimuth_deg,
            **optional,
        }


def north_markers(
    sac: int | Sequence[int],
    sic: int | Sequence[int],
    *,
    antenna_period_s: float | Sequence[float],
    place: ArrayLike,
) -> Reports:
    """Encodes when antennas pass north, as I034/010, 000, 030, 041, 120.

    Places are latitude and longitude, degrees, and height above the ellipsoid, metres, (3,) or
    (n, 3): I034/120 rounds them to 2.1e-5 deg and whole metres. Several radars have a SAC, SIC,
    antenna period and place each, in sequences.
    """
    latitude_deg, longitude_deg, height_m = checked_places(place, field="I034/120")
    return Reports(
        CAT034,
        ("I034/010", "I034/000", "I034/030", "I034/041", "I034/120"),
        constants={
            "I034/010/SAC": sac,
            "I034/010/SIC": sic,
            "I034/000": NORTH_MARKER,
            "I034/041": antenna_period_s,
            "I034/120/HGT": height_m,
            "I034/120/LAT": latitude_deg,
            "I034/120/LON": longitude_deg,
        },
    )


def sector_crossings(sac: int | Sequence[int], sic: int | Sequence[int]) -> Reports:
    """Encodes when antennas pass the azimuths at which sectors end: I034/010, 000, 030, 020.

    The azimuths are columns of "I034/020", degrees.
    """
    return Reports(
        CAT034,
        ("I034/010", "I034/000", "I034/030", "I034/020"),
        constants={"I034/010/SAC": sac, "I034/010/SIC": sic, "I034/000": SECTOR_CROSSING},
    )
