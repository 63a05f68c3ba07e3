"""A folder in which commands are run, in this process, and the items that come of them."""

from __future__ import annotations

import io
import json
import logging
import re
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

from digest_items import Item, of_octets, of_recording, of_text

from plotfeed.feeds.cli.main import main

Change = Callable[[str], str]


@dataclass
class Bench:
    folder: Path
    items: dict[str, Item] = field(default_factory=dict)

    def add(self, name: str, item: Item) -> None:
        if name in self.items:
            raise ValueError(f"{name}: twice")
        self.items[name] = item

    def run(
        self, name: str, *words: str, change: Change | None = None, port: int | None = None
    ) -> str:
        """Run the command; what it prints and its exit code are an item. Returns its output.

        `change` takes out of the output what does not repeat; `port` is one that was free, and
        is another one each time.
        """
        code, printed, complaint = _run(words)
        out = change(printed) if change and printed else printed
        text = f"exit code {code}\n{out}\n-- standard error --\n{complaint}"
        # A recording that is run again has its scene in a folder with a random name.
        text = re.sub(r"/tmp/plotfeed-\w+", "/tmp/plotfeed-X", text)  # noqa: S108
        text = text.replace(f"{self.folder}", "DIR")
        name = f"{name}: {' '.join(words)}"
        if port is not None:
            name, text = (each.replace(f":{port}", ":PORT") for each in (name, text))
        self.add(name, of_text(text))
        return printed

    def octets(self, name: str, file: str) -> None:
        path = self.folder / file
        self.add(f"{name}: {file}", of_octets(path.read_bytes() if path.exists() else b""))

    def recording(self, name: str, file: str) -> dict[str, Item]:
        """Add an item for each topic and stage of a recording, and return them."""
        items = of_recording(self.folder / file)
        for each, item in items.items():
            self.add(f"{name}: {file}: {each}", item)
        return items

    def write(self, file: str, data: bytes) -> None:
        (self.folder / file).write_bytes(data)


def _run(words: tuple[str, ...]) -> tuple[object, str, str]:
    """The exit code, or the error that nobody caught, what was printed, and what was complained."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    log, level = logging.getLogger(), logging.getLogger().level
    code: object = 0
    with (
        patch.object(sys, "argv", ["plotfeed", *words]),
        patch.object(log, "handlers", []),  # where there are any, the command adds none
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        except Exception as error:  # noqa: BLE001 - that too is what a revision does
            code = f"{type(error).__name__}: {error}"
        finally:
            log.setLevel(level)
    printed, complaint = (each.buffer.getvalue().decode() for each in (out, err))
    return code, printed, complaint


def one_count(text: str) -> str:
    """Without the lines of counts that a session prints every 10 s of real time, but the last."""
    *others, last = text.rstrip("\n").split("\n")
    return "\n".join([*(line for line in others if not line.startswith("drones ")), last])


def json_without(*names: str) -> Change:
    """JSON without these keys, wherever they are."""
    return lambda text: json.dumps(_without(json.loads(text), names), indent=1)


def _without(value: Any, names: tuple[str, ...]) -> Any:
    if isinstance(value, dict):
        return {k: _without(v, names) for k, v in value.items() if k not in names}
    return [_without(v, names) for v in value] if isinstance(value, list) else value
