"""What a page has its reader do at a terminal, and a terminal that does it.

In blocks of ```console a line of "$ " is a command, the lines after it what it prints. "…" within
a line stands for anything, on a line of its own for any lines. A command whose output ends in
"Ctrl-C" goes on until "^C"; what stands between is typed in another terminal. A block of another
language is a file, if the paragraph before it names one in backticks.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

from support.waiting import PATIENCE_S

BLOCK = re.compile(r"^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE)
NAMED = re.compile(r"`([\w-]+\.[a-z]+)`")
BASH = shutil.which("bash") or "/bin/bash"
GOES_ON = "Ctrl-C"


@dataclass(frozen=True)
class Typed:
    """A command, or "^C", with the lines that it is to print."""

    command: str
    lines: list[str] = field(default_factory=list)

    def matches(self, printed: str) -> bool:
        """Whether it printed that; trailing and empty lines do not count."""
        pattern = "".join(
            r"(?:[^\n]*\n)*?" if line == "…" else re.escape(line).replace("…", ".*?") + r" *\n"
            for line in self.lines
            if line
        )
        text = "".join(f"{line.rstrip()}\n" for line in printed.splitlines() if line.strip())
        return re.fullmatch(pattern, text) is not None


@dataclass(frozen=True)
class Saved:
    """A file that the reader is to save."""

    name: str
    text: str


def steps(page: str) -> list[Typed | Saved]:
    """What a page has its reader do, in its order."""
    found: list[Typed | Saved] = []
    for block in BLOCK.finditer(page):
        if block["language"] != "console":
            paragraph = page[: block.start()].rstrip().rpartition("\n\n")[2]
            if named := NAMED.findall(paragraph):
                found.append(Saved(named[-1], block["text"]))
            continue
        for line in block["text"].splitlines():
            if line.startswith("$ ") or line == "^C":
                found.append(Typed(line.removeprefix("$ ")))
            else:
                last = found[-1]
                assert isinstance(last, Typed)
                last.lines.append(line)
    return found


class Terminal:
    """A reader at bash, in a folder, with an environment."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self.folder = folder
        self.environment = environment
        self._state = Path(environment["HOME"]) / ".state"
        self._going: subprocess.Popen[str] | None = None

    def do(self, step: Typed | Saved) -> None:
        """One step, which must print what the page says."""
        match step:
            case Saved(name, text):
                (self.folder / name).write_text(text)
                return
            case Typed("^C"):
                printed = self._stopped()
            case Typed(command, [*_, last]) if last.endswith(GOES_ON):
                printed = self._begun(command)
            case Typed(command):
                printed = self._ended(command)
        told = "\n".join(step.lines)
        assert step.matches(printed), f"$ {step.command}\n{printed}\n-- and the page has:\n{told}"

    def _ended(self, command: str) -> str:
        """What a command prints until it ends; where it leaves the shell is kept."""
        kept = f'{command}\nended=$?\n{{ pwd; env -0; }} >"{self._state}"\nexit $ended'
        done = subprocess.run(
            [BASH, "-c", kept],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=2 * PATIENCE_S,
            check=False,
        )
        assert done.returncode == 0, f"$ {command}\n{done.stdout}"
        folder, _, variables = self._state.read_text().partition("\n")
        self.folder = Path(folder)
        self.environment = dict(one.split("=", 1) for one in variables.split("\0") if "=" in one)
        return done.stdout

    def _begun(self, command: str) -> str:
        """What a command prints until it says how to stop it; it goes on."""
        self._going = subprocess.Popen(
            [BASH, "-c", f"exec {command}"],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert self._going.stdout is not None
        printed = ""
        while not printed.rstrip().endswith(GOES_ON):
            line = self._going.stdout.readline()
            assert line, f"$ {command}\n{printed}"
            printed += line
        return printed

    def _stopped(self) -> str:
        """What it printed since, and when it was interrupted."""
        assert self._going is not None
        self._going.send_signal(signal.SIGINT)
        printed, _ = self._going.communicate(timeout=PATIENCE_S)
        self._going = None
        return printed

    def close(self) -> None:
        """End what still goes on."""
        if self._going is not None:
            self._going.kill()
            self._going.communicate()


def reader(home: Path, clone: Path) -> Terminal:
    """Somebody who has just cloned, and set up, the project."""
    # What was set up for the tests is good enough for `make demo`, however old it is.
    ready = "--assume-old=.venv/.ready"
    environment = {**os.environ, "HOME": str(home), "MAKEFLAGS": ready}
    return Terminal(clone, environment)
