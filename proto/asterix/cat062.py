"""Category 062, system tracks, and 063, sensor status: layouts, encoders, format.

EUROCONTROL-SPEC-0149-9, editions 1.19 to 1.21, and CAT062_1_18; 063 is SPEC-0149-10, edition 1.7,
of which earlier ones have fewer groups of I063/060. `codec.layout` explains the tables.
I062/380 is what an aircraft says of itself: IAS counts 2^-14 NM/s, or 0.001 Mach where IM is set.
I062/390 is the flight plan. LMC is a flight level. Earlier editions have fewer groups of I062/080.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from plotfeed.proto.asterix.codec.encode import (
    UDP_OCTETS,
    Parts,
    Reports,
    checked_position,
    measured,
)
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.report_format import PlotItems, SentCategory, asterix
from plotfeed.proto.units import FOOT_M

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from plotfeed.proto.tracks.encode_tracks import Tracks


CAT062 = category(
    62,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I062/010  2       SAC 8, SIC 8
3    I062/015  1       SID 8
4    I062/070  3       TOD 24: 1/128 s modulo 86400
5    I062/105  8       LAT ±32: 180/2^25 deg refused, LON ±32: 180/2^25 deg refused
6    I062/100  6       X ±24: 1/2 m, Y ±24: 1/2 m
7    I062/185  4       VX ±16: 1/4 m/s, VY ±16: 1/4 m/s
8    I062/210  2       AX ±8: 1/4 m/s2, AY ±8: 1/4 m/s2
9    I062/060  2       V, G, CH, _1, MODE3A 4x3
10   I062/245  7       STI 2, _6, CHR 8x6
11   I062/380  1+n     ADR 24; ID 8x6; MHG 16: 360/2^16 deg wraps; IAS (IM, IAS 15); TAS 16: 1 kt;
                       SAL (SAS, SRC 2, ALT ±13: 25 ft); FSS (MV, AH, AM, ALT ±13: 25 ft); TIS
                       (NAV, NVB, _5); TID (repeated: TCA, NC, TCPN 6, ALT ±16: 10 ft, LAT ±24:
                       180/2^23 deg refused, LON ±24: 360/2^24 deg wraps, PT 4, TD 2, TRA, TOA, TOV
                       24: 1 s, TTR 16: 0.01 NM); COM (COM 3, STAT 3, _2, SSC, ARC, AIC, B1A, B1B
                       4); SAB (AC 2, MN 2, DC 2, GBS, _6, STAT 3); ACS 56; BVR ±16: 6.25 ft/min;
                       GVR ±16: 6.25 ft/min; RAN ±16: 0.01 deg; TAR (TI 2, _6, ROT ±7: 1/4 deg/s,
                       _1); TAN 16: 360/2^16 deg wraps; GS ±16: 2^-14 NM/s; VUN 8; MET (WS, WD,
                       TMP, TRB, _4, WSD 16: 1 kt, WDD 16: 1 deg, TMPD ±16: 1/4 °C, TRBD 8); EMC 8;
                       POS (LAT ±24: 180/2^23 deg refused, LON ±24: 360/2^24 deg wraps); GAL ±16:
                       6.25 ft; _4, PUN 4; BDSDATA (repeated: MBDATA 56, BDS1 4, BDS2 4); IAR 16: 1
                       kt; MAC 16: 0.008 Mach; _4, BPS 12: 0.1 mb
12   I062/040  2       TRN 16
13   I062/080  1+FX    MON, SPI, MRH, SRC 3, CNF | SIM, TSE, TSB, FPC, AFF, STP, KOS | AMA, MD4 2,
                       ME, MI, MD5 2 | CST, PSR, SSR, MDS, ADS, SUC, AAC | SDS 2, EMS 3, PFT, FPLT
                       | DUPT, DUPF, DUPM, SFC, IDD, IEC, MLAT | M5I, _6
14   I062/290  1+n     TRK 8: 1/4 s; PSR 8: 1/4 s; SSR 8: 1/4 s; MDS 8: 1/4 s; ADS 16: 1/4 s; ES 8:
                       1/4 s; VDL 8: 1/4 s; UAT 8: 1/4 s; LOP 8: 1/4 s; MLT 8: 1/4 s
15   I062/200  1       TRANS 2, LONG 2, VERT 2, ADF, _1
16   I062/295  1+n     MFL 8: 1/4 s; MD1 8: 1/4 s; MD2 8: 1/4 s; MDA 8: 1/4 s; MD4 8: 1/4 s; MD5 8:
                       1/4 s; MHG 8: 1/4 s; IAS 8: 1/4 s; TAS 8: 1/4 s; SAL 8: 1/4 s; FSS 8: 1/4 s;
                       TID 8: 1/4 s; COM 8: 1/4 s; SAB 8: 1/4 s; ACS 8: 1/4 s; BVR 8: 1/4 s; GVR 8:
                       1/4 s; RAN 8: 1/4 s; TAR 8: 1/4 s; TAN 8: 1/4 s; GSP 8: 1/4 s; VUN 8: 1/4 s;
                       MET 8: 1/4 s; EMC 8: 1/4 s; POS 8: 1/4 s; GAL 8: 1/4 s; PUN 8: 1/4 s; MB 8:
                       1/4 s; IAR 8: 1/4 s; MAC 8: 1/4 s; BPS 8: 1/4 s
17   I062/136  2       FL ±16: 1/4 FL
18   I062/130  2       ALTITUDE ±16: 6.25 ft
19   I062/135  2       QNH, CTB ±15: 1/4 FL
20   I062/220  2       RATE ±16: 6.25 ft/min
21   I062/390  1+n     TAG (SAC 8, SIC 8); CS 7x8; IFI (TYP 2, _3, NBR 27); FCT (GATOAT 2, FR1FR2
                       2, RVSM 2, HPR, _1); TAC 4x8; WTC 1x8; DEP 4x8; DST 4x8; RDS (NU1 1x8, NU2
                       1x8, LTR 1x8); CFL 16: 1/4 FL; CTL (CENTRE 8, POSITION 8); TOD (repeated:
                       TYP 5, DAY 2, _4, HOR 5, _2, MIN 6, AVS, _1, SEC 6); AST 6x8; STS (EMP 2,
                       AVL 2, _4); STD 7x8; STA 7x8; PEM (_3, VA, MODE3A 4x3); PEC 7x8
22   I062/270  1+FX    LENGTH 7: 1 m | ORIENTATION 7: 360/2^7 deg wraps | WIDTH 7: 1 m
23   I062/300  1       FLEET 8
24   I062/110  1+n     SUM (M5, ID, DA, M1, M2, M3, MC, X); PMN (_2, PIN 14, _3, NAT 5, _2, MIS 6);
                       POS (LAT ±24: 180/2^23 deg refused, LON ±24: 360/2^24 deg wraps); GA (_1,
                       RES, GA ±14: 25 ft); _4, EM1 4x3; TOS ±8: 1/128 s; XP (_3, X5, XC, X3, X2,
                       X1)
25   I062/120  2       _4, MODE2 4x3
26   I062/510  3+FX    repeated: IDENT 8, TRACK 15
27   I062/500  1+n     APC (X 16: 1/2 m, Y 16: 1/2 m); COV ±16: 1/2 m; APW (LAT 16: 180/2^25 deg,
                       LON 16: 180/2^25 deg); AGA 8: 6.25 ft; ABA 8: 1/4 FL; ATV (X 8: 1/4 m/s, Y
                       8: 1/4 m/s); AA (X 8: 1/4 m/s2, Y 8: 1/4 m/s2); ARC 8: 6.25 ft/min
28   I062/340  1+n     SID (SAC 8, SIC 8); POS (RHO 16: 1/256 NM, THETA 16: 360/2^16 deg wraps);
                       HEIGHT ±16: 25 ft; MDC (V, G, LMC ±14: 1/4 FL); MDA (V, G, L, _1, MODE3A
                       4x3); TYP (TYP 3, SIM, RAB, TST, _2)
34   I062/RE   1+n     octets behind their count
35   I062/SP   1+n     octets behind their count
""",
)

