"""Plants the faults of `faults.toml`, one after the other, and says which of them no test notices.

`make mutations` does it in an hour, in a copy of the tree; nothing here is changed. Each fault
is a place where a wrong sign, unit, index, key or order would hurt a user, and names the tests that
are asked.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
FAULTS = Path(__file__).with_name("faults.toml")
ROOMS = ("feeds", "models", "proto", "replay")
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
FOLDERS = (*ROOMS, "face", "tests", "tools", "docs", "examples")
COPIED = (*FOLDERS, "Makefile", "mkdocs.yml", "pyproject.toml", *PAGES)
PATIENCE_S = 900
# Word or sign; spaces, ends of lines and a comma before a closing bracket do not count.
SIGN = re.compile(r"\w+|,(?!\s*[)\]}])|[^\w\s,]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A change of the code that some test must notice."""

    what: str  # What a user would have of it
    # Function, method, class or constant that is changed, by its qualified name in its module.
    where: str
    old: str
    new: str
    tests: str  # Arguments of pytest


def faults() -> list[Fault]:
    """All of them, as the file has them."""
    with FAULTS.open("rb") as file:
        return [Fault(**fault) for fault in tomllib.load(file)["fault"]]


def place(fault: Fault) -> tuple[str, int, int]:
    """File and characters that the fault replaces; raises `ValueError` unless one is meant."""
    wanted = [sign[0] for sign in SIGN.finditer(fault.old)]
    found = []
    for file, text in _texts().items():
        for begin, block in _blocks(text, fault.where):
            signs = list(SIGN.finditer(block))
            plain = [sign[0] for sign in signs]
            found += [
                (file, begin + signs[i].start(), begin + signs[i + len(wanted) - 1].end())
                for i in range(len(plain) - len(wanted) + 1)
                if plain[i : i + len(wanted)] == wanted
            ]
    if len(found) != 1:
        raise ValueError(f"{fault.where}: expected {fault.old!r} once, not {len(found)} times")
    return found[0]


def planted(fault: Fault, text: str) -> str:
    """The text of the file of the fault's place with the fault in it."""
    _, begin, end = place(fault)
    return text[:begin] + fault.new + text[end:]


def _blocks(text: str, where: str) -> Iterator[tuple[int, str]]:
    """Each definition of that qualified name: where it begins, and its text."""
    name, _, inner = where.partition(".")
    if name not in text:
        return
    head = rf"^([ \t]*)(?:(?:async )?def |class )?{name}\b"
    for block in re.finditer(rf"{head}.*\n(?:(?:\1[ \t)\]}}].*|[ \t]*)\n)*", text, re.MULTILINE):
        if not inner:
            yield block.start(), block[0]
        for begin, within in _blocks(block[0], inner) if inner else ():
            yield block.start() + begin, within


@cache
def _texts() -> dict[str, str]:
    files = (path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py")))
    return {str(path.relative_to(ROOT)): path.read_text() for path in files}


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
        for part in (*(copy / room for room in ROOMS), *(copy / "face").iterdir()):
            (package / part.name).symlink_to(part)
        yield copy


def is_noticed(fault: Fault, copy: Path) -> bool:
    """Whether a test fails with the fault; raises `RuntimeError` if the tests cannot be run."""
    path = copy / place(fault)[0]
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
    """Plant all faults, or those whose place or text is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("only", nargs="*", help="parts of functions' names or of what a fault does")
    only = parser.parse_args().only
    chosen = [f for f in faults() if not only or any(o in f.where + f.what for o in only)]
    survivors = []
    with copied() as copy:
        for fault in chosen:
            noticed = is_noticed(fault, copy)
            verdict = "noticed " if noticed else "SURVIVES"
            print(verdict, fault.where, fault.what, sep="  ", flush=True)
            if not noticed:
                survivors.append(fault)
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} faults are noticed")
    sys.exit(bool(survivors))


if __name__ == "__main__":
    main()
