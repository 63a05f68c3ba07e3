"""What each kind of sensor decides by, and how its errors are distributed: for stages to compare.

A sensor that is not known here has no law, and the stages that need one leave it out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import partial, singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.accuracy_chart import detection_methods as alternatives
from plotfeed.feeds.accuracy_chart import precise
from plotfeed.feeds.accuracy_chart.propagation_methods import received_snr
from plotfeed.models import detection, energy
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.active_radar import ActiveRadar
from plotfeed.models.sensors.mimo_radar import MimoRadar
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.rf import Emissions, RfDirectionFinder
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Bools, Floats

Rng = np.random.Generator
AnyFloats = NDArray[np.floating[Any]]
"""Of whatever precision."""
MOST_SAMPLES = 1 << 21
"""Signals of more samples a look are not drawn sample by sample."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionLaw:
    """Pd of some looks by several methods, (n,) each, ours among them; and of one look exactly.

    `hits` draws what a receiver would decide, signal by signal, in `signals` numbers a look; None
    where there is no signal behind the law.
    """

    ours: Callable[[], Floats]
    others: Mapping[str, Callable[[], AnyFloats]]
    hits: Callable[[Rng], Bools] | None
    signals: int
    exact: Callable[[int], Decimal]


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorLaw:
    """Sigmas of what is measured, by the signal-to-noise ratio of a detection, linear, (n,).

    `draw` gives ratios of detections, None where they do not fluctuate; `inverse` is the mean of
    one over them. `printed` has the paper's own constants.
    """

    mean_snr: Floats
    sigmas: Callable[[Floats], dict[str, Floats]]
    printed: Callable[[Floats], dict[str, Floats]] | None
    draw: Callable[[Rng], Floats] | None
    inverse: Floats


@singledispatch
def detection_law(_model: SensorModel, _targets: Targets) -> DetectionLaw | None:
    """How a sensor decides about targets; None if it is not known."""
    return None


@detection_law.register
def _(model: ActiveRadar, targets: Targets) -> DetectionLaw:
    snr = model.signal_snrs(targets.position_enu_m, targets.rcs_m2())[:, 0]
    return _swerling1(lambda: model.pd(snr[:, None]), snr, model.pfa, model.n_reference)


@detection_law.register
def _(model: PassiveRadar, targets: Targets) -> DetectionLaw:
    snr = _passive_snr(model, targets).max(axis=1)
    return _swerling1(lambda: model.pd(snr), snr, model.pfa, model.n_reference)


@detection_law.register
def _(model: MimoRadar, targets: Targets) -> DetectionLaw:
    snrs = model.signal_snrs(targets.position_enu_m, targets.rcs_m2())
    pfa, n = model.pfa, model.n_reference_total
    singles = snrs.astype(np.float32)
    looked_up = alternatives.table(
        lambda db: detection.pd_noncoherent_cfar(10 ** (db / 10), pfa, snrs.shape[1], n)
    )
    return DetectionLaw(
        ours=lambda: model.pd(snrs),
        others={
            "table by the mean ratio": lambda: looked_up(10 * np.log10(snrs.mean(axis=1))),
            "closed form, float32": lambda: alternatives.single_sum_cfar(singles, pfa, n),
            "as printed, eq 18, 23": lambda: alternatives.printed_sum(snrs, pfa),
        },
        hits=partial(alternatives.signal_cfar, snrs, pfa, n),
        signals=2 * (n + snrs.shape[1]),
        exact=lambda row: precise.pd_sum_cfar(snrs[row].tolist(), pfa, n),
    )


