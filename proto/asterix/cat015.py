"""Category 015, target reports of non-cooperative surveillance: layout, encoder of plots, format.

Staring, MIMO and passive radars and arrays of microphones report in it.

EUROCONTROL-SPEC-0149, category 015, editions 1.0 to 1.2; `codec.layout` explains the table.
I015/480 holds measurement identifiers, as I015/400 does. Range is that of a monostatic sensor, or
with MOMU = 1 the path transmitter-target-receiver less the baseline. The powers of I015/630 have no
reference in the standard.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING

from plotfeed.proto.asterix.cat016 import CAT016
from plotfeed.proto.asterix.cat025 import CAT025, STATUS
from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Parts, Reports, measured
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.lazy_numpy import np
from plotfeed.proto.report_format import PlotItems, SentCategory, asterix
from plotfeed.proto.units import decibels

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from plotfeed.models.state import Floats, Ints, Plots

CAT015 = category(
    15,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I015/010  2       SAC 8, SIC 8
2    I015/000  1       MT 7, RG
3    I015/015  1       SID 8
4    I015/020  1+FX    MOMU 2, TTAX 2, SCD 2, _1
5    I015/030  1+FX    repeated: WE 7
6    I015/145  3       TOA 24: 1/128 s modulo 86400
7    I015/161  2       TPN 16
8    I015/170  1+FX    BIZ, BAZ, TUR, _1, CSTP, CSTH, CNF
9    I015/050  2       _2, UPD 14: 1/128 s
10   I015/270  1+n     LEN 16: 0.01 m; WDT 16: 0.01 m; HGT 16: 0.01 m; ORT 16: 360/2^16 deg wraps
11   I015/300  1+2n    repeated: CLS 9, PRB 7
12   I015/400  5       PID 16, ON 24
13   I015/600  1+n     P84 (LAT ±32: 180/2^31 deg refused, LON ±32: 360/2^32 deg wraps); HPR (RSHPX
                       16: 1/2 m, RSHPY 16: 1/2 m, CORSHPXY ±8: 1/128); HPP (SDHPX 16: 1/4 m, SDHPY
                       16: 1/4 m, COSDHPXY ±8: 1/128)
14   I015/601  1+n     GH ±24: 0.01 m; RSGH 24: 0.01 m; SDGH 24: 0.01 m; CI6 (UCI6 12: 16 m, LCI6
                       12: 16 m); CI9 (UCI9 12: 16 m, LCI9 12: 16 m); COGHHP (X ±8: 1/128, Y ±8:
                       1/128); COGHHV (X ±8: 1/128, Y ±8: 1/128); COGHHA (X ±8: 1/128, Y ±8: 1/128)
15   I015/602  1+n     HV (X ±20: 0.01 m/s, Y ±20: 0.01 m/s); RSHV (X 16: 0.01 m/s, Y 16: 0.01 m/s,
                       CORSHVXY ±8: 1/128); SDHV (X 16: 0.01 m/s, Y 16: 0.01 m/s, COHVXY ±8:
                       1/128); COHVHP (COHVXHPX ±8: 1/128, COHVXHPY ±8: 1/128, COHVYHPX ±8: 1/128,
                       COHVYHPY ±8: 1/128)
16   I015/603  1+n     HA (X ±12: 1/16 m/s2, Y ±12: 1/16 m/s2); SDHA (X 12: 1/16 m/s2, Y 12: 1/16
                       m/s2, COHAXY ±8: 1/128); COHAHP (COHAXHPX ±8: 1/128, COHAXHPY ±8: 1/128,
                       COHAYHPX ±8: 1/128, COAYHPY ±8: 1/128); COHAHV (COHAXHVX ±8: 1/128, COHAXHVY
                       ±8: 1/128, COHAYHVX ±8: 1/128, COHAYHVY ±8: 1/128)
17   I015/604  1+n     VV ±24: 0.01 m/s; RSVV 16: 0.01 m/s; SDVV (SDVV 16: 0.01 m/s, COVVGH ±8:
                       1/128); COVVHP (X ±8: 1/128, Y ±8: 1/128); COVVHV (X ±8: 1/128, Y ±8:
                       1/128); COVVHA (X ±8: 1/128, Y ±8: 1/128)
18   I015/605  1+n     VA ±16: 0.01 m/s2; RSVA (SDVA 16: 0.01 m/s2, COVAGH ±8: 1/128, COVAVV ±8:
                       1/128); COVAHP (X ±8: 1/128, Y ±8: 1/128); COVAHV (X ±8: 1/128, Y ±8:
                       1/128); COVAHA (X ±8: 1/128, Y ±8: 1/128)
19   I015/480  1+5n    repeated: PID 16, ON 24
20   I015/625  1+n     R ±24: 0.1 m; RSR 24: 0.1 m; SDR 24: 0.1 m; RR ±24: 0.1 m/s; RSRR 24: 0.1
                       m/s; SDRR (SDRR 24: 0.1 m/s, CORRR ±8: 1/128); RA ±16: 1/64 m/s2; SDRA (SDRA
                       16: 1/128 m/s2, CORAR ±8: 1/128, CORARR ±8: 1/128)
21   I015/626  1+n     DV ±24: 0.01 m/s; SDDV 16: 1/64 m/s; DA ±16: 1/64 m/s2; SDDA (SDDA 16: 1/64
                       m/s2, CODADV ±8: 1/128); CODVR ±8: 1/128; CODVRR ±8: 1/128; CODVRA ±8:
                       1/128; CODAR ±8: 1/128; CODARR ±8: 1/128; CODARA ±8: 1/128
22   I015/627  1+n     AZ 16: 360/2^16 deg wraps; RSAZ 16: 180/2^18 deg; SDASZ 16: 180/2^18 deg;
                       AZR ±16: 180/2^16 deg/s; SDAZR (SDAZR 16: 180/2^18 deg/s, COAZRAZ ±8:
                       1/128); AZEX (S 16: 360/2^16 deg wraps, E 16: 360/2^16 deg wraps)
23   I015/628  1+n     EL ±16: 180/2^16 deg; RSEL 16: 180/2^18 deg; SDEL 16: 180/2^18 deg; ER ±16:
                       180/2^16 deg/s; SDER (SDELR 16: 180/2^18 deg/s, COELREL ±8: 1/128); ELEX (S
                       ±16: 180/2^16 deg, E ±16: 180/2^16 deg)
24   I015/630  1+n     DPP ±8: 1 dB; DPS ±8: 1 dB; _7, RPP ±9: 1 dB; RPS ±8: 1 dB
25   I015/631  1+8n    repeated: AZCON 16: 360/2^16 deg wraps, ELCON ±16: 180/2^16 deg, RGCONSTOP
                       16: 10000/2^16 m, RGCONSTART 16: 10000/2^16 m
26   I015/SP   1+n     octets behind their count
""",
)

