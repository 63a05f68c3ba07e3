"""Writes the files of versions and hashes beside this one; `make lock` runs it.

A version that a file has stays unless a bound forbids it; `make lock UPGRADE=--upgrade` takes the
newest. Each is for every system and every Python from 3.11 on, but for `lowest.txt`, which has the
lowest versions that pyproject.toml allows the package, and the usual ones of the tests' own tools.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
UV = Path(sys.executable).with_name("uv")
PYPROJECT = "pyproject.toml"
EXTRAS = (*("mavlink", "geoid", "terrain", "charts", "sapient", "metrics", "page", "parquet"),)
BUILD = "setuptools>=77\n"
"""The package is built in the environment itself, with nothing that has no hash."""
SAME = ("--constraint", "requirements/test.txt")


def compiled(name: str, sources: list[str], *options: str, lines: str = "") -> None:
    """One file, from those sources and lines."""
    subprocess.run(  # noqa: S603 - our own command
        [
            *(UV, "pip", "compile", "--quiet", "--generate-hashes", "--no-annotate"),
            *("--python-version", "3.11", "--custom-compile-command", "make lock", *options),
            *("--output-file", f"requirements/{name}.txt", *sources, *(["-"] if lines else [])),
        ],
        input=lines,
        text=True,
        check=True,
        cwd=HERE.parent,
    )


def extras(*names: str) -> list[str]:
    """Options that name them."""
    return [word for name in names for word in ("--extra", name)]


def main() -> None:
    """Writes them all; the later ones hold to what the first has chosen."""
    usual = ("--universal", *sys.argv[1:])
    compiled("test", [PYPROJECT], *extras("test"), *usual, lines=BUILD)
    compiled("run", [PYPROJECT], *extras("page"), *SAME, *usual, lines=BUILD)
    optional = tomllib.loads((HERE.parent / PYPROJECT).read_text())["project"]
    for extra in ("fleet", "fuzz", "test-asterix", "test-page"):
        lines = "\n".join(optional["optional-dependencies"][extra])
        compiled(extra, [], *SAME, *usual, lines=lines)
    for listed in HERE.glob("*.in"):
        compiled(listed.stem, [str(listed)], *usual)
    lowest = ("--resolution", "lowest-direct", "--upgrade")
    compiled("lowest", [PYPROJECT], *extras(*EXTRAS), *lowest)
    held = ("--constraint", "requirements/lowest.txt", "--upgrade")
    compiled("lowest", [PYPROJECT], *extras("test", "broker"), *held, lines=BUILD)


if __name__ == "__main__":
    main()
