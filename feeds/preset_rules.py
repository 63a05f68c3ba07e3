"""The rules by which a preset's keys follow from published figures, and from each other."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, model_validator
from scipy.optimize import brentq

from plotfeed.feeds.parts import Frequency, NotNegative, Part, Positive, Site
from plotfeed.feeds.sensors import Sensor
from plotfeed.models.constants import C_M_S
from plotfeed.models.propagation import beam_gain_dbi
from plotfeed.models.state import Emitter, Signature, Signatures, Targets
from plotfeed.proto.errors import PlotfeedError

SITE = Site(latitude_deg=0.0, longitude_deg=0.0, height_m=0.0)
"""What a sensor predicts of a target does not depend on where on Earth both are."""
MARGIN = 1e-9
"""By how much a goal is overshot, so that rounding does not leave the model below it."""
BRACKETS = {"_w": (1e-9, 1e9), "_db": (-200.0, 200.0), "_deg": (0.0, 90.0), "_m": (0.0, 1e4)}
"""Where the value of a key of that unit is looked for."""

_SENSOR: TypeAdapter[Sensor] = TypeAdapter(Sensor)


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


class Rule(CataloguePart):
    """How a key's value comes about, and why so."""

    note: str

    @abstractmethod
    def value(self, keys: Mapping[str, Any]) -> Any:
        """From the keys that are known so far."""


class MiddleOf(Rule):
    """The middle of a band."""

    middle_of: Annotated[tuple[float, float], Field(strict=False)]

    def value(self, _keys: Mapping[str, Any], /) -> float:
        """Their mean."""
        return sum(self.middle_of) / 2

    def __str__(self) -> str:
        return f"middle of {self.middle_of[0]:g} and {self.middle_of[1]:g}"


class ProductOf(Rule):
    """One figure times another."""

    product_of: Annotated[tuple[float, float], Field(strict=False)]

    def value(self, _keys: Mapping[str, Any], /) -> float:
        """Their product."""
        return self.product_of[0] * self.product_of[1]

    def __str__(self) -> str:
        return f"{self.product_of[0]:g} times {self.product_of[1]:g}"


class CellOfBandwidth(Rule):
    """The range resolution that a bandwidth gives."""

    cell_of_bandwidth_hz: Positive

    def value(self, _keys: Mapping[str, Any], /) -> float:
        """c/(2B), metres."""
        return C_M_S / (2 * self.cell_of_bandwidth_hz)

    def __str__(self) -> str:
        return f"c/(2B) for B of {self.cell_of_bandwidth_hz / 1e6:g} MHz"


class GainOfBeam(Rule):
    """The gain of a beam that is not the receive beam."""

    gain_of_beam_deg: Annotated[tuple[float, float], Field(strict=False)]

    def value(self, _keys: Mapping[str, Any], /) -> float:
        """41253 over the product of its widths, dBi."""
        return float(beam_gain_dbi(*self.gain_of_beam_deg))

    def __str__(self) -> str:
        return f"gain of a beam of {self.gain_of_beam_deg[0]:g} x {self.gain_of_beam_deg[1]:g} deg"


class Turning(Rule):
    """The scan of an antenna that turns so fast."""

    turning_deg_s: Positive

    def value(self, _keys: Mapping[str, Any], /) -> dict[str, Any]:
        """The scan."""
        return {"kind": "rotating", "period_s": 360 / self.turning_deg_s}

    def __str__(self) -> str:
        return f"360 deg at {self.turning_deg_s:g} deg/s"


class Updating(Rule):
    """The scan of a sensor that sees its whole cover so often."""

    updating_hz: Positive

    def value(self, _keys: Mapping[str, Any], /) -> dict[str, Any]:
        """The scan."""
        return {"kind": "staring", "period_s": 1 / self.updating_hz}

    def __str__(self) -> str:
        return f"all cover at {self.updating_hz:g} Hz"


class ShareOf(Rule):
    """A share of another key."""

    share_of: str
    share: Positive

    def value(self, keys: Mapping[str, Any]) -> float:
        """The other key's value times the share."""
        return float(self.share * keys[self.share_of])

    def __str__(self) -> str:
        return f"{self.share:g} of {self.share_of}"


class ShareOfTimeOnTarget(Rule):
    """How long a turning beam integrates."""

    share_of_time_on_target: Annotated[float, Field(gt=0, le=1)]

    def value(self, keys: Mapping[str, Any]) -> float:
        """The time for which the beam is on a target in one turn, times the share."""
        beam_deg = keys["azimuth_beamwidth_deg"] * keys.get("receive_beams", 1)
        on_target_s = keys["scan"]["period_s"] * beam_deg / 360
        return float(self.share_of_time_on_target * on_target_s)

    def __str__(self) -> str:
        return f"{self.share_of_time_on_target:g} of the time that the beam is on a target"


class Goal(CataloguePart):
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


class Solve(Rule):
    """The value for which the model comes to a published figure: the model itself, inverted."""

    solve: Goal

    def value(self, _keys: Mapping[str, Any], /) -> float:
        """What is solved for needs the target as well."""
        raise NotImplementedError

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


def derive(
    kind: str, given: Mapping[str, Any], rules: Mapping[str, AnyRule], target: PresetTarget
) -> dict[str, Any]:
    """The values of the rules' keys, for a sensor of that type.

    Plain rules go first, in their order, because solving takes a whole sensor; then what is solved
    for, in its order, so that an error floor is found at the power that was found before it.
    """
    derived: dict[str, Any] = {}
    solves = {key: rule for key, rule in rules.items() if isinstance(rule, Solve)}
    for key, rule in rules.items():
        if key not in solves:
            derived[key] = rule.value({**given, **derived})
    derived |= {key: _bracket(key)[0] for key in solves}
    if not solves:
        return derived
    # The brackets' ends may lie outside what a scene may say; the answers are validated later.
    start = {key: max(_bracket(key)[0], 0.0) for key in solves}
    sensor = _SENSOR.validate_python({**given, **derived, **start, "type": kind, "id": "preset"})
    for key, rule in solves.items():
        derived[key] = _solved(sensor, key, rule.solve, target)
        sensor = sensor.model_copy(update={key: derived[key]})
    return derived


def predicted(sensor: Sensor, target: PresetTarget, quantity: str) -> float:
    """One quantity of what the sensor's model predicts of the target."""
    prediction = sensor.model(SITE).predict(_targets(target))
    return float(getattr(prediction, quantity)[0])


def _solved(sensor: Sensor, key: str, goal: Goal, target: PresetTarget) -> float:
    """The key's value by Brent's method; of powers, over their logarithm."""
    ends = _bracket(key)
    in_decades = ends[0] > 0

    def value_at(x: float) -> float:
        return float(10**x) if in_decades else x

    def surplus(x: float) -> float:
        trial = sensor.model_copy(update={key: value_at(x)})
        return predicted(trial, target, goal.quantity) - goal.wanted - MARGIN

    low, high = (math.log10(end) if in_decades else end for end in ends)
    try:
        return value_at(brentq(surplus, low, high, xtol=1e-12, rtol=1e-14))
    except ValueError:
        text = f"{key}: no value gives {goal.quantity} {goal.wanted:g}"
        raise PlotfeedError(text) from None


def _bracket(key: str) -> tuple[float, float]:
    return BRACKETS[f"_{key.rpartition('_')[2]}"]


def _targets(target: PresetTarget) -> Targets:
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
