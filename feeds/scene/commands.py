"""What may be asked of a running session, as JSON on {prefix}/control: parsed, not yet done."""

from __future__ import annotations

import json
from typing import Any

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.problems import in_a_line, problems_of
from plotfeed.proto.errors import PlotfeedError

MAX_COMMAND_OCTETS = 1 << 16
EXAMPLE = '{"sensor": "radar", "set": {"link": {"latency_ms": 250}}}'


class ControlError(PlotfeedError):
    """A command that cannot be carried out, in a line."""


class ClockCommand(SceneTable):
    """Asked of a simulated clock alone: real time cannot be held."""

    paused: bool | None = None
    speed: float | None = Field(default=None, ge=0.001, le=10_000)
    step_s: float | None = Field(default=None, gt=0, le=3600)


class Command(SceneTable):
    """One message: of one sensor, or of the session's clock."""

    sensor: str | None = None
    set: dict[str, Any] | None = None
    """Keys of the sensor as in the scene; null takes one back to its default."""
    reset: bool = False
    """The sensor is again as its scene says."""
    clock: ClockCommand | None = None

    @model_validator(mode="after")
    def _says_one_thing(self) -> Command:
        if (self.sensor is None) == (self.clock is None):
            raise ValueError("expected either sensor or clock")
        if self.sensor is not None and (self.set is None) != self.reset:
            raise ValueError('with a sensor, expected either "set" or "reset"')
        if self.clock is not None and not self.clock.model_fields_set:
            raise ValueError("clock: expected paused, speed or step_s")
        return self


_COMMAND = TypeAdapter(Command)


def parsed(payload: bytes) -> Command:
    """A command from the wire; raises `ControlError`."""
    if len(payload) > MAX_COMMAND_OCTETS:
        raise ControlError(f"{len(payload)} octets: at most {MAX_COMMAND_OCTETS} are taken")
    try:
        tree = json.loads(payload)
    except (ValueError, RecursionError):
        raise ControlError(f"not JSON: expected such as {EXAMPLE}") from None
    if not isinstance(tree, dict):
        raise ControlError(f"expected an object such as {EXAMPLE}")
    return command_of(tree)


def command_of(tree: dict[str, Any]) -> Command:
    """A command from an object; raises `ControlError`."""
    try:
        return _COMMAND.validate_python(tree)
    except ValidationError as error:
        raise ControlError(in_a_line(problems_of(error, tree))) from None
