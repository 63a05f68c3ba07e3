"""The keys of a pulsed radar: what its pulse frequencies make ambiguous or blind, and its looks."""

from __future__ import annotations

from itertools import cycle, islice
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import NotNegative, Positive, SceneTable
from plotfeed.models.propagation import C_M_S

if TYPE_CHECKING:
    from plotfeed.models.effects.pulse_intervals import PulseIntervals


class PulsesKeys(SceneTable):
    """Pulses, and the intervals of coherent integration, of `integration_s` each, in one look."""

    prf_hz: Annotated[tuple[Positive, ...], Field(strict=False, min_length=1, max_length=64)]
    """Pulse frequencies, which intervals take in turn. One alone leaves ranges folded after
    c/2PRF and rates after wavelength times PRF/2; several resolve both."""
    intervals: Annotated[int, Field(ge=1, le=64)] | None = None
    """In one look; without it, one a frequency. Echoes fluctuate anew in each."""
    needed: Annotated[int, Field(ge=1, le=64)] = 1
    """Intervals that have to detect; `pfa` is that of each. The first of them is measured by."""
    pulse_s: NotNegative = 0.0
    """Length of a pulse, during which nothing is heard; 0 eclipses nothing."""
    stc_range_m: NotNegative = 0.0
    """Nearer than this, counted from the latest pulse, echoes are weakened before the receiver's
    noise; 0 for no sensitivity-time control."""
    stc_exponent: Annotated[float, Field(ge=0, le=4)] = 4.0
    """Of range, by which they are; 4 makes a target as strong at all ranges below."""
    canceller: Literal["single", "double"] | None = None
    """Of pulses: single of two, double of three; blind at whole wavelengths times PRF/2."""
    notch_m_s: NotNegative = 0.0
    """Width of a notch about those speeds: of the power 1 - exp(-(rate/notch)^2) is left."""
    beam_passes: bool = False
    """Of a radar that turns: each interval has what the beam, Gaussian on receive, leaves of the
    echo meanwhile. Put no loss for the shape of the beam into loss_db beside it."""

    @model_validator(mode="after")
    def _can_be(self) -> Self:
        if self.intervals is not None and self.intervals < len(self.prf_hz):
            raise ValueError("intervals: at least one for each of prf_hz")
        if self.needed > self.count:
            raise ValueError(f"needed: must not exceed the {self.count} intervals")
        if self.pulse_s * max(self.prf_hz) > 0.5:
            raise ValueError("pulse_s: must not exceed half of the time between pulses")
        return self

    @property
    def count(self) -> int:
        """Intervals of a look."""
        return self.intervals or len(self.prf_hz)

    @property
    def folding_prf_hz(self) -> float | None:
        """The only pulse frequency; None where several tell ranges and rates apart."""
        return self.prf_hz[0] if len(set(self.prf_hz)) == 1 else None

    def model(
        self, *, interval_s: float, frequency_hz: float, beamwidth_deg: float, turn_s: float | None
    ) -> PulseIntervals:
        """The intervals of a radar that turns in such a time, or of one that stares."""
        beam = None
        from plotfeed.models.effects.pulse_intervals import PassingBeam, PulseIntervals

        if self.beam_passes and turn_s is not None:
            beam = PassingBeam(beamwidth_deg=beamwidth_deg, step_deg=360 * interval_s / turn_s)
        return self.made(
            PulseIntervals,
            prfs_hz=tuple(islice(cycle(self.prf_hz), self.count)),
            interval_s=interval_s,
            wavelength_m=C_M_S / frequency_hz,
            beam=beam,
        )

    def warnings(self, range_max_m: float) -> list[str]:
        """Ranges that fold within the instrumented one."""
        if self.folding_prf_hz is None:
            return []
        folds_at_m = C_M_S / (2 * self.folding_prf_hz)
        if folds_at_m >= range_max_m:
            return []
        return [
            f"pulses.prf_hz is {self.folding_prf_hz:g}: drones beyond {folds_at_m:.0f} m are told "
            "nearer by as much; two frequencies tell them apart"
        ]