# Editions up to 1.18, which have no height below 0 in I062/340.
CAT062_1_18 = category(
    62,
    """
28   I062/340  1+n     SID (SAC 8, SIC 8); POS (RHO 16: 1/256 NM, THETA 16: 360/2^16 deg wraps);
                       HEIGHT 16: 25 ft; MDC (V, G, LMC ±14: 1/4 FL); MDA (V, G, L, _1, MODE3A
                       4x3); TYP (TYP 3, SIM, RAB, TST, _2)
""",
    base=CAT062,
)

MONOSENSOR, GEOMETRIC_HEIGHT, RADAR_3D = 1, 1, 2  # I062/080: MON, MRH, SRC
ALTITUDE_LSB_M = 6.25 * FOOT_M  # I062/130
CLIMB_LSB_M_S = 6.25 * FOOT_M / 60  # I062/220

# Parts that are sent where their columns hold numbers.
OPTIONAL = {
    "I062/130": "height_m",
    "I062/220": "climb_m_s",
    "I062/290/PSR": "age_s",
    "I062/500/APC/X": "sigma_east_m",
    "I062/500/APC/Y": "sigma_north_m",
}

# Standard deviations, and whose they are.
DEVIATIONS = {"I062/500/APC/X": "I062/100/X", "I062/500/APC/Y": "I062/100/Y"}

