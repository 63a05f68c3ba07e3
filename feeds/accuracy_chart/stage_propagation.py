"""Propagation: from distances to mean signal-to-noise ratios."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial, singledispatch
from typing import Any

import numpy as np

from plotfeed.feeds.accuracy_chart.case import Case, passive_snrs
from plotfeed.feeds.accuracy_chart.charted_model import PlacesApart
from plotfeed.feeds.accuracy_chart.stage import PD, ChartStage, Method, rms
from plotfeed.models import propagation
from plotfeed.models.effects.multipath import Multipath
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.sensors.acoustic import REFERENCE_DISTANCE_M, MicrophoneArray
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.rf import RfDirectionFinder
from plotfeed.models.sensors.rf_receiver import emissions_of
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Floats

GATE = "range gate"
FREE_SPACE = "free space"
TWO_RAYS = "two rays, flat ground"
REFLECTION = -0.9
"""Of a ground that no scene describes: nearly all, and turned over, as at grazing incidence."""
LOWEST_ANTENNA_M = 1.5
"""Above that ground."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PropagationMethods:
    """Ratios by method, and Pd by them, (n,); `ours` is what the scene asks for."""

    ratios: dict[str, Callable[[], Floats]]
    pds: dict[str, Callable[[], Floats]]
    ours: str


def propagation_stage(case: Case) -> ChartStage | None:
    """The errors are differences in Pd from what the scene asks for: what others would change.

    None for a sensor that asks for no more than a gate.
    """
    antenna_m = case.sensor.position_enu_m[2]
    timed = propagation_methods(case.model, case.seen_targets(), antenna_m)
    judged = propagation_methods(case.model, case.anywhere_targets(), antenna_m)
    if timed is None or judged is None:
        return None
    share = case.model.pd_factor
    true = judged.pds[judged.ours]() * share
    places_m = case.seen_targets().position_enu_m
    gate = Method(
        name=GATE,
        run=partial(_within, places_m, case.sensor.range_max_m),
        units=len(case.seen),
        errors={PD: rms(1 - true)},
        gives_ratio=False,
    )
    others = [
        Method(
            name=name,
            run=run,
            units=len(case.seen),
            errors={PD: rms(judged.pds[name]() * share - true)},
            ours=name == timed.ours,
        )
        for name, run in timed.ratios.items()
    ]
    return ChartStage(
        name="propagation", question="How strong a signal arrives", methods=(gate, *others)
    )


def _within(places_m: Floats, range_max_m: float) -> object:
    """Whoever is near enough."""
    return np.einsum("ij,ij->i", places_m, places_m) <= range_max_m**2


@singledispatch
def propagation_methods(
    model: SensorModel, targets: Targets, antenna_m: float
) -> PropagationMethods | None:
    """Methods for a sensor whose antenna is so high above the site.

    One that is known by no more than what it predicts has them if its model knows of a ground.
    """
    if not hasattr(model, "multipath"):
        return None
    return _over_ground(
        model,
        antenna_m,
        lambda sensor: sensor.predict(targets).snr,
        lambda sensor: replace(sensor, degradation=None).predict(targets).pd,
    )


@propagation_methods.register
def _(model: PolarRadar, targets: Targets, antenna_m: float) -> PropagationMethods:
    return _over_ground(
        model,
        antenna_m,
        lambda sensor: sensor.look_snrs(targets),
        lambda sensor: sensor.pd(sensor.look_snrs(targets), sensor.orders(targets)),
    )


@propagation_methods.register
def _(model: PassiveRadar, targets: Targets, antenna_m: float) -> PropagationMethods:
    return _over_ground(
        model,
        antenna_m,
        lambda sensor: passive_snrs(sensor, targets),
        lambda sensor: sensor.pd(passive_snrs(sensor, targets).max(axis=1), sensor.orders(targets)),
    )


@propagation_methods.register
def _(model: RfDirectionFinder, targets: Targets, antenna_m: float) -> PropagationMethods:
    emissions = emissions_of(targets)

    def ratios(sensor: RfDirectionFinder) -> Floats:
        return sensor.received_snr(emissions, targets, enu_to_aer(targets.position_enu_m)[2])

    def pd(sensor: RfDirectionFinder) -> Floats:
        missed = np.ones(len(targets))
        detected = np.nan_to_num(sensor.pd(emissions, ratios(sensor)))
        np.multiply.at(missed, emissions.target, 1 - detected)
        return 1 - missed

    plain = FREE_SPACE if model.path_loss_exponent == 2 else "log-distance"
    return _over_ground(model, antenna_m, ratios, pd, plain)


@propagation_methods.register
def _(model: MicrophoneArray, targets: Targets, _antenna_m: float) -> PropagationMethods:
    place_enu_m, power_level_db = targets.position_enu_m, targets.sound_power_db()

    def in_the_open() -> Floats:
        range_m = np.maximum(enu_to_aer(place_enu_m)[2], REFERENCE_DISTANCE_M)
        lost_db = propagation.sound_divergence_db(range_m) + model.absorption_db_per_m * range_m
        level_db = propagation.sound_level_db(power_level_db, model.directivity_db, lost_db)
        return level_db + model.array_gain_db - model.noise_db

    def all_in_all() -> Floats:
        return model.snr_db(power_level_db, place_enu_m)

    ours = "air, ground and barriers"
    ratios = {"spreading and air": in_the_open, ours: all_in_all}
    pds = {
        "spreading and air": lambda: model.pd(in_the_open()),
        ours: lambda: model.pd(all_in_all()),
    }
    return PropagationMethods(ratios=ratios, pds=pds, ours=ours)


@propagation_methods.register
def _(model: PlacesApart, targets: Targets, antenna_m: float) -> PropagationMethods:
    place_m, rcs_m2 = targets.true_position_enu_m, targets.rcs_m2()
    return _over_ground(
        model,
        antenna_m,
        lambda radar: radar.odds(place_m, rcs_m2)[0],
        lambda radar: radar.place_pd(radar.odds(place_m, rcs_m2)[1]),
    )


def _over_ground(
    model: Any,
    antenna_m: float,
    ratios: Callable[[Any], Floats],
    pd: Callable[[Any], Floats],
    plain: str = FREE_SPACE,
) -> PropagationMethods:
    """Methods without a ground and over one, that of the scene if it names one."""
    high_m = max(antenna_m, LOWEST_ANTENNA_M)
    ground = model.multipath or Multipath(reflection=REFLECTION, antenna_height_m=high_m)
    sensors = {plain: _over(model, None), TWO_RAYS: _over(model, ground)}
    return PropagationMethods(
        ratios={name: partial(ratios, sensor) for name, sensor in sensors.items()},
        pds={name: partial(pd, sensor) for name, sensor in sensors.items()},
        ours=plain if model.multipath is None else TWO_RAYS,
    )


def _over(model: Any, ground: Multipath | None) -> Any:
    """A sensor over that ground, all of its receivers too."""
    if isinstance(model, PlacesApart):
        return model.over(ground)
    return replace(model, multipath=ground)