@detection_law.register
def _(model: MicrophoneArray, targets: Targets) -> DetectionLaw:
    snr_db = model.snr_db(targets.sound_power_db(), targets.position_enu_m)
    law = (model.sensitivity_db, model.slope_per_db)
    looked_up = alternatives.table(lambda db: detection.pd_logistic(db, *law))
    singles = snr_db.astype(np.float32)
    return DetectionLaw(
        ours=lambda: model.pd(snr_db),
        others={
            "table": lambda: looked_up(snr_db),
            "closed form, float32": lambda: alternatives.single_logistic(singles, *law),
            "as printed, eq 43": lambda: alternatives.printed_logistic(snr_db, law[0]),
        },
        hits=None,
        signals=0,
        exact=lambda row: precise.pd_logistic(float(snr_db[row]), *law),
    )


@detection_law.register
def _(model: RfDirectionFinder, targets: Targets) -> DetectionLaw:
    emissions, snr = _strongest(model, targets)
    pfa, n = model.pfa, model.samples
    met = model.intercept_probability(emissions.frequency_hz, emissions.bandwidth_hz)
    looked_up = alternatives.table(
        lambda db: detection.pd_noncoherent_swerling2(10 ** (db / 10), pfa, n)
    )
    singles = snr.astype(np.float32)
    return DetectionLaw(
        ours=lambda: model.pd(emissions, snr),
        others={
            "table": lambda: met * looked_up(10 * np.log10(snr)),
            "closed form, float32": lambda: met * alternatives.single_energy(singles, pfa, n),
        },
        hits=_burst_hits(snr, met, pfa, n) if 2 * n <= MOST_SAMPLES else None,
        signals=2 * n,
        exact=lambda row: Decimal(float(met[row])) * precise.pd_energy(float(snr[row]), pfa, n),
    )


@singledispatch
def error_law(_model: SensorModel, _targets: Targets) -> ErrorLaw | None:
    """How the errors of a sensor's plots of targets are distributed; None if it is not known."""
    return None


@error_law.register
def _(model: PolarRadar, targets: Targets) -> ErrorLaw:
    snrs = model.signal_snrs(targets.position_enu_m, targets.rcs_m2())
    names = ("range_m", "azimuth_deg", "elevation_deg")[: 3 if model.measures_elevation else 2]

    def sigmas(snr: Floats) -> dict[str, Floats]:
        return dict(zip(names, model.sigmas(snr), strict=False))

    beams = {
        "azimuth_deg": (model.azimuth_beamwidth_deg, model.azimuth_floor_deg),
        "elevation_deg": (model.elevation_beamwidth_deg, model.elevation_floor_deg),
    }
    return ErrorLaw(
        mean_snr=snrs.mean(axis=1),
        sigmas=sigmas,
        printed=_printed(sigmas, beams),
        draw=lambda rng: model.draw_detected(snrs, rng)[0],
        inverse=model.inverse_detected(snrs),
    )


@error_law.register
def _(model: PassiveRadar, targets: Targets) -> ErrorLaw:
    snrs = _passive_snr(model, targets)
    best = snrs.argmax(axis=1)
    snr, resolution_m = snrs.max(axis=1), model.range_resolution_m[best]

    def sigmas(ratio: Floats) -> dict[str, Floats]:
        found = model.sigmas(ratio, resolution_m)
        return {"bistatic_range_m": found[0], "azimuth_deg": found[1]}

    beams = {"azimuth_deg": (model.azimuth_beamwidth_deg, model.azimuth_floor_deg)}
    case = (snr, model.pfa, model.n_reference)
    return ErrorLaw(
        mean_snr=snr,
        sigmas=sigmas,
        printed=_printed(sigmas, beams),
        draw=lambda rng: detection.draw_detected_snr_swerling1(*case, rng)[0],
        inverse=detection.inverse_detected_snr(*case),
    )