MEASUREMENT_PLOT = 1  # I015/000/MT
SIMULATED = 3  # I015/020/TTAX
SURE_PCT = 100  # I015/300/PRB
OBSERVATIONS = 1 << 24  # I015/400/ON counts so far, then from 0


class Geometry(IntEnum):
    """What the range of I015/625 is, I015/020/MOMU."""

    MONOSTATIC = 0  # The distance of the target
    MULTISTATIC = 1  # The path transmitter-target-receiver less the baseline
    OTHER = 2  # No range: a sensor of bearings


class Scanning(IntEnum):
    """How the beam moves, I015/020/SCD."""

    UNKNOWN = 0
    FORWARD = 1
    BACKWARD = 2
    STATIC = 3


# The columns of plots for range and its standard deviation.
RANGES = {
    Geometry.MONOSTATIC: ("range_m", "sigma_range_m"),
    Geometry.MULTISTATIC: ("bistatic_range_m", "sigma_bistatic_range_m"),
}

# What records tell of plots, by column.
COLUMNS = {
    "range_m": "I015/625/R",
    "sigma_range_m": "I015/625/SDR",
    "azimuth_deg": "I015/627/AZ",
    "sigma_azimuth_deg": "I015/627/SDASZ",
    "elevation_deg": "I015/628/EL",
    "sigma_elevation_deg": "I015/628/SDEL",
    "height_m": "I015/601/GH",
    "range_rate_m_s": "I015/626/DV",
    "sigma_range_rate_m_s": "I015/626/SDDV",
    "amplitude_dbm": "I015/630/RPP",
    "snr_db": "I015/630/RPS",
    "channel": "I015/400/PID",
}
# Columns with a standard deviation of their own.
DEVIATING = ("azimuth_deg", "elevation_deg", "range_rate_m_s")
# Parts that are sent where their columns are measured; of ranges, the geometry says which.
OPTIONAL = {
    COLUMNS[name]: name
    for name in (*DEVIATING, *(f"sigma_{each}" for each in DEVIATING), "amplitude_dbm")
}
# Standard deviations, and whose they are.
DEVIATIONS = {COLUMNS[f"sigma_{name}"]: COLUMNS[name] for name in ("range_m", *DEVIATING)}


