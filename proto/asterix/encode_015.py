"""Plots in category 015: of staring, MIMO and passive radars, and of arrays of microphones."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

import numpy as np

from plotfeed.models.state import Floats, Ints, Plots
from plotfeed.proto.asterix.cat015 import CAT015
from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Reports, looked_up, measured
from plotfeed.proto.units import TIME_LSB_NS, decibels

MEASUREMENT_PLOT = 1  # I015/000/MT
ACTUAL, SIMULATED = 0, 3  # I015/020/TTAX
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


class PlotEncoder015:
    """Measurement plots, as I015/010, 000, 020, 145, and of the others what is measured.

    Those are 300 (class), 625 (R, SDR), 626 (DV, SDDV), 627 (AZ, SDASZ), 628 (EL, SDEL), 630 (RPP
    in dBm, RPS). A multistatic sensor has 400 too: the pair of a plot's channel, and a count of
    observations. The standard leaves the sign of DV open: here a positive one recedes.

    `pairs` has the pair of each channel, by default the channel itself. `classes` has the class
    of each kind of plot, by agreement with the receiver; without it no class is sent.
    """

    def __init__(
        self,
        sac: int,
        sic: int,
        *,
        geometry: Geometry = Geometry.MONOSTATIC,
        scanning: Scanning = Scanning.STATIC,
        simulated: bool = True,
        pairs: Mapping[int, int] | None = None,
        classes: Mapping[str, int] | None = None,
        class_probability_pct: int = 100,
        max_octets: int = UDP_OCTETS,
    ) -> None:
        self._pairs = pairs
        self._classes = classes
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
                "I015/300/0/PRB": class_probability_pct,
            },
            lsb={"I015/145": TIME_LSB_NS},
            max_octets=max_octets,
        )

    def blocks(self, plots: Plots, *, first_observation: int = 0) -> list[bytes]:
        """Data blocks of all plots, in their order, none longer than `max_octets`.

        A column of nothing but NaN, or of no kinds, is not measured; one with some is an
        EncodeError. `first_observation` is the number of the first plot of a multistatic sensor.
        """
        if not len(plots):
            return []
        columns: dict[str, Floats | Ints] = {"I015/145": plots.t_utc_ns}
        columns |= measured({path: getattr(plots, name) for path, name in self._optional.items()})
        snr = measured({"I015/630/RPS": plots.snr})
        columns |= {path: decibels(ratio) for path, ratio in snr.items()}
        if self._multistatic:
            path = "I015/400/PID"
            columns[path] = plots.channel
            if self._pairs is not None:
                columns[path] = looked_up(self._pairs, plots.channel, "pair for channel", path)
            numbers = np.arange(first_observation, first_observation + len(plots))
            columns["I015/400/ON"] = numbers % OBSERVATIONS
        if self._classes is not None and any(plots.kind):
            path = "I015/300/0/CLS"
            columns[path] = looked_up(self._classes, plots.kind, "class for kind", path)
        return self._reports.blocks(columns)
