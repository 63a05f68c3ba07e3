"""Sensors of a kind in one model: what differs between them is a column, the rest a number.

A model of one sensor has numbers. One of many, made by `stacked`, is of the same class and has
columns, a value a sensor, and `rows` makes of it the model of as many looks, a value a look. Such
columns are gathered when an equation asks for them. All that follows from a sensor alone, a
`sensor_property`, is worked out sensor by sensor, once: no bit of it depends on the company.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Floats, Ints

M = TypeVar("M", bound="Stackable")
EVERY_ROW = slice(None)


if TYPE_CHECKING:
    sensor_property = cached_property
else:

    class sensor_property(cached_property):  # noqa: N801 - a decorator, as its base is
        """What follows from the fields of a sensor alone; of many, gathered as the fields are.

        An array of a sensor, (...) or (..., 1), is (..., n) of n rows that differ in it.
        """

        def __get__(self, model: Any, owner: type[Any] | None = None) -> Any:
            """The value; of a model of rows, that of each."""
            stack = None if model is None else vars(model).get("_stack")
            if stack is None:
                return super().__get__(model, owner)
            name = self.attrname
            return vars(model).setdefault(name, stack.gathered(name, vars(model)["_at"]))


@dataclass(frozen=True, slots=True, eq=False)
class _Column:
    """Values that differ, the sensors on the last axis."""

    values: NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """The fields of dataclasses that differ in some."""

    kind: type[Any]
    parts: dict[str, Any]


class Stackable:
    """A dataclass of what the equations of a sensor need, which `stacked` can make of many.

    Fields of its dataclasses and tuples count as its own.
    """

    alike: ClassVar[frozenset[str] | None] = None
    """Fields in which sensors that share a pass must be equal, though they are numbers or effects.
    None, of a kind that knows nothing of columns: all of them."""

    def rows(self, which: NDArray[Any] | slice) -> Self:
        """The model of those rows, by a mask, indices or a slice; itself if it is of one sensor."""
        held = vars(self)
        stack: _Stack | None = held.get("_stack")
        if stack is None or (isinstance(which, slice) and which == EVERY_ROW):
            return self
        made: Self = stack.of(held["_at"][which])
        return made

    def of_channel(self, name: str, channel: Ints) -> Floats:
        """A column (channels, ...) by the channel of each row; (n, ...)."""
        held = vars(self)
        stack: _Stack | None = held.get("_stack")
        value = getattr(self, name) if stack is None else stack.whole(name)
        if not isinstance(value, _Column):
            return np.asarray(value[channel])
        at, values = held["_at"], value.values
        return np.asarray(values[channel, at] if values.ndim == 2 else values[channel, :, at])

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """A field that is a column: it is gathered when it is asked for."""
            stack = vars(self).get("_stack")
            if stack is None or name not in stack.columns:
                raise AttributeError(f"{type(self).__name__} has no {name!r}")
            return vars(self).setdefault(name, stack.gathered(name, vars(self)["_at"]))


class _Stack:
    """Several sensors: what they have alike, and columns of the rest."""

    def __init__(self, models: Sequence[Stackable], plain: dict[str, Any]) -> None:
        self._models = models
        self.plain = plain
        self.columns: dict[str, Any] = {}
        self.defaulted: list[str] = []
        """Fields that are columns and would be found on the class, by their defaults, unasked."""

    def of(self, at: Ints) -> Any:
        """The model of the sensors at those indices."""
        kind: Any = type(self._models[0])
        made = object.__new__(kind)
        vars(made).update(self.plain, _stack=self, _at=at)
        for name in self.defaulted:
            vars(made)[name] = self.gathered(name, at)
        return made

    def whole(self, name: str) -> Any:
        """The values of all sensors, columns where they differ."""
        if name in self.plain:
            return self.plain[name]
        if name not in self.columns:
            value = _side_by_side([getattr(model, name) for model in self._models])
            (self.columns if _differs(value) else self.plain)[name] = value
            return value
        return self.columns[name]

    def gathered(self, name: str, at: Ints) -> Any:
        """The values of the sensors at those indices."""
        return _gathered(self.whole(name), at)


def grouping_key(model: Stackable) -> Hashable:
    """What is the same of all sensors that can share a pass: their class, and what is no number."""
    alike = type(model).alike
    if not is_dataclass(model):
        return type(model), id(model)
    held = {f.name: getattr(model, f.name) for f in fields(model)}
    key = (
        type(model),
        *(
            (name, value if alike is None or name in alike else _form(value))
            for name, value in held.items()
        ),
    )
    try:
        hash(key)
    except TypeError:  # of a kind from outside that holds lists or arrays
        return type(model), id(model)
    return key


def stacked(models: Sequence[M]) -> M:
    """One model of sensors of one `grouping_key`, in their order; at least one.

    Its `rows(sensor_of_row)` observes targets of all of them. Where all are equal it is the first.
    """
    first = models[0]
    if not is_dataclass(first) or all(model is first or model == first for model in models):
        return first
    plain: dict[str, Any] = {}
    stack = _Stack(models, plain)
    for field in fields(first):
        stack.whole(field.name)
        if field.name in stack.columns and hasattr(type(first), field.name):
            stack.defaulted.append(field.name)
    made: M = stack.of(np.arange(len(models)))
    return made


def _form(value: object) -> Hashable:
    """What of a value must be equal: nothing of a number."""
    if isinstance(value, float):
        return float
    if isinstance(value, tuple):
        return tuple(_form(part) for part in value)
    if is_dataclass(value):
        return type(value), *(_form(getattr(value, f.name)) for f in fields(value))
    return value


def _side_by_side(values: Sequence[Any]) -> Any:
    """One value of several of one form, with columns in it where they differ."""
    first = values[0]
    if isinstance(first, np.ndarray):
        if all(value is first or np.array_equal(value, first) for value in values):
            return first
        together = np.concatenate if first.ndim > 1 and first.shape[-1] == 1 else np.stack
        return _Column(together(values, axis=-1))
    if isinstance(first, tuple):
        parts = tuple(_side_by_side(parts) for parts in zip(*values, strict=True))
        return parts if any(_differs(part) for part in parts) else first
    if all(value is first or value == first for value in values):
        return first
    if is_dataclass(first):
        names = [f.name for f in fields(first)]
        return _Parts(
            type(first), {n: _side_by_side([getattr(v, n) for v in values]) for n in names}
        )
    return _Column(np.array(values, np.float64))


def _gathered(value: Any, at: Ints) -> Any:
    if isinstance(value, _Column):
        return value.values.take(at, axis=-1)
    if isinstance(value, tuple):
        return tuple(_gathered(part, at) for part in value)
    if isinstance(value, _Parts):
        return value.kind(**{name: _gathered(part, at) for name, part in value.parts.items()})
    return value


def _differs(value: object) -> bool:
    """Whether there is a column in it."""
    if isinstance(value, tuple):
        return any(_differs(part) for part in value)
    return isinstance(value, (_Column, _Parts))
