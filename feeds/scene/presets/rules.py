"""The rules by which a preset's keys follow from published figures, and from each other."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, Field, model_validator

from plotfeed.feeds.scene.fields import Frequency, NotNegative, Positive, SceneTable
from plotfeed.models.constants import C_M_S
from plotfeed.models.propagation import beam_gain_dbi
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Emitter, Signature, Signatures


def short(value: float) -> str:
    """A number to five digits, such as 2.4e9."""
    return f"{value:.5g}".replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")


class CatalogueTable(BaseModel):
    """A table of a preset's file: as strict as a scene's, but nothing that a scene may say."""

    model_config = SceneTable.model_config


class PresetEmitter(CatalogueTable):
    """What a target radiates."""

    frequency_hz: Frequency
    bandwidth_hz: NotNegative
    eirp_dbm: float
    kind: str = ""


class PresetTarget(CatalogueTable):
    """The target that a published range is for."""

    range_m: Positive
    """Slant."""
    above_sensor_m: NotNegative = 50.0
    rcs_m2: Positive | None = None
    sound_power_db: float | None = None
    emitter: PresetEmitter | None = None
    note: str
    """Where the range stands, and what is assumed of the target."""

    @property
    def signature(self) -> Signature:
        """What there is of it to sense."""
        return Signature(
            rcs_m2=np.nan if self.rcs_m2 is None else self.rcs_m2,
            sound_power_db=np.nan if self.sound_power_db is None else self.sound_power_db,
            emitters=(Emitter(**self.emitter.model_dump()),) if self.emitter else (),
        )

    def __str__(self) -> str:
        if self.rcs_m2 is not None:
            return f"{self.rcs_m2:g} m2"
        if self.sound_power_db is not None:
            return f"{self.sound_power_db:g} dB of sound power"
        return f"{self.emitter.eirp_dbm:g} dBm EIRP" if self.emitter else "no target"


def targets(target: PresetTarget) -> Targets:
    """The one target, north of the sensor."""
    up_m = min(target.above_sensor_m, target.range_m)
    enu_m = np.array([[0.0, (target.range_m**2 - up_m**2) ** 0.5, up_m]])
    signature = target.signature
    return Targets(
        drone=np.zeros(1, np.int64),
        t_utc_ns=np.zeros(1, np.int64),
        position_enu_m=enu_m,
        true_position_enu_m=enu_m,
        signatures=Signatures(
            rcs_m2=np.array([signature.rcs_m2]),
            sound_power_db=np.array([signature.sound_power_db]),
            emitters=[signature.emitters],
        ),
    )


class PresetRule(CatalogueTable):
    """How a key's value comes about, and why so."""

    note: str


class PlainRule(PresetRule):
    """A value from figures and from other keys."""

    @abstractmethod
    def value(self, keys: Mapping[str, Any]) -> Any:
        """From the keys that are known so far."""


class MiddleOf(PlainRule):
    """The middle of a band."""

    middle_of: Annotated[tuple[float, float], Field(strict=False)]

    def value(self, _keys: Mapping[str, Any], /) -> float:
        """Their mean."""
        return sum(self.middle_of) / 2

    def __str__(self) -> str:
        return f"middle of {short(self.middle_of[0])} and {short(self.middle_of[1])}"


class ProductOf(PlainRule):
    """One figure times another."""

    product_of: Annotated[tuple[float, float], Field(strict=False)]

    def value(self, _keys: Mapping[str, Any], /) -> float:
        """Their product."""
        return self.product_of[0] * self.product_of[1]

    def __str__(self) -> str:
        return f"{self.product_of[0]:g} times {self.product_of[1]:g}"


class CellOfBandwidth(PlainRule):
    """The range resolution that a bandwidth gives."""

    cell_of_bandwidth_hz: Positive

    def value(self, _keys: Mapping[str, Any], /) -> float:
        """c/(2B), metres."""
        return C_M_S / (2 * self.cell_of_bandwidth_hz)

    def __str__(self) -> str:
        return f"c/(2B) for B of {self.cell_of_bandwidth_hz / 1e6:g} MHz"


class GainOfBeam(PlainRule):
    """The gain of a beam that is not the receive beam."""

    gain_of_beam_deg: Annotated[tuple[float, float], Field(strict=False)]

    def value(self, _keys: Mapping[str, Any], /) -> float:
        """41253 over the product of its widths, dBi."""
        return float(beam_gain_dbi(*self.gain_of_beam_deg))

    def __str__(self) -> str:
        return f"gain of a beam of {self.gain_of_beam_deg[0]:g} x {self.gain_of_beam_deg[1]:g} deg"


class Turning(PlainRule):
    """The scan of an antenna that turns so fast."""

    turning_deg_s: Positive

    def value(self, _keys: Mapping[str, Any], /) -> dict[str, Any]:
        """The scan."""
        return {"kind": "rotating", "period_s": 360 / self.turning_deg_s}

    def __str__(self) -> str:
        return f"360 deg at {self.turning_deg_s:g} deg/s"


class Updating(PlainRule):
    """The scan of a sensor that sees its whole cover so often."""

    updating_hz: Positive

    def value(self, _keys: Mapping[str, Any], /) -> dict[str, Any]:
        """The scan."""
        return {"kind": "staring", "period_s": 1 / self.updating_hz}

    def __str__(self) -> str:
        return f"all cover at {self.updating_hz:g} Hz"


class ShareOf(PlainRule):
    """A share of another key."""

    share_of: str
    share: Positive

    def value(self, keys: Mapping[str, Any]) -> float:
        """The other key's value times the share."""
        return float(self.share * keys[self.share_of])

    def __str__(self) -> str:
        return f"{self.share:g} of {self.share_of}"


class ShareOfTimeOnTarget(PlainRule):
    """How long a turning beam integrates."""

    share_of_time_on_target: Annotated[float, Field(gt=0, le=1)]

    def value(self, keys: Mapping[str, Any]) -> float:
        """The time for which the beam is on a target in one turn, times the share."""
        beam_deg = keys["azimuth_beamwidth_deg"] * keys.get("receive_beams", 1)
        on_target_s = keys["scan"]["period_s"] * beam_deg / 360
        return float(self.share_of_time_on_target * on_target_s)

    def __str__(self) -> str:
        share = self.share_of_time_on_target
        return f"{f'{share:g} of ' if share < 1 else ''}the time that the beam is on a target"


class Goal(CatalogueTable):
    """What the sensor's own prediction of the preset's target is to come to."""

    pd: Annotated[float, Field(gt=0, lt=1)] | None = None
    sigma_range_m: Positive | None = None
    sigma_azimuth_deg: Positive | None = None
    sigma_elevation_deg: Positive | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        if len(self.model_dump(exclude_none=True)) != 1:
            raise ValueError("a rule solves for one thing")
        return self

    @property
    def quantity(self) -> str:
        """Its name in `Prediction`."""
        return next(iter(self.model_dump(exclude_none=True)))

    @property
    def wanted(self) -> float:
        """Its value."""
        return float(getattr(self, self.quantity))


class Solve(PresetRule):
    """The value for which the model comes to a published figure: the model itself, inverted."""

    solve: Goal

    def __str__(self) -> str:
        return f"such that {self.solve.quantity} = {self.solve.wanted:g} at the quoted range"


AnyRule = (
    MiddleOf
    | ProductOf
    | CellOfBandwidth
    | GainOfBeam
    | Turning
    | Updating
    | ShareOf
    | ShareOfTimeOnTarget
    | Solve
)
