"""What a link does to its messages, as a table of the scene: `[sensor.link]`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from plotfeed.feeds.scene.fields import SceneTable

Chance = Annotated[float, Field(ge=0, le=1)]  # A probability: 0.05 is 5 percent
Correlation = Annotated[float, Field(gt=-1, lt=1)]

LONGEST_DELAY_MS = 600_000  # Ten minutes: what comes later is an outage, and `down` says so
Delay = Annotated[float, Field(ge=0, le=LONGEST_DELAY_MS)]


class RandomLoss(SceneTable):
    """Each message is lost with one probability, or with the one before it."""

    kind: Literal["random"]
    probability: Chance
    """That a message is lost, from 0 to 1."""
    correlation: Correlation = 0.0
    """Between the losses of successive messages: exactly that, unlike netem's."""

    def _refusals(self) -> Iterator[str]:
        p = self.probability
        least = -min(p, 1 - p) / max(p, 1 - p)  # else a row of two losses has less than no chance
        if self.correlation < least:
            yield f"correlation: with that probability, at least {least:.4g}"


class GilbertElliott(SceneTable):
    """Two states, good and bad; netem's gemodel. By mean loss and mean burst, or by p and r."""

    kind: Literal["gilbert-elliott"]
    mean_loss: Annotated[float, Field(ge=0, lt=1)] | None = None
    """Share of messages that are lost, from 0 to 1; with mean_burst."""
    mean_burst: Annotated[float, Field(ge=1, le=1e6)] | None = None
    """Messages lost in a row, on average; with mean_loss."""
    p: Chance | None = None
    """Probability of going from good to bad, per message; with r."""
    r: Chance | None = None
    """Probability of going from bad to good, per message; with p."""
    good_loss: Chance | None = None
    """Probability of losing a message in the good state, netem's 1-k; with p and r, else 0."""
    bad_loss: Chance | None = None
    """Probability of losing a message in the bad state, netem's 1-h; with p and r, else 1."""

    def _refusals(self) -> Iterator[str]:
        means = (self.mean_loss, self.mean_burst)
        chain = (self.p, self.r, self.good_loss, self.bad_loss)
        if not (
            (None not in means and chain == (None,) * 4)
            or (means == (None, None) and None not in chain[:2])
        ):
            yield (
                "expected mean_loss and mean_burst, or p and r, with good_loss and bad_loss or not"
            )
        if self.mean_loss is not None and self.mean_burst is not None:
            least = self.mean_loss / (1 - self.mean_loss)
            if self.mean_burst < least:  # p = L/(B(1-L)) is a probability
                yield f"mean_burst: with that mean_loss, at least {least:.4g}"
        elif self.p == self.r == 0:
            yield "p: must be above 0 where r is 0, or nothing tells in which state"

    @property
    def probabilities(self) -> tuple[float, float, float, float]:
        """p, r, loss when good, loss when bad."""
        if self.mean_loss is not None and self.mean_burst is not None:
            r = 1 / self.mean_burst
            return min(1.0, r * self.mean_loss / (1 - self.mean_loss)), r, 0.0, 1.0
        good = 0.0 if self.good_loss is None else self.good_loss
        bad = 1.0 if self.bad_loss is None else self.bad_loss
        return self.p or 0.0, self.r or 0.0, good, bad


class FourState(SceneTable):
    """States 1 good, 2 good within a burst, 3 lost within a burst, 4 lost alone; netem's state."""

    kind: Literal["four-state"]
    p13: Chance
    """Probability that a burst begins, per message."""
    p31: Chance | None = None
    """Probability that a lost message is the last of its burst; without it, 1 - p13, as netem."""
    p32: Chance = 0.0
    """Probability that the message after a lost one passes though the burst goes on."""
    p23: Chance = 1.0
    """Probability that losing goes on after a message that passed within a burst."""
    p14: Chance = 0.0
    """Probability of losing a message alone."""

    def _refusals(self) -> Iterator[str]:
        if self.p13 + self.p14 > 1:
            yield "p14: with p13, at most 1"
        if self.ends + self.p32 > 1:
            yield "p32: with p31, at most 1"
        if self.ends == 0:
            yield "p31: must be above 0, or a burst never ends"
        if self.p23 == 0:
            yield "p23: must be above 0, or a burst never ends"

    @property
    def ends(self) -> float:
        """p31, given or not."""
        return 1 - self.p13 if self.p31 is None else self.p31


