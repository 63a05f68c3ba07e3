"""How commands are asked: fields of their settings that are options, told of once."""

from __future__ import annotations

from dataclasses import field
from typing import Any

MAX_SEED = (1 << 63) - 1


def option(default: Any, help_text: str, **how: Any) -> Any:
    """A dataclass field that is an option of a command, of which `help_text` tells.

    The field's type is the option's: bool is a flag, a tuple is given several times, a `Literal` is
    a choice, of a file or folder it is `Path`. `how` are `low`, `over` and `high`, the bounds of a
    number; `metavar`, what stands for its value in help; `name`, if it is not the field's; `path`,
    "existing", "file" or "folder"; `bare`, its value where none is given; `tells_default`.
    """
    return field(default=default, metadata={"help": help_text, **how})