# Parts of I062/080 that say 0: of transponders, flight plans and other sensors.
STATUS_OF_OTHERS = "SPI FPC AFF STP KOS AMA MD4 ME MI MD5 SSR MDS ADS SUC AAC"


CAT063 = category(
    63,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I063/010  2       SAC 8, SIC 8
2    I063/015  1       SID 8
3    I063/030  3       TOD 24: 1/128 s modulo 86400
4    I063/050  2       SAC 8, SIC 8
5    I063/060  1+FX    CON 2, PSR, SSR, MDS, ADS, MLT | OPS, ODP, OXT, MSC, TSV, NPW, _1 | TTFEP,
                       TTFVAL, SPOEP, SPOVAL, _3
6    I063/070  2       BIAS ±16: 1 ms
7    I063/080  4       SRG ±16: 1e-05, SRB ±16: 1/128 NM
8    I063/081  2       BIAS ±16: 180/2^15 deg
9    I063/090  4       PRG ±16: 1e-05, PRB ±16: 1/128 NM
10   I063/091  2       BIAS ±16: 180/2^15 deg
11   I063/092  2       BIAS ±16: 180/2^15 deg
13   I063/RE   1+n     octets behind their count
14   I063/SP   1+n     octets behind their count
""",
)

FORMAT = asterix(
    {62: SentCategory("tracks"), 63: SentCategory("that the sensor works")},
    layouts=(CAT062, CAT063),
    tells_tracks=True,
    plot_items=PlotItems(
        columns={
            "track": "I062/040",
            "latitude_deg": "I062/105/LAT",
            "longitude_deg": "I062/105/LON",
            "east_m": "I062/100/X",
            "north_m": "I062/100/Y",
            "velocity_east_m_s": "I062/185/VX",
            "velocity_north_m_s": "I062/185/VY",
            "height_m": "I062/130",
            "climb_m_s": "I062/220",
            "flight_level": "I062/136",
            "mode_3a": "I062/060/MODE3A",
            "address": "I062/380/ADR",
            "identity": "I062/245/CHR",
        },
        units={"height_m": FOOT_M, "climb_m_s": FOOT_M / 60},
    ),
)


class TrackEncoder062(Reports):
    """Tracks of sensors, as I062/010, 070, 105, 100, 185, 040, 080, and what else they have.

    That is 130 (height), 220 (climb), 290 (PSR) and 500 (APC), which holds the rounding of 100 and
    is rounded up. Several sensors have a SAC, SIC and limit of octets each, in sequences.
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        max_octets: int | Sequence[int] = UDP_OCTETS,
    ) -> None:
        status = {f"I062/080/{name}": 0 for name in STATUS_OF_OTHERS.split()}
        super().__init__(
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
                "I062/080/SIM": 1,
            },
            lsb={"I062/130": ALTITUDE_LSB_M, "I062/220": CLIMB_LSB_M_S},
            deviations=DEVIATIONS,
            max_octets=max_octets,
        )

    def _columns(self, tracks: Tracks, _parts: Parts) -> Mapping[str, ArrayLike]:
        checked_position(tracks.latitude_deg, tracks.longitude_deg, field="I062/105")
        optional = measured(tracks, OPTIONAL)
        return {
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
        }


def status_063(sac: int | Sequence[int], sic: int | Sequence[int]) -> Reports:
    """Encodes that sensors that track are operational, each time as I063/010, 030, 050 and 060.

    Of 060 the first octet is sent. Who says so is the sensor itself. Several sensors have a SAC and
    SIC each, in sequences.
    """
    flags = {f"I063/060/{name}": 0 for name in ("CON", "PSR", "SSR", "MDS", "ADS", "MLT")}
    sources = {
        f"I063/{item}/{name}": code
        for item in ("010", "050")
        for name, code in (("SAC", sac), ("SIC", sic))
    }
    return Reports(
        CAT063, ("I063/010", "I063/030", "I063/050", "I063/060"), constants={**flags, **sources}
    )
