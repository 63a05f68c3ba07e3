"""A folder in which the command is run, and the items that come of it."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from digest_items import Item, of_octets, of_recording, of_text

PATIENCE_S = 120.0

Change = Callable[[str], str]


@dataclass
class Bench:
    plotfeed: Path
    folder: Path
    items: dict[str, Item] = field(default_factory=dict)

    def add(self, name: str, item: Item) -> None:
        if name in self.items:
            raise ValueError(f"{name}: twice")
        self.items[name] = item

    def run(
        self, name: str, *arguments: str, change: Change | None = None, port: int | None = None
    ) -> str:
        """Run the command; what it prints and its exit code are an item. Returns its output.

        `change` takes out of the output what does not repeat; `port` is one that was free, and
        is another one each time.
        """
        done = subprocess.run(
            [str(self.plotfeed), *arguments],
            cwd=self.folder,
            env=_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        out = done.stdout if change is None or done.returncode else change(done.stdout)
        text = f"exit code {done.returncode}\n{out}\n-- standard error --\n{done.stderr}"
        # A recording that is run again has its scene in a folder with a random name.
        text = re.sub(r"/tmp/plotfeed-\w+", "/tmp/plotfeed-X", text)  # noqa: S108
        text = text.replace(f"{self.folder}", "DIR")
        name = f"{name}: {' '.join(arguments)}"
        if port is not None:
            name, text = (each.replace(f":{port}", ":PORT") for each in (name, text))
        self.add(name, of_text(text))
        return done.stdout

    def octets(self, name: str, file: str) -> None:
        path = self.folder / file
        self.add(f"{name}: {file}", of_octets(path.read_bytes() if path.exists() else b""))

    def recording(self, name: str, file: str, *, marked: bool = True) -> None:
        for each, item in of_recording(self.folder / file, marked=marked).items():
            self.add(f"{name}: {file}: {each}", item)

    def write(self, file: str, data: bytes) -> None:
        (self.folder / file).write_bytes(data)


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


def _environment() -> dict[str, str]:
    """Ours, but for what would change what is printed."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PLOTFEED_", "PYTHON"))}
    return kept | {"COLUMNS": "100", "LC_ALL": "C.UTF-8", "TZ": "UTC", "NO_COLOR": "1"}