@error_law.register
def _(model: MicrophoneArray, targets: Targets) -> ErrorLaw:
    snr = 10 ** (model.snr_db(targets.sound_power_db(), targets.position_enu_m) / 10)
    beams = {"azimuth_deg": (model.azimuth_beamwidth_deg, model.azimuth_floor_deg)}
    if model.elevation_beamwidth_deg is not None:
        beams["elevation_deg"] = (model.elevation_beamwidth_deg, model.elevation_floor_deg)

    def sigmas(ratio: Floats) -> dict[str, Floats]:
        found = {"azimuth_deg": model.sigma_azimuth_deg(ratio)}
        if model.elevation_beamwidth_deg is not None:
            found["elevation_deg"] = model.sigma_elevation_deg(ratio)
        return found

    return ErrorLaw(
        mean_snr=snr,
        sigmas=sigmas,
        printed=_printed(sigmas, beams),
        draw=None,
        inverse=1 / snr,
    )


@error_law.register
def _(model: RfDirectionFinder, targets: Targets) -> ErrorLaw | None:
    if not model.measures_azimuth:
        return None
    emissions, snr = _strongest(model, targets)

    def draw(rng: Rng) -> Floats:
        detected = energy.draw_detected_energy(snr, model.pfa, model.samples, rng)
        return energy.estimated_snr(detected, model.samples)

    return ErrorLaw(
        mean_snr=snr,
        sigmas=lambda ratio: {
            "azimuth_deg": model.sigma_azimuth_deg(emissions.frequency_hz, ratio)
        },
        printed=None,
        draw=draw,
        inverse=energy.inverse_estimated_snr(snr, model.pfa, model.samples),
    )


def _swerling1(
    ours: Callable[[], Floats], snr: Floats, pfa: float, n_reference: int
) -> DetectionLaw:
    """One look at one fluctuating target, against the mean of its neighbour cells."""
    case = (pfa, n_reference)
    looked_up = alternatives.table(lambda db: detection.pd_cfar_swerling1(10 ** (db / 10), *case))
    singles = snr.astype(np.float32)
    return DetectionLaw(
        ours=ours,
        others={
            "table": lambda: looked_up(10 * np.log10(snr)),
            "closed form, float32": lambda: alternatives.single_cfar_swerling1(singles, *case),
            "as printed, eq 6, 7": lambda: alternatives.printed_cfar_swerling1(snr, *case),
        },
        hits=partial(alternatives.signal_cfar, snr[:, None], *case),
        signals=2 * (n_reference + 1),
        exact=lambda row: precise.pd_cfar_swerling1(float(snr[row]), *case),
    )


def _burst_hits(snr: Floats, met: Floats, pfa: float, n_samples: int) -> Callable[[Rng], Bools]:
    def hits(rng: Rng) -> Bools:
        return detection.draw_hits(met, rng) & alternatives.signal_energy(snr, pfa, n_samples, rng)

    return hits


def _printed(
    sigmas: Callable[[Floats], dict[str, Floats]], beams: Mapping[str, tuple[float, float]]
) -> Callable[[Floats], dict[str, Floats]]:
    """Equations 14 and 15 as printed, beamwidth over 2 sqrt(S), for angles; range as it is."""

    def found(snr: Floats) -> dict[str, Floats]:
        angles = {
            name: np.hypot(width_deg / (2 * np.sqrt(snr)), floor_deg)
            for name, (width_deg, floor_deg) in beams.items()
        }
        return {name: angles.get(name, sigma) for name, sigma in sigmas(snr).items()}

    return found


def _passive_snr(model: PassiveRadar, targets: Targets) -> Floats:
    """Mean ratios by channel; (n, channels)."""
    return model.mean_snr(model.target_power_w(targets.position_enu_m, targets.rcs_m2()))


def _strongest(model: RfDirectionFinder, targets: Targets) -> tuple[Emissions, Floats]:
    """Of each target the emission with the highest ratio, and that; one row a target."""
    emissions = Emissions.of(targets)
    snr = received_snr(model, emissions, targets, model.multipath)
    order = np.lexsort((-snr, emissions.target))
    _, first = np.unique(emissions.target[order], return_index=True)
    rows = order[first]
    return emissions.rows(rows), snr[rows]
