"""Ways from transmitter to receiver that a scene did not ask for: for stages to compare."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import singledispatch

from plotfeed.models.constants import C_M_S
from plotfeed.models.effects.multipath import Multipath
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.rf import Emissions, RfDirectionFinder
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Floats

FREE_SPACE = "free space"


TWO_RAYS = "two rays, flat ground"


REFLECTION = -0.9
"""Of a ground that no scene describes: nearly all, and turned over, as at grazing incidence."""


LOWEST_ANTENNA_M = 1.5
"""Above it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PropagationMethods:
    """Ratios by way, and the Pd that they lead to, (n,); `ours` names what the scene asks for."""

    ratios: dict[str, Callable[[], Floats]]
    pd_of: Callable[[Floats], Floats]
    ours: str


@singledispatch
def ways(_model: SensorModel, _targets: Targets, _antenna_m: float) -> PropagationMethods | None:
    """Of a sensor whose antenna is so high above the site; None if it has no propagation."""
    return None


@ways.register
def _(model: PolarRadar, targets: Targets, antenna_m: float) -> PropagationMethods:
    place_enu_m, rcs_m2 = targets.position_enu_m, targets.rcs_m2()
    free = replace(model, multipath=None)
    grounded = replace(model, multipath=model.multipath or _ground(antenna_m))
    return PropagationMethods(
        ratios={
            FREE_SPACE: lambda: free.signal_snrs(place_enu_m, rcs_m2),
            TWO_RAYS: lambda: grounded.signal_snrs(place_enu_m, rcs_m2),
        },
        pd_of=model.pd,
        ours=FREE_SPACE if model.multipath is None else TWO_RAYS,
    )


def received_snr(
    model: RfDirectionFinder, emissions: Emissions, targets: Targets, ground: Multipath | None
) -> Floats:
    """Ratios of emissions of targets, (n,), over a ground if there is one."""
    place_enu_m = targets.position_enu_m[emissions.target]
    snr = model.mean_snr(emissions, enu_to_aer(place_enu_m)[2])
    if ground is None:
        return snr
    return snr * ground.power_factor(place_enu_m, C_M_S / emissions.frequency_hz)


def _ground(antenna_m: float) -> Multipath:
    return Multipath(reflection=REFLECTION, antenna_height_m=max(antenna_m, LOWEST_ANTENNA_M))
