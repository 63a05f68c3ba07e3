"""The target that a preset's published range is for."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel

from plotfeed.feeds.parts import Frequency, NotNegative, Part, Positive
from plotfeed.models.state import Emitter, Signature, Signatures, Targets


class CataloguePart(BaseModel):
    """A table of a preset's file: as strict as a scene's, but nothing that a scene may say."""

    model_config = Part.model_config


class PresetEmitter(CataloguePart):
    """What a target radiates."""

    frequency_hz: Frequency
    bandwidth_hz: NotNegative
    eirp_dbm: float
    kind: str = ""


class PresetTarget(CataloguePart):
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
