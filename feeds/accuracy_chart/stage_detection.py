"""Detection: from mean signal-to-noise ratios to which targets are detected."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial, singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from plotfeed.feeds.accuracy_chart import precise
from plotfeed.feeds.accuracy_chart.case import Case, Rng, passive_snrs, strongest_emissions
from plotfeed.feeds.accuracy_chart.charted_model import PlacesApart
from plotfeed.feeds.accuracy_chart.detection_methods import (
    Hits,
    counted,
    printed_cfar_swerling1,
    printed_logistic,
    printed_sum,
    signal_cfar,
    signal_energy,
    single_cfar_swerling1,
    single_energy,
    single_logistic,
    single_sum_cfar,
    table,
)
from plotfeed.feeds.accuracy_chart.stage import PD, ChartStage, Method, rms
from plotfeed.models import detection
from plotfeed.models.detection import draw_hits
from plotfeed.models.joined_sets import OUTSIDE
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.active_radar import ActiveRadar, MimoRadar
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.rf import RfDirectionFinder
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Bools, Floats

OURS = "closed form"
MOST_NUMBERS = 1 << 20
"""That one call of a Monte Carlo may draw."""
MOST_SAMPLES = 1 << 21
"""Signals of more samples a look are not drawn sample by sample."""
AnyFloats = NDArray[np.floating[Any]]
"""Of whatever precision."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionLaw:
    """Pd of some looks by several methods, (n,) each, ours among them; and of one look exactly.

    `hits` draws what a receiver would decide, signal by signal, in `signals` numbers a look; None
    where there is no signal behind the law.
    """

    ours: Callable[[], Floats]
    exact: Callable[[int], Any]
    others: Mapping[str, Callable[[], AnyFloats]] = field(default_factory=dict)
    hits: Hits | None = None
    signals: int = 0


def detection_stage(case: Case) -> ChartStage | None:
    """Pd and a draw by it, or signals and a threshold; None for a sensor that always detects."""
    law = detection_law(case.model, case.seen_targets())
    judged = detection_law(case.model, case.anywhere_targets(case.effort.references))
    if law is None or judged is None:
        return None
    n = min(case.effort.references, len(case.anywhere))
    exact = np.array([float(judged.exact(row)) for row in range(n)])
    found = [_by_pd(OURS, law.ours, _error(judged.ours(), exact), case, ours=True)]
    for name, pd in law.others.items():
        found.append(_by_pd(name, pd, _error(judged.others[name](), exact), case))
    everyone = Method(
        name="every target",
        run=lambda: None,
        units=len(case.seen),
        errors={PD: rms(1 - case.pd_anywhere)},
    )
    return ChartStage(
        name="detection",
        question="How to decide what is detected",
        methods=(*found, *_by_signals(case, judged.signals, exact), everyone),
    )


def _error(pd: AnyFloats, exact: Floats) -> dict[str, float]:
    return {PD: rms(np.asarray(pd, dtype=np.float64) - exact)}


def _by_pd(
    name: str,
    pd: Callable[[], AnyFloats],
    errors: dict[str, float],
    case: Case,
    *,
    ours: bool = False,
) -> Method:
    rng = case.rng
    return Method(
        name=name,
        run=lambda: draw_hits(pd(), rng),
        units=len(case.seen),
        errors=errors,
        ours=ours,
        needs_ratio=True,
    )


