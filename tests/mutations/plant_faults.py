"""Plants the faults of `faults.toml`, one after the other, and says which of them no test notices.

`make mutations` does it in an hour, in a copy of the tree; nothing here is changed. Each fault
is a place where a wrong sign, unit, index, key or order would hurt a user, and names the tests that
are asked.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
FAULTS = Path(__file__).with_name("faults.toml")
ROOMS = ("feeds", "models", "proto", "replay")
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
COPIED = (*ROOMS, "tests", "docs", "examples", "Makefile", "mkdocs.yml", "pyproject.toml", *PAGES)
PATIENCE_S = 900


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A change of the code that some test must notice."""

    what: str
    """What a user would have of it."""
    file: str
    old: str
    new: str
    tests: str
    """Arguments of pytest."""


def faults() -> list[Fault]:
    """All of them, as the file has them."""
    with FAULTS.open("rb") as file:
        return [Fault(**fault) for fault in tomllib.load(file)["fault"]]


def planted(fault: Fault, text: str) -> str:
    """The text with the fault in it; raises `ValueError` where its place is not there once."""
    if text.count(fault.old) != 1:
        raise ValueError(f"{fault.file}: expected {fault.old!r} once, not {text.count(fault.old)}")
    return text.replace(fault.old, fault.new)


@contextmanager
def copied() -> Iterator[Path]:
    """A copy of the tree, whose rooms are imported in place of those here."""
    with TemporaryDirectory(prefix="plotfeed-faults-") as folder:
        copy = Path(folder) / "tree"
        copy.mkdir()
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
            elif source.exists():
                shutil.copy(source, copy / name)
        package = Path(folder) / "site" / "plotfeed"
        package.mkdir(parents=True)
        for room in ROOMS:
            (package / room).symlink_to(copy / room)
        yield copy


def is_noticed(fault: Fault, copy: Path) -> bool:
    """Whether a test fails with the fault; raises `RuntimeError` if the tests cannot be run."""
    path = copy / fault.file
    right = path.read_text()
    path.write_text(planted(fault, right))
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": str(copy.parent / "site"), "CI": ""}
    try:
        done = subprocess.run(
            [*words, *fault.tests.split()],
            cwd=copy,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE_S,
        )
    except subprocess.TimeoutExpired:
        return True  # it would be noticed
    finally:
        path.write_text(right)
    if done.returncode not in {0, 1, 2}:
        raise RuntimeError(f"{fault.tests}: {done.stdout[-500:]}{done.stderr[-500:]}")
    return done.returncode != 0


def main() -> None:
    """Plant all faults, or those whose file or text is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("only", nargs="*", help="parts of files' names or of what a fault does")
    only = parser.parse_args().only
    chosen = [f for f in faults() if not only or any(o in f.file + f.what for o in only)]
    survivors = []
    with copied() as copy:
        for fault in chosen:
            noticed = is_noticed(fault, copy)
            verdict = "noticed " if noticed else "SURVIVES"
            print(verdict, fault.file, fault.what, sep="  ", flush=True)
            if not noticed:
                survivors.append(fault)
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} faults are noticed")
    sys.exit(bool(survivors))


if __name__ == "__main__":
    main()
