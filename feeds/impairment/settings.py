"""What a link does to its messages, as a table of the scene: `[sensor.link]`."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.impairment.loss_settings import Chance, Correlation, Loss
from plotfeed.feeds.parts import NotNegative, Part

MAX_DELAYS = 100_000


class Reorder(Part):
    """Messages that leave ahead of others, as netem's reorder with its gap."""

    probability: Chance
    """That a candidate leaves at once, without delay; from 0 to 1."""
    gap: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Every gap-th message since the last that did so is a candidate; 1 is every one."""


class Link(Part):
    """What happens to a sensor's messages on their way. A key that is not given does nothing."""

    latency_ms: NotNegative = 0.0
    """Delay of every message, in milliseconds."""
    jitter_ms: NotNegative = 0.0
    """Unit of the delay's spread in milliseconds: sigma if normal, half the width if uniform."""
    distribution: Literal["normal", "uniform", "pareto", "paretonormal", "table"] = "normal"
    """Shape of the spread, as netem's; one that netem is not told is uniform, not normal."""
    delays_ms: (
        Annotated[tuple[NotNegative, ...], Field(strict=False, min_length=1, max_length=MAX_DELAYS)]
        | None
    ) = None
    """Sample of measured delays in milliseconds, for table alone; latency_ms is added to them."""
    delay_correlation: Correlation = 0.0
    """Between the delays of successive messages, of their normal scores."""
    loss: Loss | None = None
    """Which messages are lost; without it, none."""
    on_loss: Literal["drop", "stall"] = "drop"
    """Stall: what is lost is repeated as TCP would, and all behind it waits; nothing is lost."""
    duplicate: Chance = 0.0
    """Probability that a message comes twice, each with a delay of its own; from 0 to 1."""
    corrupt: Chance = 0.0
    """Probability that one bit of a message's payload is flipped; from 0 to 1."""
    in_order: bool = False
    """Whether no message overtakes another: a later one waits, which raises the mean delay."""
    reorder: Reorder | None = None
    """Messages that overtake on purpose; not with in_order, nor with stall."""
    rate_kbit_s: Annotated[float, Field(ge=0.001, le=1e9)] | None = None
    """Thousands of bits that pass in a second; without it, any number."""
    overhead_octets: Annotated[int, Field(ge=0, le=65_535)] = 0
    """Added to each message where rate_kbit_s counts, for headers."""
    queue_messages: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    """Messages that wait for rate_kbit_s or are being sent by it; one more is dropped."""
    down: bool = False
    """An outage: nothing passes."""

    @model_validator(mode="after")
    def _has_one_law_of_delay(self) -> Self:
        if self.distribution == "table":
            if self.delays_ms is None:
                raise ValueError('delays_ms: needed with distribution = "table"')
            if self.jitter_ms:
                raise ValueError('jitter_ms: contradicts distribution = "table"')
        elif self.delays_ms is not None:
            raise ValueError('delays_ms: needs distribution = "table"')
        return self

    @model_validator(mode="after")
    def _orders_or_reorders(self) -> Self:
        if self.reorder is not None and self.in_order:
            raise ValueError("reorder: contradicts in_order")
        if self.reorder is not None and self.on_loss == "stall":
            raise ValueError('reorder: contradicts on_loss = "stall", which keeps the order')
        return self

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