def _by_signals(case: Case, signals: int, exact: Floats) -> Iterator[Method]:
    """One trial that decides, right in law; and a Pd counted over many, if there is time for it."""
    hits, few = _hits(case, case.seen_targets, signals)
    if hits is not None:
        yield Method(
            name="signals, one trial",
            run=partial(hits, case.rng),
            units=few,
            errors={PD: 0.0},
            needs_ratio=True,
        )
    trials = case.effort.trials
    hits, few = _hits(case, case.seen_targets, signals * trials)
    judged, rows = _hits(case, case.anywhere_targets, signals * trials // 4)
    if hits is None or judged is None:
        return
    estimated, rng, pd = counted(judged, trials)(case.rng), case.rng, counted(hits, trials)
    yield Method(
        name=f"signals, {trials} trials",
        run=lambda: draw_hits(pd(rng), rng),
        units=few,
        errors=_error(estimated, exact[:rows]),
        needs_ratio=True,
    )


def _hits(case: Case, targets: Callable[[int], Targets], numbers: int) -> tuple[Hits | None, int]:
    """A draw of hits for so few targets that a call lasts no longer than a moment, and how few."""
    few = min(MOST_NUMBERS // max(numbers, 1), case.effort.references)
    some = targets(few)
    law = detection_law(case.model, some) if few else None
    return (law.hits, len(some)) if law is not None else (None, 0)


def detection_law(model: SensorModel, targets: Targets) -> DetectionLaw | None:
    """How a sensor decides; None if it detects all of those targets."""
    if model.degradation is None:
        return _law_of_kind(model, targets)
    share, plain = model.pd_factor, replace(model, degradation=None)
    law = _law_of_kind(plain, targets)
    if law is None:
        law = DetectionLaw(ours=lambda: plain.predict(targets).pd, exact=lambda _: 1.0)
    ours, hits = law.ours, law.hits

    def left_of(pd: Callable[[], AnyFloats]) -> Callable[[], AnyFloats]:
        return lambda: pd() * share

    return DetectionLaw(
        ours=lambda: ours() * share,
        exact=lambda row: law.exact(row) * share,
        others={name: left_of(pd) for name, pd in law.others.items()},
        hits=None if hits is None else lambda rng: hits(rng) & (rng.random(len(targets)) < share),
        signals=law.signals,
    )


@singledispatch
def _law_of_kind(model: SensorModel, targets: Targets) -> DetectionLaw | None:
    """How a kind of sensor decides; of one that is not known here, what it predicts is its law.

    None if it detects all of those targets.
    """
    return _predicted_law(model, targets)


def _predicted_law(model: SensorModel, targets: Targets) -> DetectionLaw | None:
    pd = model.predict(targets).pd
    if (pd == 1).all():
        return None
    return DetectionLaw(ours=lambda: model.predict(targets).pd, exact=lambda row: pd[row])


@_law_of_kind.register
def _(model: ActiveRadar, targets: Targets) -> DetectionLaw | None:
    if targets.signatures.echoes is not None or model.intervals is not None:
        return _predicted_law(model, targets)
    snr = model.look_snrs(targets)[:, 0]
    return _swerling1(lambda: model.pd(snr[:, None]), snr, model.pfa, model.n_reference)


@_law_of_kind.register
def _(model: PassiveRadar, targets: Targets) -> DetectionLaw | None:
    if targets.signatures.echoes is not None:  # by a series of its own
        return _predicted_law(model, targets)
    snr = passive_snrs(model, targets).max(axis=1)
    return _swerling1(lambda: model.pd(snr), snr, model.pfa, model.n_reference)


def _swerling1(
    ours: Callable[[], Floats], snr: Floats, pfa: float, n_reference: int
) -> DetectionLaw:
    """One look at one fluctuating target, against the mean of its neighbour cells."""
    cells = (pfa, n_reference)
    looked_up = table(lambda db: detection.pd_cfar_swerling1(10 ** (db / 10), *cells))
    singles = snr.astype(np.float32)
    return DetectionLaw(
        ours=ours,
        others={
            "table": lambda: looked_up(10 * np.log10(snr)),
            "closed form, float32": lambda: single_cfar_swerling1(singles, *cells),
            "as printed, eq 6, 7": lambda: printed_cfar_swerling1(snr, *cells),
        },
        hits=partial(signal_cfar, snr[:, None], *cells),
        signals=2 * (n_reference + 1),
        exact=lambda row: precise.pd_cfar_swerling1(float(snr[row]), *cells),
    )


@_law_of_kind.register
def _(model: MimoRadar, targets: Targets) -> DetectionLaw | None:
    if targets.signatures.echoes is not None or model.intervals is not None:
        return _predicted_law(model, targets)
    snrs = model.look_snrs(targets)
    pfa, n = model.pfa, model.n_reference_total
    singles = snrs.astype(np.float32)
    looked_up = table(
        lambda db: detection.pd_noncoherent_cfar(10 ** (db / 10), pfa, snrs.shape[1], n)
    )
    return DetectionLaw(
        ours=lambda: model.pd(snrs),
        others={
            "table by the mean ratio": lambda: looked_up(10 * np.log10(snrs.mean(axis=1))),
            "closed form, float32": lambda: single_sum_cfar(singles, pfa, n),
            "as printed, eq 18, 23": lambda: printed_sum(snrs, pfa),
        },
        hits=partial(signal_cfar, snrs, pfa, n),
        signals=2 * (n + snrs.shape[1]),
        exact=lambda row: precise.pd_sum_cfar(snrs[row].tolist(), pfa, n),
    )


@_law_of_kind.register
def _(model: MicrophoneArray, targets: Targets) -> DetectionLaw:
    snr_db = model.snr_db(targets.sound_power_db(), targets.position_enu_m)
    curve = (model.sensitivity_db, model.slope_per_db)
    looked_up = table(lambda db: detection.pd_logistic(db, *curve))
    singles = snr_db.astype(np.float32)
    return DetectionLaw(
        ours=lambda: model.pd(snr_db),
        others={
            "table": lambda: looked_up(snr_db),
            "closed form, float32": lambda: single_logistic(singles, *curve),
            "as printed, eq 43": lambda: printed_logistic(snr_db, curve[0]),
        },
        exact=lambda row: precise.pd_logistic(float(snr_db[row]), *curve),
    )


@_law_of_kind.register
def _(model: RfDirectionFinder, targets: Targets) -> DetectionLaw:
    emissions, snr = strongest_emissions(model, targets)
    pfa, n = model.pfa, model.samples
    met = model.intercept_probability(emissions.frequency_hz, emissions.bandwidth_hz)
    looked_up = table(lambda db: detection.pd_noncoherent_swerling2(10 ** (db / 10), pfa, n))
    singles = snr.astype(np.float32)

    def hits(rng: Rng) -> Bools:
        return draw_hits(met, rng) & signal_energy(snr, pfa, n, rng)

    return DetectionLaw(
        ours=lambda: model.pd(emissions, snr),
        others={
            "table": lambda: met * looked_up(10 * np.log10(snr)),
            "closed form, float32": lambda: met * single_energy(singles, pfa, n),
        },
        hits=hits if 2 * n <= MOST_SAMPLES else None,
        signals=2 * n,
        exact=lambda row: float(met[row]) * precise.pd_energy(float(snr[row]), pfa, n),
    )


@_law_of_kind.register
def _(model: PlacesApart, targets: Targets) -> DetectionLaw:
    place_m, n, fewest = targets.true_position_enu_m, len(targets), model.fewest_pairs
    snrs, _ = model.odds(place_m, targets.rcs_m2())
    signals = [model.receivers[m].signals for m, _ in model.pairs]
    left = np.array([each.pd_factor for each in signals])
    pfa, n_reference = signals[0].pfa, signals[0].n_reference

    def alike() -> Floats:
        pd = detection.pd_cfar_swerling1(snrs.mean(axis=1), pfa, n_reference) * left[0]
        return np.asarray(bdtrc(fewest - 1, len(signals), pd) * (1 - OUTSIDE))

    def hits(rng: Rng) -> Bools:
        found = [
            signal_cfar(snrs[:, [p]], pfa, n_reference, rng) & (rng.random(n) < left[p])
            for p in range(len(signals))
        ]
        return np.asarray((np.sum(found, axis=0) >= fewest) & (rng.random(n) >= OUTSIDE))

    def exact(row: int) -> Any:
        each = [precise.pd_cfar_swerling1(float(snr), pfa, n_reference) for snr in snrs[row]]
        enough = precise.at_least([p * float(f) for p, f in zip(each, left, strict=True)], fewest)
        return enough * (1 - precise.number(OUTSIDE))

    return DetectionLaw(
        ours=lambda: model.place_pd(model.odds_of(snrs)),
        others={"as if pairs were alike": alike},
        hits=hits,
        signals=2 * (n_reference + 1) * len(signals),
        exact=exact,
    )
