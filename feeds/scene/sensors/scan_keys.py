"""How a sensor scans, and a scripted event that makes it otherwise while the scene runs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from plotfeed.feeds.scene.fields import ForAWhile, NotNegative, SceneTable
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.proto.utc import NS


class Event(ForAWhile):
    """A [[sensor.event]] of the scene: the sensor is otherwise for a while."""

    from_s: NotNegative
    """When it begins, after the session has."""
    set: Annotated[dict[str, Any], Field(min_length=1)]
    """Keys with other values meanwhile: { enabled = false }, { link = { down = true } }, or {
    pfa_factor = 10 } for ten times its pfa."""


class _Periodic(SceneTable):
    """What all scans have in common."""

    rotates: ClassVar[bool] = False
    """Whether a beam turns."""

    period_s: Annotated[float, Field(ge=0.02, le=3600)]
    """Of a scan."""
    jitter_ms: NotNegative = 0.0
    """Standard deviation of a scan's beginning from its time; at most a fiftieth of the period."""

    def _refusals(self) -> Iterator[str]:
        if self.jitter_ms * 50 > self.period_s * 1000:
            yield "jitter_ms: at most a fiftieth of period_s"

    @property
    def period_ns(self) -> int:
        """Nanoseconds of a scan."""
        return round(self.period_s * NS)


class RotatingScan(_Periodic):
    """A beam that turns clockwise, at true north at multiples of its period."""

    kind: Literal["rotating"]
    sectors: Annotated[int, Field(ge=4, le=256)] = 32
    """Reports a turn; a divisor of 256 makes their edges exact in CAT034."""
    rotates = True


class StaringScan(_Periodic):
    """A sensor that looks everywhere at once, at whole multiples of its period."""

    kind: Literal["staring"]
    sectors: ClassVar[int] = 1
    """Reports a scan."""


class ElectronicScan(_Periodic):
    """A beam steered dwell by dwell: search, confirmation and tracking."""

    kind: Literal["electronic"]
    sectors: ClassVar[int] = 1
    """Reports a period."""
    dwell_s: Annotated[float, Field(ge=1e-5, le=10)]
    """How long the beam rests in a direction."""
    beam_spacing: Annotated[float, Field(ge=0.2, le=2)] = 1.0
    """Between neighbouring beams of search, in beamwidths."""
    max_tracks: Annotated[int, Field(ge=0, le=10_000)] = 20
    """Looked at again; with as many, others are found by search alone."""
    search_share: Annotated[float, Field(ge=0.01, le=1)] = 0.2
    """Least share of the dwells for search; tracks that are due wait meanwhile."""
    revisit_s: Annotated[float, Field(gt=0, le=100)] | None = None
    """When a track is looked at again; without it, by the next three keys."""
    manoeuvre_m_s2: Annotated[float, Field(ge=0.01, le=1000)] = 5.0
    """Standard deviation of accelerations that are expected of targets."""
    manoeuvre_s: Annotated[float, Field(ge=0.01, le=1000)] = 5.0
    """For which such an acceleration lasts."""
    error_ratio: Annotated[float, Field(ge=0.05, le=1)] = 0.5
    """Of the error of a track's prediction to that of one measurement, when it is looked at."""
    drop_misses: Annotated[int, Field(ge=1, le=1000)] = 5
    """Looks in a row without a detection after which a track is given up."""

    def _refusals(self) -> Iterator[str]:
        if self.period_s / self.dwell_s < FEWEST_DWELLS:
            yield f"dwell_s: a period has at least {FEWEST_DWELLS} dwells"

    def refusals_of(self, keys: Any) -> Iterator[str]:
        """Keys of a radar that are not modelled of a steered beam."""
        if keys.integration_s > self.dwell_s:
            yield "integration_s: must not exceed scan.dwell_s"
        for name in ("doppler", "merging", "pulses"):
            if getattr(keys, name) is not None:
                yield f"{name}: not modelled of a beam that is steered"
        for name in keys.report:
            if REPORT_FORMATS[name].tells_tracks:
                yield f"report: {name} is not for a beam that is steered"

    def warnings(self) -> Iterator[str]:
        """More tracks than there is time for."""
        every_s = self.revisit_s or self.period_s
        load = self.max_tracks * self.dwell_s / every_s
        if load > 1 - self.search_share:
            yield (
                f"scan.max_tracks is {self.max_tracks}: looked at every {every_s:g} s they would "
                f"take {load:.3g} of all dwells, and search has {self.search_share:g}: fewer are "
                "begun"
            )


FEWEST_DWELLS = 4
Scan = Annotated[RotatingScan | StaringScan, Field(discriminator="kind")]
# Of radars with one beam, which may be steered.
AnyScan = Annotated[RotatingScan | StaringScan | ElectronicScan, Field(discriminator="kind")]
