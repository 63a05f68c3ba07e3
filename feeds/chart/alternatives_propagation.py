"""Ways from transmitter to receiver that a scene did not ask for: for stages to compare.

Of a sensor's looks at targets, the ratio that `pd_of` takes, by way: a look is at one target, by
the best of the sensor's signals where each of them is a look of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import singledispatch

import numpy as np

from plotfeed.models import propagation
from plotfeed.models.acoustic import REFERENCE_DISTANCE_M, MicrophoneArray
from plotfeed.models.constants import C_M_S
from plotfeed.models.frames import enu_to_aer
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
    free = replace(model, multipath=None)
    grounded = replace(model, multipath=model.multipath or _ground(antenna_m))
    return Ways(
        ratios={
            FREE_SPACE: lambda: free.signal_snrs(place_enu_m, rcs_m2),
            TWO_RAYS: lambda: grounded.signal_snrs(place_enu_m, rcs_m2),
        },
        pd_of=model.pd,
        ours=FREE_SPACE if model.multipath is None else TWO_RAYS,
    )


@ways.register
def _(model: PassiveRadar, targets: Targets, antenna_m: float) -> Ways:
    place_enu_m, rcs_m2 = targets.position_enu_m, targets.rcs_m2()
    free = replace(model, multipath=None)
    grounded = replace(model, multipath=model.multipath or _ground(antenna_m))
    return Ways(
        ratios={
            FREE_SPACE: lambda: free.mean_snr(free.target_power_w(place_enu_m, rcs_m2)),
            TWO_RAYS: lambda: grounded.mean_snr(grounded.target_power_w(place_enu_m, rcs_m2)),
        },
        pd_of=lambda snrs: model.pd(snrs.max(axis=1)),
        ours=FREE_SPACE if model.multipath is None else TWO_RAYS,
    )


@ways.register
def _(model: RfSensor, targets: Targets, antenna_m: float) -> Ways:
    emissions = Emissions.of(targets)
    ground = model.multipath or _ground(antenna_m)

    def pd_of(snr: Floats) -> Floats:
        missed = np.ones(len(targets))
        detected = np.nan_to_num(model.pd(emissions, snr))
        np.multiply.at(missed, emissions.target, 1 - detected)
        return 1 - missed

    plain = FREE_SPACE if model.path_loss_exponent == 2 else "log-distance"
    return Ways(
        ratios={
            plain: lambda: received_snr(model, emissions, targets, None),
            TWO_RAYS: lambda: received_snr(model, emissions, targets, ground),
        },
        pd_of=pd_of,
        ours=plain if model.multipath is None else TWO_RAYS,
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


def received_snr(
    model: RfSensor, emissions: Emissions, targets: Targets, ground: Multipath | None
) -> Floats:
    """Ratios of emissions of targets, (n,), over a ground if there is one."""
    place_enu_m = targets.position_enu_m[emissions.target]
    snr = model.mean_snr(emissions, enu_to_aer(place_enu_m)[2])
    if ground is None:
        return snr
    return snr * ground.power_factor(place_enu_m, C_M_S / emissions.frequency_hz)


def _ground(antenna_m: float) -> Multipath:
    return Multipath(reflection=REFLECTION, antenna_height_m=max(antenna_m, LOWEST_ANTENNA_M))
