"""What of a recording is not as it was asked: figures that are too improbable to come by chance.

Each figure that can be judged has the probability that it is as far off, or further, by chance. Of
m such figures the least probable one is below a share of 1/m with at most that share's chance
(Bonferroni): so a recording in which all is right is called wrong at a rate that is known.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from plotfeed.feeds.report.error_tally import ErrorFigures
from plotfeed.feeds.report.link_figures import LinkFigures
from plotfeed.feeds.report.plot_tally import AlarmFigures, PdFigures

FALSE_VERDICTS = 1e-3
"""Share of right recordings in which something is called wrong: one in a thousand."""


class Judged(NamedTuple):
    """A figure that can be judged."""

    sensor: str
    link: int
    """Number of the sensor's link, 0 if it is not about a link."""
    quantity: str
    what: str
    """How it is off, with both figures."""
    p: float
    """Probability of this, or of what is further off, by chance."""
    has_chance: bool = True
    """Whether it could come by chance at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Something that is not as it was asked."""

    sensor: str
    link: int
    """Number of the sensor's link, 0 if it is not about a link."""
    quantity: str
    what: str
    p: float
    """0 for what never comes by chance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdicts:
    """What is wrong, of so many figures that were judged."""

    wrong: Sequence[Verdict]
    judged: int
    false_rate: float
    """Share of right recordings in which anything is called wrong."""


def verdicts(figures: Iterable[Judged]) -> Verdicts:
    """Judge all figures of a recording together."""
    judged = [figure for figure in figures if not math.isnan(figure.p)]
    below = FALSE_VERDICTS / max(sum(figure.has_chance for figure in judged), 1)
    wrong = [
        Verdict(sensor=f.sensor, link=f.link, quantity=f.quantity, what=f.what, p=f.p)
        for f in judged
        if f.p < below
    ]
    return Verdicts(wrong=wrong, judged=len(judged), false_rate=FALSE_VERDICTS)


def of_link(link: LinkFigures) -> Iterator[Judged]:
    """Delays as the link drew them, losses, bursts, copies, flipped bits and the order."""

    def judged(quantity: str, what: str, p: float) -> Judged:
        return Judged(link.sensor, link.number, quantity, what, p, 0 < p < 1)

    fit, delivered, asked = link.fit, link.delivered, link.asked
    if asked is not None:
        told = f"mean {delivered.mean_ms:.3f} ms, asked {asked.mean_ms:.3f}"
        yield judged("delay", f"{told}; distance {fit.link_distance:.4f}", fit.link_p_value)
        yield judged("delay", f"{fit.other} messages; {told}", 0.0 if fit.other else 1.0)
    for quantity, share in (
        ("loss", link.loss),
        ("duplicates", link.duplicates),
        ("flipped bits", link.corrupted),
        ("order", link.overtook),
    ):
        told = f"{100 * share.delivered:.2f} %, asked {100 * share.asked:.2f}"
        yield judged(quantity, told, share.p)
    bursts = link.bursts
    told = f"mean {bursts.delivered_mean:.3f}, asked {bursts.asked_mean:.3f}"
    yield judged("bursts of losses", told, bursts.p)


def of_looks(sensor: str, figures: Iterable[PdFigures]) -> Iterator[Judged]:
    """Detection, at some ranges."""
    for at in figures:
        where = f"{at.from_m / 1000:.2f}-{at.to_m / 1000:.2f} km"
        told = f"{at.delivered:.3f} at {where}, asked {at.asked:.3f}"
        yield Judged(sensor, 0, "detection", told, at.p)


def of_errors(sensor: str, figures: Iterable[ErrorFigures]) -> Iterator[Judged]:
    """What was measured: means, spreads, and values that no noise makes."""
    for of in figures:
        mean = f"mean error {of.mean:.4g} {of.unit}, z {of.z_mean:+.1f}"
        yield Judged(sensor, 0, of.quantity, mean, of.p_mean)
        rms = f"rms error over sigma {of.normalised_rms:.3f}, z {of.z_rms:+.1f}"
        yield Judged(sensor, 0, of.quantity, rms, of.p_rms)
        yield of_count(sensor, of.quantity, of.off, f"of {of.plots} plots off by more than noise")


def of_alarms(sensor: str, alarms: AlarmFigures) -> Judged:
    """False alarms."""
    told = f"{alarms.count}, asked {alarms.asked:.1f}"
    return Judged(sensor, 0, "false alarms", told, alarms.p)


def of_count(sensor: str, quantity: str, count: int, what: str) -> Judged:
    """What never is where all is right."""
    return Judged(sensor, 0, quantity, f"{count} {what}", 0.0 if count else 1.0, False)
