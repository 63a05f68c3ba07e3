"""The keys of what depends on where a target is in a radar's beams and cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import Azimuth, Beamwidth, Decibels, Loss, SceneTable

if TYPE_CHECKING:
    from plotfeed.models.effects.antenna import Antenna, BeamCut, Pattern
    from plotfeed.models.effects.doppler import Doppler
    from plotfeed.models.effects.echo_effects import Straddling

PAPER_SIDELOBE_DB = 22.0
"""Of the paper's passive radar."""
CellShape = Literal["sinc", "triangle", "hann"]


class BeamCover(NamedTuple):
    """A sensor's beamwidth at 3 dB over one angle, and the cover, for what a cut does not state."""

    beamwidth_deg: float
    min_deg: float
    max_deg: float


class _Beam(SceneTable):
    """What cuts with a boresight have in common."""

    boresight_deg: Azimuth | None = None
    """Where the peak is; without it, in the middle of the cover."""

    def _boresight_deg(self, cover: BeamCover) -> float:
        if self.boresight_deg is None:
            return (cover.min_deg + cover.max_deg) / 2
        return self.boresight_deg


class GaussianCutKeys(_Beam):
    """One beam of Gaussian shape."""

    kind: Literal["gaussian"]
    """Which shape."""
    beamwidth_deg: Beamwidth | None = None
    """At 3 dB; without it, the sensor's."""

    def model(self, cover: BeamCover) -> BeamCut:
        """The beam of a sensor with that cover."""
        from plotfeed.models.effects.antenna import GaussianCut

        width_deg = self.beamwidth_deg or cover.beamwidth_deg
        return GaussianCut(beamwidth_deg=width_deg, boresight_deg=self._boresight_deg(cover))


class BeamsCutKeys(SceneTable):
    """Gaussian beams side by side over the cover, by the nearest of which a target is seen."""

    kind: Literal["beams"]
    """Which shape."""
    beamwidth_deg: Beamwidth | None = None
    """At 3 dB; without it, the sensor's."""
    spacing_deg: Beamwidth | None = None
    """Between beams, at most, so that they fill the cover; without it, a beamwidth."""

    def model(self, cover: BeamCover) -> BeamCut:
        """The beams of a sensor with that cover."""
        width_deg = self.beamwidth_deg or cover.beamwidth_deg
        span_deg = cover.max_deg - cover.min_deg
        beams = max(int(np.ceil(span_deg / (self.spacing_deg or width_deg) * (1 - 1e-12))), 1)
        from plotfeed.models.effects.antenna import GaussianCut

        return GaussianCut(
            beamwidth_deg=width_deg,
            boresight_deg=(cover.min_deg + cover.max_deg) / 2,
            spacing_deg=span_deg / beams,
            beams=beams,
        )


class CosecantSquaredKeys(SceneTable):
    """A beam that gives as strong an echo at any range of a target that keeps its height."""

    kind: Literal["cosecant-squared"]
    """Which shape."""
    from_deg: Annotated[float, Field(gt=0, lt=90)]
    """Elevation of the peak, from which the gain goes as 1/sin^2."""
    to_deg: Annotated[float, Field(gt=0, lt=90)]
    """Elevation up to which it does."""
    beamwidth_deg: Beamwidth | None = None
    """At 3 dB, by which it falls off beyond the two; without it, the sensor's."""

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if not self.from_deg < self.to_deg:
            raise ValueError("to_deg: must be above from_deg")
        return self

    def model(self, cover: BeamCover) -> BeamCut:
        """The beam of a sensor with that cover."""
        from plotfeed.models.effects.antenna import CosecantSquaredCut

        width_deg = self.beamwidth_deg or cover.beamwidth_deg
        return self.made(CosecantSquaredCut, beamwidth_deg=width_deg)


