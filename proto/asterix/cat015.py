"""Category 015, target reports of non-cooperative surveillance: encoder of plots.

Staring, MIMO and passive radars and arrays of microphones report in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum

import numpy as np

from plotfeed.models.state import Floats, Ints, Plots
from plotfeed.proto.asterix.codec.encode import UDP_OCTETS
from plotfeed.proto.asterix.codec.reports import Parts, Reports, looked_up, measured
from plotfeed.proto.asterix.layout_015 import CAT015
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.units import TIME_LSB_NS, decibels

MEASUREMENT_PLOT = 1  # I015/000/MT
ACTUAL, SIMULATED = 0, 3  # I015/020/TTAX
MOST_PROBABLE_PCT = 100
OBSERVATIONS = 1 << 24  # I015/400/ON counts so far, then from 0


class Geometry(IntEnum):
    """What the range of I015/625 is, I015/020/MOMU."""

    MONOSTATIC = 0
    """The distance of the target."""
    MULTISTATIC = 1
    """The path transmitter-target-receiver less the baseline."""
    OTHER = 2
    """No range: a sensor of bearings."""


class Scanning(IntEnum):
    """How the beam moves, I015/020/SCD."""

    UNKNOWN = 0
    FORWARD = 1
    BACKWARD = 2
    STATIC = 3


RANGES = {
    Geometry.MONOSTATIC: ("range_m", "sigma_range_m"),
    Geometry.MULTISTATIC: ("bistatic_range_m", "sigma_bistatic_range_m"),
}
"""The columns of plots for range and its standard deviation."""

OPTIONAL = {
    "I015/626/DV": "range_rate_m_s",
    "I015/626/SDDV": "sigma_range_rate_m_s",
    "I015/627/AZ": "azimuth_deg",
    "I015/627/SDASZ": "sigma_azimuth_deg",
    "I015/628/EL": "elevation_deg",
    "I015/628/SDEL": "sigma_elevation_deg",
    "I015/630/RPP": "amplitude_dbm",
}
"""Parts that are sent where their columns are measured."""

DEVIATIONS = {
    "I015/625/SDR": "I015/625/R",
    "I015/626/SDDV": "I015/626/DV",
    "I015/627/SDASZ": "I015/627/AZ",
    "I015/628/SDEL": "I015/628/EL",
}
"""Standard deviations, and whose they are."""


class PlotEncoder015:
    """Measurement plots, as I015/010, 000, 020, 145, and of the others what is measured.

    Those are 300 (class), 625 (R, SDR), 626 (DV, SDDV), 627 (AZ, SDASZ), 628 (EL, SDEL), 630 (RPP
    in dBm, RPS). Standard deviations hold the rounding of their values, and are rounded up. A
    multistatic sensor has 400 too: the pair of a plot's channel, and a count of observations. The
    standard leaves the sign of DV open: here a positive one recedes.

    `pairs` has the pair of each channel, by default the channel itself. `classes` has the class
    of each kind of plot, by agreement with the receiver; without it no class is sent. It is
    `class_probability_pct` probable where plots do not say how probable theirs is. Several
    sensors have a SAC, SIC, manner of scanning and limit of octets each, in sequences.
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        geometry: Geometry = Geometry.MONOSTATIC,
        scanning: Scanning | Sequence[Scanning] = Scanning.STATIC,
        simulated: bool = True,
        pairs: Mapping[int, int] | None = None,
        classes: Mapping[str, int] | None = None,
        class_probability_pct: int = 100,
        max_octets: int | Sequence[int] = UDP_OCTETS,
    ) -> None:
        self._pairs = pairs
        self._classes = classes
        if not 0 <= class_probability_pct <= MOST_PROBABLE_PCT:
            raise EncodeError(
                f"{class_probability_pct} is not from 0 to {MOST_PROBABLE_PCT}",
                field="I015/300/0/PRB",
            )
        self._class_probability_pct = class_probability_pct
        self._multistatic = geometry is Geometry.MULTISTATIC
        ranges = dict(zip(("I015/625/R", "I015/625/SDR"), RANGES.get(geometry, ()), strict=False))
        self._optional = ranges | OPTIONAL
        self._reports = Reports(
            CAT015,
            ("I015/010", "I015/000", "I015/020", "I015/145")
            + (("I015/400",) if self._multistatic else ()),
            ("I015/300*1", *self._optional, "I015/630/RPS"),
            constants={
                "I015/010/SAC": sac,
                "I015/010/SIC": sic,
                "I015/000/MT": MEASUREMENT_PLOT,
                "I015/000/RG": 0,
                "I015/020/MOMU": geometry,
                "I015/020/TTAX": SIMULATED if simulated else ACTUAL,
                "I015/020/SCD": scanning,
            },
            lsb={"I015/145": TIME_LSB_NS},
            deviations=DEVIATIONS,
            max_octets=max_octets,
        )

    def blocks(self, plots: Plots, *, first_observation: int = 0) -> list[bytes]:
        """Data blocks of all plots of one sensor, in their order, none longer than `max_octets`.

        A column of nothing but NaN, or of no kinds, is not measured; one with some is an
        EncodeError. `first_observation` is the number of the first plot of a multistatic sensor.
        """
        first = np.array([first_observation], np.int64)
        return self.blocks_by(plots, Parts.whole(len(plots)), first)[0]

    def blocks_by(self, plots: Plots, parts: Parts, first_observation: Ints) -> list[list[bytes]]:
        """Data blocks of each part of the plots; all of them measure the same.

        `first_observation` is the number of the first plot of each part, (m,).
        """
        if not len(plots):
            return [[] for _ in range(len(parts))]
        columns: dict[str, Floats | Ints] = {"I015/145": plots.t_utc_ns}
        columns |= measured(plots, self._optional)
        snr = measured(plots, {"I015/630/RPS": "snr"})
        columns |= {path: decibels(ratio) for path, ratio in snr.items()}
        if self._multistatic:
            path = "I015/400/PID"
            columns[path] = plots.channel
            if self._pairs is not None:
                columns[path] = looked_up(self._pairs, plots.channel, "pair for channel", path)
            columns["I015/400/ON"] = parts.numbered_from(first_observation) % OBSERVATIONS
        if self._classes is not None and any(plots.kind):
            path = "I015/300/0/CLS"
            columns[path] = looked_up(self._classes, plots.kind, "class for kind", path)
            columns["I015/300/0/PRB"] = self._probabilities_pct(plots)
        return self._reports.blocks_by(columns, parts)

    def _probabilities_pct(self, plots: Plots) -> Ints:
        """Probabilities of classes, whole percent; 0 of what has no class."""
        stated = plots.kind_probability
        if stated is None:
            return np.full(len(plots), self._class_probability_pct, np.int64)
        return np.rint(100 * np.nan_to_num(stated)).astype(np.int64)
