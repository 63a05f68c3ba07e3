"""Plots: how wrong they are measured, false alarms, and the octets that a tracker reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from plotfeed.feeds.accuracy_chart.case import (
    Case,
    ErrorLaw,
    Rng,
    Sigmas,
    alarm_moments,
    error_law,
    wrapped,
)
from plotfeed.feeds.accuracy_chart.stage import FALSE_ALARMS, MEASURED, ChartStage, Method, rms
from plotfeed.feeds.formats import FORMATS, Batch, Format, MessageFormat
from plotfeed.feeds.formats.sapient.sapient_node import Groups
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.sensing.sensor_site import with_heights
from plotfeed.models.beam import Sector, Sectors, Timetable
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.state import Floats, Plots
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.utc import NS

FLUCTUATING, STEADY = "exact draw, given the hit", "by the level"
FLOOR_ONLY = "floor only"
OUR_ALARMS = "binomial over cells"
SOME_SCAN = 1000
"""It begins a group of sectors, if its number is a multiple of their size."""
STEP_S = 1e-3
"""Over which rates of change are taken."""


def errors_stage(case: Case) -> ChartStage | None:
    """Ratios of detections, sigmas and noise; None for a sensor whose errors are always alike."""
    law = error_law(case.model, case.seen_targets())
    if law is None:
        return None
    true = law.sigmas(1 / law.inverse)
    found: dict[str, tuple[Sigmas, Callable[[Rng], Floats]]] = {}
    if law.draw is not None:
        found[FLUCTUATING] = law.sigmas, law.draw
    found[STEADY if law.draw is None else "by the mean ratio"] = law.sigmas, lambda _: law.mean_snr
    if law.printed is not None:
        found["mean ratio, as printed"] = law.printed, lambda _: law.mean_snr
    strong = np.full(len(law.mean_snr), np.inf)
    found[FLOOR_ONLY] = law.sigmas, lambda _: strong
    return ChartStage.of(
        "errors",
        "How to draw the errors of measurements",
        [
            (
                name,
                partial(_noise, sigmas, ratios, case.rng),
                _missing(sigmas(_effective(name, law, strong)), true),
            )
            for name, (sigmas, ratios) in found.items()
        ],
        units=len(case.seen),
        ours=next(iter(found)),
        need_ratio=found.keys() - {FLOOR_ONLY},
    )


def _effective(name: str, law: ErrorLaw, strong: Floats) -> Floats:
    """The ratio that gives the rms errors of a method, over many detections of each target."""
    if name == FLUCTUATING:
        return 1 / law.inverse  # right in law
    return strong if name == FLOOR_ONLY else law.mean_snr


def _missing(sigmas: Mapping[str, Floats], true: Mapping[str, Floats]) -> dict[str, float]:
    """What, in quadrature, makes the true rms errors of those of a method, or the reverse."""
    return {
        name: float(np.sqrt(np.mean(np.abs(sigmas[name] ** 2 - value**2))))
        for name, value in true.items()
    }


def _noise(sigmas: Sigmas, ratios: Callable[[Rng], Floats], rng: Rng) -> object:
    """The errors of one look at each target, by quantity."""
    return [sigma * rng.standard_normal(len(sigma)) for sigma in sigmas(ratios(rng)).values()]


class PoissonGenerator(np.random.Generator):
    """Draws Poisson numbers where it is asked for binomial ones."""

    def binomial(self, n: Any, p: Any, size: Any = None) -> Any:
        """Poisson, of the same mean."""
        return self.poisson(np.multiply(n, p), size)


def false_alarms_stage(case: Case) -> ChartStage | None:
    """A whole scan's, shared between the targets at once; None for a sensor without any."""
    mean, variance = alarm_moments(case.model)
    if mean == 0 or FALSE_ALARMS not in case.own:
        return None
    excess = float(np.sqrt(mean - variance))  # of the Poisson number over the binomial one
    scan = case.sensor.scan
    turn = replace(Timetable(scan.period_ns, 1).sector(SOME_SCAN, 0), stares=not scan.rotates)
    draw, poisson = case.model.draw_false_alarms, PoissonGenerator(np.random.Philox(case.seed))
    return ChartStage.of(
        "false alarms",
        "How to draw false alarms",
        [
            ("off", lambda: None, {FALSE_ALARMS: mean}),
            ("Poisson", partial(draw, turn, poisson), {FALSE_ALARMS: excess}),
            (OUR_ALARMS, partial(draw, turn, case.rng), {FALSE_ALARMS: 0.0}),
        ],
        units=len(case.seen),
        ours=OUR_ALARMS,
    )