FORMAT = asterix(
    {
        15: SentCategory("measurement plots"),
        16: SentCategory(
            "transmitters, receivers and pairs of a passive radar", has_illuminators=True
        ),
        25: STATUS,
    },
    layouts=(CAT015, CAT016, CAT025),
    plot_items=PlotItems(columns=COLUMNS, plots_alone=("I015/000/MT", (MEASUREMENT_PLOT,))),
)


class PlotEncoder015(Reports):
    """Measurement plots, as I015/010, 000, 020, 145, and of the others what is measured.

    Those are 300 (class), 625 (R, SDR), 626 (DV, SDDV), 627 (AZ, SDASZ), 628 (EL, SDEL), 630 (RPP
    in dBm, RPS). Standard deviations hold the rounding of their values, and are rounded up. A
    multistatic sensor has 400 too: the pair of a plot's channel, and a count of observations. The
    standard leaves the sign of DV open: here a positive one recedes.

    A pair is the channel of a plot. `classes` has the class of each kind of plot, by agreement with
    the receiver; without it no class is sent. Plots that do not say how probable theirs is are sure
    of it. Several sensors have a SAC, SIC, manner of scanning and limit of octets each, in
    sequences. Further, `blocks` takes the number of a multistatic sensor's first plot, `blocks_by`
    that of the first of each part, (m,).
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        geometry: Geometry = Geometry.MONOSTATIC,
        scanning: Scanning | Sequence[Scanning] = Scanning.STATIC,
        classes: Mapping[str, int] | None = None,
        max_octets: int | Sequence[int] = UDP_OCTETS,
    ) -> None:
        self._classes = classes
        self._multistatic = geometry is Geometry.MULTISTATIC
        paths = COLUMNS["range_m"], COLUMNS["sigma_range_m"]
        ranges = dict(zip(paths, RANGES.get(geometry, ()), strict=False))
        self._told = ranges | OPTIONAL
        super().__init__(
            CAT015,
            ("I015/010", "I015/000", "I015/020", "I015/145")
            + (("I015/400",) if self._multistatic else ()),
            ("I015/300*1", *self._told, "I015/630/RPS"),
            constants={
                "I015/010/SAC": sac,
                "I015/010/SIC": sic,
                "I015/000/MT": MEASUREMENT_PLOT,
                "I015/000/RG": 0,
                "I015/020/MOMU": geometry,
                "I015/020/TTAX": SIMULATED,
                "I015/020/SCD": scanning,
            },
            deviations=DEVIATIONS,
            max_octets=max_octets,
        )

    def _columns(
        self, plots: Plots, parts: Parts, first_observation: ArrayLike = 0
    ) -> Mapping[str, ArrayLike]:
        columns: dict[str, Floats | Ints] = {"I015/145": plots.t_utc_ns}
        columns |= measured(plots, self._told)
        snr = measured(plots, {"I015/630/RPS": "snr"})
        columns |= {path: decibels(ratio) for path, ratio in snr.items()}
        if self._multistatic:
            columns["I015/400/PID"] = plots.channel
            first = np.atleast_1d(first_observation)
            columns["I015/400/ON"] = parts.numbered_from(first) % OBSERVATIONS
        if self._classes is not None and any(plots.kind):
            path = "I015/300/0/CLS"
            try:
                columns[path] = np.array([self._classes[kind] for kind in plots.kind.tolist()])
            except KeyError as error:
                raise EncodeError(f"no class for kind {error}", field=path) from None
            stated = plots.kind_probability
            columns["I015/300/0/PRB"] = (
                np.full(len(plots), SURE_PCT)
                if stated is None
                else np.rint(SURE_PCT * np.nan_to_num(stated)).astype(np.int64)
            )
        return columns
