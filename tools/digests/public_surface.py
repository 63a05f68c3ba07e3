"""What the project promises to others, a line each: what they type, write, receive and import.

    python tools/digests/public_surface.py record    # writes public_surface.txt, beside this
    python tools/digests/public_surface.py compare   # what is gone from it, and what is new

Commands and their options, keys of scenes with the words that some take, topics, fields of our
messages, and the names that Python has, with their arguments.
"""

from __future__ import annotations

import inspect
import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

import plotfeed
from plotfeed import testing
from plotfeed.feeds.cli.main import cli
from plotfeed.feeds.schema import text_of
from plotfeed.proto import ledger_pb2, plotfeed_pb2

RECORD = Path(__file__).with_name("public_surface.txt")


def surface() -> list[str]:
    """Every line, sorted; its first word says what it is of."""
    lines = [*_commands(cli, ""), *_keys(), *_channels(), *_fields(), *_names()]
    return sorted({*lines})


def counts(lines: list[str]) -> Counter[str]:
    """How many there are of each kind: command, option, key, word, channel, field, name."""
    return Counter(line.split(" ", 1)[0] for line in lines)


def _commands(command: click.Command, name: str) -> Iterator[str]:
    for each in command.params:
        if isinstance(each, click.Option):
            yield f"option {name} {each.opts[0]}".replace("  ", " ")
    if isinstance(command, click.Group):
        for word, below in command.commands.items():
            path = f"{name} {word}".strip()
            yield f"command {path}"
            yield from _commands(below, path)


def _keys() -> Iterator[str]:
    schema = json.loads(text_of("scene"))
    for name, table in {"Scene": schema, **schema["$defs"]}.items():
        for key, value in table.get("properties", {}).items():
            yield f"key {name}.{key}"
            for word in _words(value):
                yield f"word {name}.{key} {word}"


def _words(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        yield from (str(word) for word in value.get("enum", []))
        for below in ("anyOf", "items"):
            yield from _words(value.get(below))
    elif isinstance(value, list):
        for each in value:
            yield from _words(each)


def _channels() -> Iterator[str]:
    for channel in json.loads(text_of("asyncapi"))["channels"].values():
        yield f"channel {channel['address']}"


def _fields() -> Iterator[str]:
    for file in (plotfeed_pb2, ledger_pb2):
        for message in file.DESCRIPTOR.message_types_by_name.values():
            for field in message.fields:
                yield f"field {message.name}.{field.name} {field.number}"


def _names() -> Iterator[str]:
    for name in plotfeed.__all__:
        value = getattr(plotfeed, name)
        yield f"name {name}{inspect.signature(value) if inspect.isfunction(value) else ''}"
    for name in testing.__all__:
        value = getattr(testing, name)
        yield f"name testing.{name}{inspect.signature(value) if inspect.isfunction(value) else ''}"
    for name, value in vars(plotfeed.Observer).items():
        if inspect.isfunction(value) and not name.startswith("_"):
            yield f"name Observer.{name}{inspect.signature(value)}"


def main() -> int:
    now = surface()
    if sys.argv[1:] == ["record"]:
        RECORD.write_text("\n".join(now) + "\n")
    elif sys.argv[1:] != ["compare"]:
        print(__doc__)
        return 2
    then = RECORD.read_text().splitlines()
    for sign, lines in (("gone:", {*then} - {*now}), ("new:", {*now} - {*then})):
        for line in sorted(lines):
            print(sign, line)
    print(", ".join(f"{n} {kind}s" for kind, n in sorted(counts(now).items())))
    return int(then != now)


if __name__ == "__main__":
    sys.exit(main())
