"""The keys of how radars see targets: how echoes fluctuate, and from which side they are strong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from plotfeed.feeds.scene.fields import Azimuth, Decibels, Name, SceneTable
from plotfeed.models.state import DRONE

if TYPE_CHECKING:
    from plotfeed.models.effects.target_echoes import Aspect, TargetEcho, TargetEchoes

Swerling = Annotated[int, Field(ge=0, le=4)]


class LobedAspectKeys(SceneTable):
    """Four lobes, in dB by the cosine of four times the aspect; the mean power is kept."""

    kind: Literal["lobes"]
    """Which shape."""
    depth_db: Annotated[float, Field(ge=0, le=30)]
    """Of the lobes: half of what lies between the strongest and the weakest."""

    def model(self) -> Aspect:
        """Aspect for a model."""
        from plotfeed.models.effects.target_echoes import LobedAspect

        return LobedAspect(self.depth_db)


class TableAspectKeys(SceneTable):
    """Cross-sections as they were measured around a target."""

    kind: Literal["table"]
    """Which shape."""
    angle_deg: Annotated[tuple[Azimuth, ...], Field(strict=False, min_length=2, max_length=10_000)]
    """From the nose clockwise, seen from above, rising and less than a turn."""
    gain_db: Annotated[tuple[Decibels, ...], Field(strict=False, min_length=2, max_length=10_000)]
    """At those, beside the stated rcs_m2; linear in between, all around."""

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        if len(self.angle_deg) != len(self.gain_db):
            raise ValueError("gain_db: as many as angle_deg are needed")
        if (np.diff(self.angle_deg) <= 0).any() or self.angle_deg[-1] - self.angle_deg[0] >= 360:
            raise ValueError("angle_deg: must rise, by less than 360 in all")
        return self

    def model(self) -> Aspect:
        """Aspect for a model."""
        from plotfeed.models.effects.target_echoes import AspectTable

        return AspectTable(self.angle_deg, self.gain_db)


class TargetKeys(SceneTable):
    """A [[target]]: how radars see all drones of a class, scripted or from telemetry."""

    target_class: Name = DRONE
    """Of the drones that this is about; those that state none are drone."""
    swerling: Swerling | None = None
    """Fluctuation: 0 none, 1 and 3 from scan to scan, 2 and 4 from look to look; 3 and 4 are of
    one strong part and weak ones. Without it, 1, and 2 for a radar of several transmitters."""
    aspect: Annotated[LobedAspectKeys | TableAspectKeys, Field(discriminator="kind")] | None = None
    """Cross-section by the side that is seen: a drone looks where it flies, and north while it
    hovers. Statistics over all aspects are fluctuation already: swerling 3 goes well with it."""

    def echo(self, swerling: int | None) -> TargetEcho:
        """What is stated of such a drone, by its own case if it has one."""
        from plotfeed.models.effects.target_echoes import TargetEcho

        return TargetEcho(
            swerling=self.swerling if swerling is None else swerling,
            aspect=None if self.aspect is None else self.aspect.model(),
        )


def _of_distinct_classes(targets: tuple[TargetKeys, ...]) -> tuple[TargetKeys, ...]:
    classes = [target.target_class for target in targets]
    for name in classes:
        if classes.count(name) > 1:
            raise ValueError(f"target_class {name!r} is used twice")
    return targets


Targets = Annotated[
    tuple[TargetKeys, ...], Field(strict=False), AfterValidator(_of_distinct_classes)
]


class EchoesByClass:
    """Echoes of drones by their classes, as the [[target]] of a scene state them."""

    def __init__(self, targets: Sequence[TargetKeys]) -> None:
        self._numbers = {keys.target_class: n for n, keys in enumerate(targets)}
        from plotfeed.models.effects.target_echoes import TargetEchoes

        self._echoes = TargetEchoes.of([*(keys.echo(None) for keys in targets), None])

    def of(self, classes: Sequence[str]) -> TargetEchoes:
        """Echoes of drones of those classes, in their order; none of a class that none names."""
        numbers = [self._numbers.get(name, -1) for name in classes]
        return self._echoes.rows(np.array(numbers, np.int64))


def echoes_of(
    targets: Sequence[TargetKeys], target_class: str, swerling: int | None = None
) -> TargetEchoes:
    """The echo of one drone of a class, or of one with a case of its own; of nothing, none."""
    found = [keys.echo(swerling) for keys in targets if keys.target_class == target_class]
    from plotfeed.models.effects.target_echoes import TargetEcho, TargetEchoes

    if not found and swerling is not None:
        found = [TargetEcho(swerling=swerling)]
    return TargetEchoes.of(found[:1] or [None])