def encoding_stage(case: Case) -> ChartStage | None:
    """Every format that such a sensor can report in, and that is installed."""
    seen = _seen(case)
    sent = seen.plots
    if not len(sent):
        return None
    found = []
    for name in formats_of(case):
        try:
            messages = _messages(FORMATS[name].maker(case.scene, {0: case.sensor}), seen)
        except PlotfeedError:  # an extra is missing, or the sensor measures too little for it
            continue
        read = _read_back(FORMATS[name], messages, int(seen.sectors.start_ns[0]))
        found.append(
            Method(
                name=name,
                run=partial(_messages, FORMATS[name].maker(case.scene, {0: case.sensor}), seen),
                units=len(sent),
                errors=_encoding_errors(case, sent, read),
                ours=name in case.sensor.report,
            )
        )
    return ChartStage(
        name="encoding",
        question="How to write plots down",
        methods=tuple(found),
    )


def formats_of(case: Case) -> list[str]:
    """The formats of plots that the scene could ask of such a sensor."""
    return [name for name in case.sensor.formats if not FORMATS[name].facts.tells_tracks]


def _messages(maker: MessageFormat, batch: Batch) -> list[Message]:
    return [message for messages in maker.messages(batch) for message in messages]


def _read_back(row: Format, messages: Sequence[Message], near_ns: int) -> MeasuredPlots:
    """The plots in all of those messages."""
    if row.plots_in is None:
        return MeasuredPlots.of(())
    return MeasuredPlots.joined([row.plots_in(message.payload, near_ns) for message in messages])


def _seen(case: Case) -> Batch:
    """One detection of each seen target where that is to be had, spread over a few sectors."""
    targets, rng = case.seen_targets(), case.rng
    _, plots = case.model.observe(targets, rng)
    sectors = _group(case)
    start_ns, end_ns = sectors[0].start_ns, sectors[-1].end_ns
    if len(sectors) > 1:
        t_ns = np.sort(rng.integers(start_ns, end_ns, len(plots)))
    else:
        t_ns = np.full(len(plots), end_ns, np.int64)  # a sensor that stares reports when it ends
    plots = with_heights(plots.but(t_utc_ns=t_ns), case.frame)
    index = np.searchsorted([s.end_ns for s in sectors[:-1]], t_ns, side="right")
    plots_by = np.searchsorted(index, np.arange(len(sectors) + 1))
    return Batch(Sectors.of(sectors), plots, plots_by)


def _group(case: Case) -> list[Sector]:
    """The sectors that SAPIENT keeps together, so that its messages leave within them."""
    period_ns, n = case.sensor.scan.period_ns, case.sensor.scan.sectors
    size = Groups(period_ns, n).size
    sectors = [Timetable(period_ns, n).sector(size * SOME_SCAN, 0)]
    while len(sectors) < size:
        sectors.append(Timetable(period_ns, n).next_sector(sectors[-1]))
    return sectors


def _encoding_errors(case: Case, sent: Plots, read: MeasuredPlots) -> dict[str, float]:
    """Errors of what is read, for where the target was at the time that is read beside it."""
    late_s = (read.t_utc_ns - sent.t_utc_ns).astype(np.float64) / NS
    rates = _rates(case, sent)
    errors = {}
    for name in MEASURED:
        if name not in case.own:
            continue
        found = _read(case, name, sent, read)
        if found is not None:
            difference = found - getattr(sent, name) - rates[name] * late_s
            errors[name] = rms(wrapped(name, difference))
    return errors


def _read(case: Case, name: str, sent: Plots, read: MeasuredPlots) -> Floats | None:
    """What is read of a quantity; None if the format has nothing to read it from."""
    found: Floats = getattr(read, name)
    if name == "elevation_deg" and np.isnan(found).all() and not np.isnan(read.altitude_m).all():
        there_enu_m = aer_to_enu(sent.azimuth_deg, sent.elevation_deg, sent.range_m)
        there = case.frame.to_geodetic(there_enu_m)[:2]
        undulation_m = SeaLevel.of(case.scene).undulation_m(*there)
        higher_m = read.altitude_m + undulation_m - sent.height_m
        level_m = sent.range_m * np.cos(np.radians(sent.elevation_deg))
        return np.asarray(sent.elevation_deg + np.degrees(higher_m / level_m))
    return None if np.isnan(found).all() else found


def _rates(case: Case, sent: Plots) -> dict[str, Floats]:
    """How fast what is measured of each plot's target changes, a second."""
    enu_m = case.seen_targets().position_enu_m
    before, after = case.measured(enu_m), case.measured(enu_m + STEP_S * case.velocity_enu_m_s)
    return {
        name: wrapped(name, after[name] - value)[sent.drone] / STEP_S
        for name, value in before.items()
    }
