"""How commands are asked: fields of their settings that are options, told of once."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from dataclasses import field
from typing import Any

from plotfeed.proto.errors import PlotfeedError

MAX_SEED = (1 << 63) - 1


def option(default: Any, help_text: str, **how: Any) -> Any:
    """A dataclass field that is an option of a command, of which `help_text` tells.

    The field's type is the option's: bool is a flag, a tuple is given several times, a `Literal` is
    a choice, of a file or folder it is `Path`. `how` are `low`, `over` and `high`, the bounds of a
    number; `metavar`, what stands for its value in help; `name`, if it is not the field's; `path`,
    "existing", "file" or "folder"; `bare`, its value where none is given; `tells_default`.
    """
    return field(default=default, metadata={"help": help_text, **how})


def start_option() -> Any:
    """The option with which a part of a recording begins."""
    told = "Begin so many seconds after the beginning, or at a time as 2026-01-01T12:00:00Z."
    return option(None, told, metavar="TIME")


def end_option() -> Any:
    """The option before which a part of a recording ends."""
    told = "End before that time, given as for --start; what was recorded at it is left out."
    return option(None, told, metavar="TIME")


def keys_given(option_name: str, pairs: Iterable[str]) -> dict[str, Any]:
    """The keys of KEY=VALUE pairs, as a scene has them; a value that is no TOML is text.

    Raises `PlotfeedError`, which names the option.
    """
    lines = []
    for text in pairs:
        key, equals, value = text.partition("=")
        if not (key and equals and value):
            raise PlotfeedError(f"{option_name} {text}: expected KEY=VALUE")
        try:
            tomllib.loads(f"x = {value}")
        except ValueError:
            value = json.dumps(value, ensure_ascii=False)
        lines.append(f"{key} = {value}")
    try:
        return tomllib.loads("\n".join(lines))
    except ValueError as error:
        raise PlotfeedError(f"{option_name}: {error}") from None