Loss = Annotated[RandomLoss | GilbertElliott | FourState, Field(discriminator="kind")]


MAX_DELAYS = 100_000


class ReorderSettings(SceneTable):
    """Messages that leave ahead of others, as netem's reorder with its gap."""

    probability: Chance
    """That a candidate leaves at once, without delay; from 0 to 1."""
    gap: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Every gap-th message since the last is a candidate."""


class LinkSettings(SceneTable):
    """What happens to messages on their way; without a key, nothing of it."""

    latency_ms: Delay = 0.0
    """Delay of every message, in milliseconds; at most ten minutes."""
    jitter_ms: Delay = 0.0
    """Spread of the delay in milliseconds: sigma if normal, half the width if uniform."""
    distribution: Literal["normal", "uniform", "pareto", "paretonormal", "table"] = "normal"
    """Shape of the spread, as netem's, which is uniform where it is told none."""
    delays_ms: (
        Annotated[tuple[Delay, ...], Field(strict=False, min_length=1, max_length=MAX_DELAYS)]
        | None
    ) = None
    """Sample of measured delays in milliseconds, for table alone; latency_ms is added to them."""
    delay_correlation: Correlation = 0.0
    """Between the delays of successive messages, of their normal scores."""
    loss: Loss | None = None
    """Which messages are lost; without it, none."""
    on_loss: Literal["drop", "stall"] = "drop"
    """Stall: what is lost is repeated, as by TCP, and all behind it waits."""
    duplicate: Chance = 0.0
    """Probability that a message comes twice, each with its own delay."""
    corrupt: Chance = 0.0
    """Probability that one bit of a message's payload is flipped; from 0 to 1."""
    in_order: bool = False
    """Whether no message overtakes another: a later one waits, which raises the mean delay."""
    reorder: ReorderSettings | None = None
    """Messages that overtake on purpose; not with in_order, nor with stall."""
    rate_kbit_s: Annotated[float, Field(ge=0.001, le=1e9)] | None = None
    """Thousands of bits that pass in a second; without it, any number."""
    overhead_octets: Annotated[int, Field(ge=0, le=65_535)] = 0
    """Added to each message where rate_kbit_s counts, for headers."""
    queue_messages: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    """Messages that wait for rate_kbit_s; one more is dropped."""
    down: bool = False
    """An outage: nothing passes."""

    def _refusals(self) -> Iterator[str]:
        if self.distribution == "table":
            if self.delays_ms is None:
                yield 'delays_ms: needed with distribution = "table"'
            if self.jitter_ms:
                yield 'jitter_ms: contradicts distribution = "table"'
        elif self.delays_ms is not None:
            yield 'delays_ms: needs distribution = "table"'
        if self.reorder is not None and self.in_order:
            yield "reorder: contradicts in_order"
        if self.reorder is not None and self.on_loss == "stall":
            yield 'reorder: contradicts on_loss = "stall", which keeps the order'

    @property
    def keeps_order(self) -> bool:
        """Whether nothing overtakes: asked for, or because TCP never lets it."""
        return self.in_order or self.on_loss == "stall"

    @property
    def is_clear(self) -> bool:
        """Whether every message passes at once, once and as it is."""
        return not (
            self.latency_ms
            or self.jitter_ms
            or self.delays_ms
            or self.loss
            or self.duplicate
            or self.corrupt
            or self.rate_kbit_s
            or self.down
        )
