"""What the parts of a scene are made of: strict tables, numbers in bounds, places on the Earth."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from functools import cache, lru_cache
from importlib import import_module
from itertools import chain, pairwise
from typing import Annotated, Any, ClassVar, Self, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import Floats

M = TypeVar("M")


class SceneTable(BaseModel):
    """A table of the scene file. What checks it is built when the first such table is checked."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True
    )
    # What keys of a table cannot be together its `_refusals` yields, as "key: why", if it has that
    # method: the first is told. Those of the classes that it derives from come before its own.
    _all_refusals: ClassVar[tuple[Callable[[Any], Iterator[str]], ...]] = ()

    def made(self, kind: type[M], /, **others: Any) -> M:
        """A dataclass of a model, whose fields have the keys and properties of the same names.

        `others` are fields that follow otherwise. A table that is a `ModelTable` is made, too.
        """
        keys = type(self)
        found = {
            field.name: getattr(self, field.name)
            for field in fields(kind)  # type: ignore[arg-type]
            if field.name not in others
            and (field.name in keys.model_fields or hasattr(keys, field.name))
        }
        tables = {name: part for name, part in found.items() if isinstance(part, ModelTable)}
        found |= {name: table.model() for name, table in tables.items()}
        return kind(**found | others)

    @model_validator(mode="after")
    def _can_be(self) -> Self:
        for refusals in self._all_refusals:
            for text in refusals(self):
                raise ValueError(text)
        return self

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        super().__pydantic_init_subclass__(**kwargs)
        own = (vars(kind).get("_refusals") for kind in reversed(cls.__mro__))
        cls._all_refusals = tuple(filter(None, own))

    @classmethod
    def meanings(cls) -> dict[str, str]:
        """The meanings of its keys, from the strings beneath them in the source.

        A key without a string is what the classes say that the table derives from.
        """
        found = {"kind": "Which kind it is."}
        for each in reversed(cls.__mro__):
            found |= _strings_beneath(each.__module__).get(each.__name__, {})
        return {name: text for name, text in found.items() if name in cls.model_fields}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler, /
    ) -> JsonSchemaValue:
        """JSON schema of the table, with the meanings of its keys."""
        schema = handler(core_schema)
        table = handler.resolve_ref_schema(schema)
        for name, text in cls.meanings().items():
            table["properties"][name]["description"] = text
        cls._put_right(table)
        return schema

    @classmethod
    def _put_right(cls, schema: dict[str, Any]) -> None:
        """Change the JSON schema of the table where its fields do not say all."""


@cache
def _strings_beneath(module: str) -> dict[str, dict[str, str]]:
    """The strings beneath annotated names of each class of a module, by the class and the name.

    It costs as much as compiling the module, which a session that prints no schema spares.
    """
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (OSError, TypeError, KeyError):  # no source is installed, or none was ever a file
        return {}
    found: dict[str, dict[str, str]] = {}
    for of_class in (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)):
        told = found.setdefault(of_class.name, {})
        for_checkers = (node.body for node in of_class.body if isinstance(node, ast.If))
        for key, below in chain(*map(pairwise, (*for_checkers, of_class.body))):
            match key, below:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    told[name] = inspect.cleandoc(text)
    return found


class ModelTable(SceneTable):
    """A table that a model has as a dataclass of its own, whatever the sensor."""

    makes: ClassVar[str]
    """The dataclass, as "module:name" in `models`: it is loaded where it is made."""

    def model(self) -> Any:
        """The dataclass for a model."""
        module, _, name = self.makes.partition(":")
        return self.made(getattr(import_module(f"plotfeed.models.{module}"), name))


def _name(value: str) -> str:
    if not value.isprintable() or any(c in value for c in "/+# ") or not 1 <= len(value) <= 64:
        raise ValueError("a name is 1 to 64 printable characters, without space, '/', '+' or '#'")
    return value


def parsed_by(parse: Callable[[str], object]) -> AfterValidator:
    """Checks text that can be parsed so, and that stays as it is written."""

    def checked(text: str) -> str:
        parse(text)
        return text

    return AfterValidator(checked)


Name = Annotated[str, AfterValidator(_name)]
# Every number has bounds, so that no power or product of them leaves float64 or int64.
Positive = Annotated[float, Field(gt=0, le=1e9)]
NotNegative = Annotated[float, Field(ge=0, le=1e9)]
Offset = Annotated[float, Field(ge=-1e6, le=1e6)]  # From the site, in metres
Decibels = Annotated[float, Field(ge=-300, le=300)]
Loss = Annotated[float, Field(ge=0, le=300)]  # In decibels
Speed = Annotated[float, Field(ge=0.01, le=1000)]
Resolution = Annotated[float, Field(ge=0.01, le=1e6)]  # In metres
Size = Annotated[float, Field(ge=0.01, le=1000)]  # Across, in metres
Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-180, le=180)]
Height = Annotated[float, Field(ge=-1000, le=100_000)]
Azimuth = Annotated[float, Field(ge=-360, le=360)]
Elevation = Annotated[float, Field(ge=-90, le=90)]
Beamwidth = Annotated[float, Field(ge=0.01, le=360)]
Frequency = Annotated[float, Field(ge=1, le=1e12)]
Probability = Annotated[float, Field(ge=1e-15, le=0.1)]  # Of a false alarm
Enu = Annotated[tuple[Offset, Offset, Offset], Field(strict=False)]


