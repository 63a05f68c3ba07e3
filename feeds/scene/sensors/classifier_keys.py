"""The keys of a classifier that is sometimes wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import ModelTable, Name
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.models.effects.classification import Confusion

ROUNDING = 1e-6
"""By which a row may miss one."""
Share = Annotated[float, Field(ge=0, le=1)]
Row = Annotated[tuple[Share, ...], Field(strict=False, min_length=1, max_length=64)]


class ClassifierKeys(ModelTable):
    """What the sensor calls what it finds, by a confusion matrix."""

    claims: Annotated[tuple[Name, ...], Field(strict=False, min_length=1, max_length=64)]
    """What it may say; SAPIENT's Registration declares them."""
    confusion: Annotated[dict[str, Row], Field(min_length=1, max_length=64)]
    """By true class, the probability of each claim, in their order; a row adds up to one."""
    otherwise: Row | None = None
    """The same of any other class, and of false alarms; without it, they are called nothing."""
    held_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    """For which a claim of a drone stays as it was drawn, and with it its mistake, in all plots of
    the sensor; 0 for each plot by itself. Drones change theirs at times of their own."""
    codes: dict[str, Annotated[int, Field(ge=1, le=511)]] | None = None
    """By claim, the class in I015/300, which is as receiver and sensor agree; without it, category
    015 says none. What is called nothing has 0."""

    @model_validator(mode="after")
    def _adds_up(self) -> Self:
        if len(set(self.claims)) < len(self.claims):
            raise ValueError("claims: one is there twice")
        rows = {f"confusion.{name}": row for name, row in self.confusion.items()}
        if self.otherwise is not None:
            rows["otherwise"] = self.otherwise
        for name, row in rows.items():
            if len(row) != len(self.claims):
                raise ValueError(f"{name}: {len(row)} numbers for {len(self.claims)} claims")
            if abs(sum(row) - 1) > ROUNDING:
                raise ValueError(f"{name}: must add up to 1, not {sum(row):.7g}")
        if self.codes is not None and set(self.codes) != set(self.claims):
            raise ValueError("codes: one for each claim")
        return self

    def model(self) -> Confusion:
        """The matrix for a model."""
        from plotfeed.models.effects.classification import Confusion

        return self.made(
            Confusion,
            true_classes=tuple(self.confusion),
            rows=tuple(self.confusion.values()),
            held_ns=round(self.held_s * NS),
        )