class TableCutKeys(_Beam):
    """Gains as they were measured, or as somebody else has worked them out."""

    kind: Literal["table"]
    """Which shape."""
    angle_deg: Annotated[tuple[Azimuth, ...], Field(strict=False, min_length=2, max_length=10_000)]
    """Off the boresight, rising."""
    gain_db: Annotated[tuple[Decibels, ...], Field(strict=False, min_length=2, max_length=10_000)]
    """At those, one way, beside the antenna's stated gain; linear in between."""

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        if len(self.angle_deg) != len(self.gain_db):
            raise ValueError("gain_db: as many as angle_deg are needed")
        if (np.diff(self.angle_deg) <= 0).any():
            raise ValueError("angle_deg: must rise")
        return self

    def model(self, cover: BeamCover) -> BeamCut:
        """The beam of a sensor with that cover."""
        from plotfeed.models.effects.antenna import TableCut

        return TableCut(
            angles_deg=self.angle_deg,
            gains_db=self.gain_db,
            boresight_deg=self._boresight_deg(cover),
        )


AzimuthCut = Annotated[GaussianCutKeys | BeamsCutKeys | TableCutKeys, Field(discriminator="kind")]
ElevationCut = Annotated[
    GaussianCutKeys | BeamsCutKeys | CosecantSquaredKeys | TableCutKeys,
    Field(discriminator="kind"),
]


class PatternKeys(SceneTable):
    """The gain of an antenna by direction, relative to the gain that the sensor states."""

    azimuth: AzimuthCut | None = None
    """Without it, the same at all azimuths; a beam that turns meets every drone in its middle."""
    elevation: ElevationCut | None = None
    """Without it, the same at all elevations of the cover."""
    sidelobe_db: Loss = PAPER_SIDELOBE_DB
    """Nowhere is the gain further below the peak, one way."""

    def model(self, azimuth: BeamCover, elevation: BeamCover) -> Pattern:
        """The pattern of a sensor with those covers."""
        from plotfeed.models.effects.antenna import Pattern

        return self.made(
            Pattern,
            azimuth=self.azimuth and self.azimuth.model(azimuth),
            elevation=self.elevation and self.elevation.model(elevation),
        )


class AntennaKeys(SceneTable):
    """Gains that depend on where a target is, by the sensor's own axes."""

    transmit: PatternKeys | None = None
    """Of the transmitting antenna, or of each transmitter; without it, the same over the cover."""
    receive: PatternKeys | None = None
    """Of the receiving antenna; without it, the same over the cover."""
    sidelobe_plots: bool = False
    """Whether drones that the beam does not point at are reported in its direction, by what comes
    through the side lobes: at their range, and of sidelobe/ID in the ledger."""

    def model(self, azimuth: BeamCover, elevation: BeamCover) -> Antenna:
        """The antenna of a sensor with those covers."""
        transmit, receive = (
            None if part is None else part.model(azimuth, elevation)
            for part in (self.transmit, self.receive)
        )
        from plotfeed.models.effects.antenna import Antenna

        return Antenna(transmit=transmit, receive=receive, shows_sidelobes=self.sidelobe_plots)

    @model_validator(mode="after")
    def _has_sidelobes(self) -> Self:
        if self.sidelobe_plots and self.receive is None:
            raise ValueError("sidelobe_plots: needs receive, whose sidelobe_db they come by")
        return self

    @property
    def peak_loss_db(self) -> float:
        """What the shape of the receiving beam costs at its peak, by the beamwidths alone."""
        cut = None if self.receive is None else self.receive.elevation
        if not isinstance(cut, CosecantSquaredKeys):
            return 0.0
        from plotfeed.models.effects.antenna import cosecant_peak_loss_db

        return float(cosecant_peak_loss_db(cut.from_deg, cut.to_deg))

    @property
    def has_azimuths(self) -> bool:
        """Whether a pattern depends on the azimuth."""
        return any(part is not None and part.azimuth for part in (self.transmit, self.receive))


class StraddlingKeys(SceneTable):
    """What is lost between the middles of cells, for each look by where the target is in them."""

    range: CellShape | None = None
    """Shape of a range cell: sinc of a flat spectrum, triangle of a pulse's correlation, hann."""
    doppler: CellShape | None = None
    """The same of a Doppler cell; hann's noise, 1.76 dB more, belongs in loss_db."""

    def model(self, range_cells_m: Sequence[float], doppler: Doppler | None) -> Straddling:
        """What a sensor with those cells loses, by signal."""
        from plotfeed.models.effects.echo_effects import Straddling

        return Straddling(
            range_cells_m=tuple(range_cells_m),
            range_shape=self.range,
            doppler_cells_m_s=() if doppler is None else doppler.cells_m_s,
            doppler_shape=self.doppler,
        )
