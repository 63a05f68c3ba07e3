"""The keys of the live page in a scene: what lies under the display, and the tracks to show."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from plotfeed.feeds.parts import Latitude, Longitude, Part

Corner = Annotated[tuple[Latitude, Longitude], Field(strict=False)]


class BasemapImage(Part):
    """A picture of the ground, such as a chart or an aerial photograph, cut out anyhow."""

    image: str
    """PNG, JPEG or WebP; relative to the scene."""
    corners: Annotated[
        tuple[Corner, Corner, Corner, Corner], Field(strict=False, min_length=4, max_length=4)
    ]
    """Latitude and longitude of its top left, top right, bottom right and bottom left corner."""


class PagePart(Part):
    """The [page] of a scene."""

    basemap: Annotated[str | BasemapImage | None, Field(union_mode="smart")] = None
    """A GeoJSON file (RFC 7946), relative to the scene, or an image with its corners."""
    tracks_topic: str | None = None
    """Where the tracker under test publishes its tracks, as ASTERIX 062 or JSON; no wildcards."""
    afterglow_s: Annotated[float, Field(ge=1, le=60)] = 10.0
    """For how long plots fade."""

    @model_validator(mode="after")
    def _topic_is_one(self) -> Self:
        topic = self.tracks_topic
        if topic is not None and (
            not 1 <= len(topic) <= 200 or not topic.isprintable() or any(c in topic for c in "+# ")
        ):
            raise ValueError("tracks_topic: expected one topic, without +, # or space")
        return self
