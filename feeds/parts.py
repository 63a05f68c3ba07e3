"""What the parts of a scene are made of: strict, frozen, and with the unit in every name."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator


class Part(BaseModel):
    """A table of the scene file."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


def _name(value: str) -> str:
    if not value.isprintable() or any(c in value for c in "/+# ") or not 1 <= len(value) <= 64:
        raise ValueError("a name is 1 to 64 printable characters, without space, '/', '+' or '#'")
    return value


Name = Annotated[str, AfterValidator(_name)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-180, le=180)]
Height = Annotated[float, Field(ge=-1000, le=100_000)]
Azimuth = Annotated[float, Field(ge=-360, le=360)]
Elevation = Annotated[float, Field(ge=-90, le=90)]
Beamwidth = Annotated[float, Field(gt=0, le=360)]
Frequency = Annotated[float, Field(ge=1, le=1e12)]
Probability = Annotated[float, Field(ge=1e-15, le=0.1)]
"""Of a false alarm."""
Enu = Annotated[tuple[float, float, float], Field(strict=False)]


class Site(Part):
    """The point from which positions in the scene are counted."""

    latitude_deg: Latitude
    longitude_deg: Longitude
    height_m: Height
    """Above the WGS-84 ellipsoid."""


class Place(Part):
    """A place: from the site in metres, or by latitude and longitude."""

    east_m: float | None = None
    north_m: float | None = None
    above_site_m: float | None = None
    """Difference in height above the ellipsoid."""
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    height_m: Height | None = None
    """Above the ellipsoid."""

    @model_validator(mode="after")
    def _one_way_or_the_other(self) -> Place:
        local = (self.east_m, self.north_m, self.above_site_m)
        geodetic = (self.latitude_deg, self.longitude_deg, self.height_m)
        given = [None not in way for way in (local, geodetic)]
        void = [way == (None, None, None) for way in (local, geodetic)]
        if not ((given[0] and void[1]) or (given[1] and void[0])):
            raise ValueError(
                "a place has east_m, north_m and above_site_m, "
                "or latitude_deg, longitude_deg and height_m"
            )
        return self
