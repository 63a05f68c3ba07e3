"""Ways from transmitter to receiver that a scene did not ask for: for stages to compare.

Of a sensor's looks at targets, the ratio that `pd_of` takes, by way: a look is at one target, by
the best of the sensor's signals where each of them is a look of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from plotfeed.models import propagation
from plotfeed.models.acoustic import REFERENCE_DISTANCE_M, MicrophoneArray
from plotfeed.models.constants import C_M_S
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.mimo_radar import MimoRadar
from plotfeed.models.multipath import Multipath
from plotfeed.models.passive_radar import PassiveRadar
from plotfeed.models.polar_radar import PolarRadar
from plotfeed.models.rf import Emissions, RfSensor
from plotfeed.models.sensor import SensorModel
from plotfeed.models.state import Floats, Targets

FREE_SPACE = "free space"
TWO_RAYS = "two rays, flat ground"
REFLECTION = -0.9
"""Of a ground that no scene describes: nearly all, and turned over, as at grazing incidence."""
LOWEST_ANTENNA_M = 1.5
"""Above it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ways:
    """Ratios by way, and the Pd that they lead to, (n,); `ours` names what the scene asks for."""

    ratios: dict[str, Callable[[], Floats]]
    pd_of: Callable[[Floats], Floats]
    ours: str


@singledispatch
def ways(_model: SensorModel, _targets: Targets, _antenna_m: float) -> Ways | None:
    """Of a sensor whose antenna is so high above the site; None if it has no propagation."""
    return None


@ways.register
def _(model: PolarRadar, targets: Targets, antenna_m: float) -> Ways:
    place_enu_m, rcs_m2 = targets.position_enu_m, targets.rcs_m2()
    ground, wavelength_m = _ground(antenna_m), C_M_S / model.frequency_hz

    def two_rays() -> Floats:
        back = ground.power_factor(place_enu_m, wavelength_m)[:, None]
        there = _from_transmitters(model, ground, place_enu_m, wavelength_m)
        return model.signal_snrs(place_enu_m, rcs_m2) * back * (back if there is None else there)

    return Ways(
        ratios={
            FREE_SPACE: lambda: model.signal_snrs(place_enu_m, rcs_m2),
            TWO_RAYS: two_rays,
        },
        pd_of=model.pd,
        ours=FREE_SPACE,
    )


@ways.register
def _(model: PassiveRadar, targets: Targets, antenna_m: float) -> Ways:
    place_enu_m, rcs_m2 = targets.position_enu_m, targets.rcs_m2()
    ground = _ground(antenna_m)
    wavelengths_m = C_M_S / np.array([t.frequency_hz for t in model.transmitters])

    def two_rays() -> Floats:
        back = ground.power_factor(place_enu_m[:, None], wavelengths_m)
        there = ground.power_factor(place_enu_m[:, None], wavelengths_m, model.positions_enu_m)
        return model.mean_snr(model.target_power_w(place_enu_m, rcs_m2) * back * there)

    return Ways(
        ratios={
            FREE_SPACE: lambda: model.mean_snr(model.target_power_w(place_enu_m, rcs_m2)),
            TWO_RAYS: two_rays,
        },
        pd_of=lambda snrs: model.pd(snrs.max(axis=1)),
        ours=FREE_SPACE,
    )


@ways.register
def _(model: RfSensor, targets: Targets, antenna_m: float) -> Ways:
    emissions = Emissions.of(targets)
    source, ground = emissions.target, _ground(antenna_m)
    place_enu_m = targets.position_enu_m[source]
    wavelength_m = C_M_S / emissions.frequency_hz

    def as_asked() -> Floats:
        return model.mean_snr(emissions, enu_to_aer(place_enu_m)[2])

    def pd_of(snr: Floats) -> Floats:
        missed = np.ones(len(targets))
        np.multiply.at(missed, source, 1 - np.nan_to_num(model.pd(emissions, snr)))
        return 1 - missed

    ours = FREE_SPACE if model.path_loss_exponent == 2 else "log-distance"
    return Ways(
        ratios={
            ours: as_asked,
            TWO_RAYS: lambda: as_asked() * ground.power_factor(place_enu_m, wavelength_m),
        },
        pd_of=pd_of,
        ours=ours,
    )


@ways.register
def _(model: MicrophoneArray, targets: Targets, _antenna_m: float) -> Ways:
    place_enu_m, power_level_db = targets.position_enu_m, targets.sound_power_db()

    def in_the_open() -> Floats:
        range_m = np.maximum(enu_to_aer(place_enu_m)[2], REFERENCE_DISTANCE_M)
        lost_db = propagation.sound_divergence_db(range_m) + model.absorption_db_per_m * range_m
        level_db = propagation.sound_level_db(power_level_db, model.directivity_db, lost_db)
        return level_db + model.array_gain_db - model.noise_db

    ours = "air, ground and barriers"
    return Ways(
        ratios={
            "spreading and air": in_the_open,
            ours: lambda: model.snr_db(power_level_db, place_enu_m),
        },
        pd_of=model.pd,
        ours=ours,
    )


def _ground(antenna_m: float) -> Multipath:
    return Multipath(reflection=REFLECTION, antenna_height_m=max(antenna_m, LOWEST_ANTENNA_M))


def _from_transmitters(
    model: PolarRadar, ground: Multipath, place_enu_m: Floats, wavelength_m: float
) -> Floats | None:
    """The way there, (n, K), where it is not the way back."""
    if not isinstance(model, MimoRadar):
        return None
    from_enu_m = np.array([t.position_enu_m for t in model.transmitters])
    return ground.power_factor(place_enu_m[:, None], wavelength_m, from_enu_m)
