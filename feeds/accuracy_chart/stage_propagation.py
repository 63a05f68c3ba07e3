"""Propagation: from distances to mean signal-to-noise ratios."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from plotfeed.feeds.accuracy_chart.case import Case
from plotfeed.feeds.accuracy_chart.propagation_methods import (
    FREE_SPACE,
    TWO_RAYS,
    PropagationMethods,
    _ground,
    received_snr,
    ways,
)
from plotfeed.feeds.accuracy_chart.stage import PD, Alternative, ChartStage, rms
from plotfeed.models import propagation
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.sensors.acoustic import REFERENCE_DISTANCE_M, MicrophoneArray
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.rf import Emissions, RfDirectionFinder
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Floats


@ways.register
def _(model: PassiveRadar, targets: Targets, antenna_m: float) -> PropagationMethods:
    place_enu_m, rcs_m2 = targets.position_enu_m, targets.rcs_m2()
    free = replace(model, multipath=None)
    grounded = replace(model, multipath=model.multipath or _ground(antenna_m))
    return PropagationMethods(
        ratios={
            FREE_SPACE: lambda: free.mean_snr(free.target_power_w(place_enu_m, rcs_m2)),
            TWO_RAYS: lambda: grounded.mean_snr(grounded.target_power_w(place_enu_m, rcs_m2)),
        },
        pd_of=lambda snrs: model.pd(snrs.max(axis=1)),
        ours=FREE_SPACE if model.multipath is None else TWO_RAYS,
    )


@ways.register
def _(model: RfDirectionFinder, targets: Targets, antenna_m: float) -> PropagationMethods:
    emissions = Emissions.of(targets)
    ground = model.multipath or _ground(antenna_m)

    def pd_of(snr: Floats) -> Floats:
        missed = np.ones(len(targets))
        detected = np.nan_to_num(model.pd(emissions, snr))
        np.multiply.at(missed, emissions.target, 1 - detected)
        return 1 - missed

    plain = FREE_SPACE if model.path_loss_exponent == 2 else "log-distance"
    return PropagationMethods(
        ratios={
            plain: lambda: received_snr(model, emissions, targets, None),
            TWO_RAYS: lambda: received_snr(model, emissions, targets, ground),
        },
        pd_of=pd_of,
        ours=plain if model.multipath is None else TWO_RAYS,
    )


@ways.register
def _(model: MicrophoneArray, targets: Targets, _antenna_m: float) -> PropagationMethods:
    place_enu_m, power_level_db = targets.position_enu_m, targets.sound_power_db()

    def in_the_open() -> Floats:
        range_m = np.maximum(enu_to_aer(place_enu_m)[2], REFERENCE_DISTANCE_M)
        lost_db = propagation.sound_divergence_db(range_m) + model.absorption_db_per_m * range_m
        level_db = propagation.sound_level_db(power_level_db, model.directivity_db, lost_db)
        return level_db + model.array_gain_db - model.noise_db

    ours = "air, ground and barriers"
    return PropagationMethods(
        ratios={
            "spreading and air": in_the_open,
            ours: lambda: model.snr_db(power_level_db, place_enu_m),
        },
        pd_of=model.pd,
        ours=ours,
    )


GATE = "range gate"


def propagation_stage(case: Case) -> ChartStage | None:
    """The errors are differences in Pd from what the scene asks for: what another way would change.

    None for a sensor that asks for no more than a gate.
    """
    antenna_m = case.sensor.position_enu_m[2]
    timed = ways(case.model, case.seen_targets(), antenna_m)
    judged = ways(case.model, case.anywhere_targets(), antenna_m)
    if timed is None or judged is None:
        return None
    true = judged.pd_of(judged.ratios[judged.ours]())
    places_m = case.seen_targets().position_enu_m
    gate = Alternative(
        name=GATE,
        run=partial(_within, places_m, case.sensor.range_max_m),
        units=len(case.seen),
        errors={PD: rms(1 - true)},
        gives_ratio=False,
    )
    others = [
        Alternative(
            name=name,
            run=way,
            units=len(case.seen),
            errors={PD: rms(judged.pd_of(judged.ratios[name]()) - true)},
            ours=name == timed.ours,
        )
        for name, way in timed.ratios.items()
    ]
    return ChartStage(
        name="propagation",
        question="How strong a signal arrives",
        alternatives=(gate, *others),
    )


def _within(places_m: Floats, range_max_m: float) -> object:
    """Whoever is near enough."""
    return np.einsum("ij,ij->i", places_m, places_m) <= range_max_m**2