def address_parts(text: str) -> tuple[str, int, bool]:
    """Host and port, 0 for none, of HOST:PORT, and whether the host stood in brackets."""
    host, _, port = text.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    number = int(port) if port.isascii() and port.isdigit() and len(port) <= 5 else 0
    return host[1:-1] if bracketed else host, number if number < 65536 else 0, bracketed


def split_address(text: str) -> tuple[str, int]:
    """Host and port of HOST:PORT or [IPv6]:PORT; raises `ValueError`."""
    name, number, bracketed = address_parts(text)
    plain = name.isprintable() and not set(name) & set(" /@[]") and (bracketed or ":" not in name)
    if not name or not plain or not number:
        raise ValueError(f"expected HOST:PORT such as 127.0.0.1:5000, not {text!r}")
    return name, number


def used_twice(kind: str, ids: Iterable[str]) -> Iterator[str]:
    """Refusals of entries of a list of tables that have the id of an earlier one."""
    known: set[str] = set()
    for n, name in enumerate(ids):
        if name in known:
            yield f"{kind}[{n}].id: the id {name!r} is used twice"
        known.add(name)


class ForAWhile(SceneTable):
    """Something that is there from one time to another."""

    from_s: NotNegative = 0.0
    """When it begins, after the session has."""
    to_s: Positive | None = None
    """When it is over; without it, never."""

    def _refusals(self) -> Iterator[str]:
        if self.to_s is not None and self.to_s <= self.from_s:
            yield "to_s: must be above from_s"


class Site(SceneTable):
    """The point from which positions in the scene are counted."""

    latitude_deg: Latitude
    """WGS-84, north."""
    longitude_deg: Longitude
    """WGS-84, east."""
    height_m: Height
    """Above the WGS-84 ellipsoid; needed, unless height_msl_m is given."""
    height_msl_m: Height | None = None
    """Above mean sea level, in place of height_m."""

    @classmethod
    def _put_right(cls, schema: dict[str, Any]) -> None:
        """Either height is needed."""
        schema["required"].remove("height_m")
        schema["oneOf"] = [{"required": ["height_m"]}, {"required": ["height_msl_m"]}]


class Location(SceneTable):
    """A place: from the site in metres, or by latitude and longitude."""

    east_m: Offset | None = None
    """Of the site."""
    north_m: Offset | None = None
    """Of the site."""
    above_site_m: Offset | None = None
    """Difference in height above the ellipsoid."""
    latitude_deg: Latitude | None = None
    """WGS-84, north."""
    longitude_deg: Longitude | None = None
    """WGS-84, east."""
    height_m: Height | None = None
    """Above the ellipsoid."""
    height_msl_m: Height | None = None
    """Above mean sea level, in place of height_m, in a scene's file."""

    def _refusals(self) -> Iterator[str]:
        local = (self.east_m, self.north_m, self.above_site_m)
        geodetic = (self.latitude_deg, self.longitude_deg, self.height_m)
        given = [None not in way for way in (local, geodetic)]
        void = [way == (None, None, None) for way in (local, geodetic)]
        alone = (given[0] and void[1]) or (given[1] and void[0])
        if not alone or self.height_msl_m is not None:
            yield (
                "a place has east_m, north_m and above_site_m, or latitude_deg, longitude_deg and "
                "height_m or, in a scene's file, height_msl_m"
            )


@lru_cache
def site_frame(site: Site) -> LocalFrame:
    """East, north, up of the site."""
    return LocalFrame(site.latitude_deg, site.longitude_deg, site.height_m)


@lru_cache(maxsize=4096)
def frame_at(site: Site, position_enu_m: Enu) -> LocalFrame:
    """East, north, up of a sensor that stands off the site."""
    return LocalFrame(*(float(x) for x in site_frame(site).to_geodetic(np.array(position_enu_m))))


def geodetic(site: Site, place: Location, offset_enu_m: Enu = (0.0, 0.0, 0.0)) -> Floats:
    """Latitude, longitude and height above the ellipsoid of a place, moved by so much; (3,)."""
    east_m, north_m, up_m = offset_enu_m
    if place.latitude_deg is not None:
        at = np.array([place.latitude_deg, place.longitude_deg, place.height_m])
        frame, height_m = LocalFrame(*at.tolist()), at[2]
        if not (east_m or north_m):
            return np.array([at[0], at[1], height_m + up_m])
    else:
        frame, height_m = site_frame(site), site.height_m + (place.above_site_m or 0.0)
        east_m, north_m = east_m + (place.east_m or 0.0), north_m + (place.north_m or 0.0)
    latitude_deg, longitude_deg, _ = frame.to_geodetic(
        np.array([east_m, north_m, 0.0], dtype=np.float64)
    )
    return np.array([latitude_deg, longitude_deg, height_m + up_m])


def enu_from(frame: LocalFrame, site: Site, place: Location) -> Floats:
    """A place seen from a frame, metres east, north, up; (3,)."""
    return frame.from_ecef(geodetic_to_ecef(*geodetic(site, place)))
