"""Programs that tests drive beside the package: where they are, or a skip with Debian's package.

By itself it prints the packages of those that are missing, for `.ci/run`; it needs Python alone.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import NoReturn

# By program, which may be needed to install what tests drive.
PACKAGES = {
    "mosquitto": "mosquitto",
    "mosquitto_sub": "mosquitto-clients",
    "tshark": "tshark",
    "editcap": "wireshark-common",
    "chromium": "chromium",
    "cc": "gcc",
    "c++": "g++",
    "node": "nodejs",
    "npm": "npm",
}
# Other names of a program.
ALSO = {"chromium": ("chromium-browser", "google-chrome", "google-chrome-stable")}
VARIABLES = {"chromium": "PLOTFEED_CHROMIUM"}  # What says which it is instead
ROOT = Path(__file__).parents[2]
NODE_MODULES = ROOT / ".node" / "node_modules"  # What `make test` has npm install


def place_of(name: str) -> str | None:
    """Where a program is; root's own, which others may run, are found too."""
    path = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"])
    given = os.environ.get(VARIABLES.get(name, ""))
    names = (given,) if given else (name, *ALSO.get(name, ()))
    return next((each for known in names if (each := shutil.which(known, path=path))), None)


def needed(name: str) -> str:
    """Where a program is; skips the test where it is missing."""
    program = place_of(name)
    if program is None:
        skip(name, name)
    return program


def node_module(name: str) -> Path:
    """A package of npm that `make test` has installed; skips the test where npm was missing."""
    place = NODE_MODULES / name
    if not place.exists():
        skip(f"{name} of npm", "npm")
    return place


def skip(what: str, tool: str) -> NoReturn:
    """Skip the test, for what is missing because the tool is."""
    import pytest

    pytest.skip(f"{what} is not installed: Debian has {tool} in the package {PACKAGES[tool]}")


def missing() -> list[str]:
    """Debian's packages of programs that are not here."""
    return [package for name, package in PACKAGES.items() if place_of(name) is None]


if __name__ == "__main__":
    for package in missing():
        print(package)
