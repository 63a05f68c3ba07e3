"""The house: rooms, names, files and planted faults as CONTRIBUTING says that they are."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import pytest
from mutations.plant_faults import Fault, faults, place, planted
from support.budget import budget, measured

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("face", "feeds", "models", "proto", "replay")
# How a docstring begins that does not name its subject.
SUBJECTLESS = re.compile(
    r"(About|After|And|As|At|Before|Beside|Between|But|By|For|From|If|In|Into|It|Its|Of|On|Or|Other|"
    r"Others|Out|Over|Since|So|That|Their|Them|These|They|This|Those|The same|To|Until|Under|"
    r"What it|When it|Where it|With|Without)\b"
)


def files() -> list[Path]:
    """All modules that people write."""
    found = [path for room in PACKAGES for path in (ROOT / room).rglob("*.py")]
    return [path for path in found if "_pb2." not in path.name]


def twice(places: Iterable[tuple[str, Path]]) -> dict[str, list[str]]:
    """Names that stand in more than one place."""
    found = defaultdict(list)
    for name, path in places:
        found[name].append(str(path.relative_to(ROOT)))
    return {name: at for name, at in found.items() if len(at) > 1}


def test_no_two_modules_and_no_two_public_classes_have_one_name() -> None:
    packages = {"__init__.py", "__main__.py"}
    assert twice((path.stem, path) for path in files() if path.name not in packages) == {}
    assert (
        twice(
            (node.name, path)
            for path in files()
            for node in ast.parse(path.read_text()).body
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        )
        == {}
    )


def test_nothing_grows_beyond_its_budget() -> None:
    """Who raises a number of budget.toml says in that commit which other falls for it."""
    ceilings, found = budget(), measured()
    assert found.keys() == ceilings.keys()
    assert {name: n for name, n in found.items() if n > ceilings[name]} == {}


def test_every_room_says_what_belongs_there_and_no_module_of_feeds_is_outside_one() -> None:
    for face in (ROOT / "feeds").glob("*/__init__.py"):
        text = ast.get_docstring(ast.parse(face.read_text())) or ""
        assert len(text.splitlines()) > 2, f"{face}: {text!r}"
    assert {path.name for path in (ROOT / "feeds").glob("*.py")} == {"__init__.py", "metrics.py"}


def test_every_package_is_installed() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    there = {
        ".".join(("plotfeed", *path.parent.relative_to(ROOT).parts)).replace(".face", "")
        for room in PACKAGES
        for path in (ROOT / room).rglob("__init__.py")
    }
    assert set(settings["packages"]) == there


def test_no_circle_of_imports() -> None:
    """Between modules, those for type checkers among them."""
    # In the folder where the rooms are one package, as type checkers see them.
    graph = (
        "import grimp, json; found = grimp.build_graph('plotfeed', cache_dir=None); "
        "imported = found.find_modules_directly_imported_by; "
        "print(json.dumps({module: sorted(imported(module)) for module in found.modules}))"
    )
    told = subprocess.run(
        [sys.executable, "-c", graph], cwd=ROOT / ".typing", check=True, capture_output=True
    ).stdout
    left = {module: set(imported) for module, imported in json.loads(told).items()}
    assert len(left) > len(files()) // 2
    while free := {module for module, imported in left.items() if not imported}:
        left = {module: imported - free for module, imported in left.items() if module not in free}
    # What is left imports, or is in, a circle; whoever is imported by none of it is not in one.
    while left:
        imported = set().union(*left.values())
        if idle := set(left) - imported:
            left = {module: left[module] for module in left.keys() - idle}
        else:
            break
    assert sorted(left) == []


def test_docstrings_name_their_subject() -> None:
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    vague = {
        f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}": text.splitlines()[0]
        for path in files()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, kinds) and (text := ast.get_docstring(node)) and SUBJECTLESS.match(text)
    }
    assert vague == {}


@pytest.mark.parametrize("fault", faults(), ids=lambda fault: f"{fault.where}: {fault.what}")
def test_a_fault_can_be_planted(fault: Fault) -> None:
    """It still has its place; whether tests notice it, `make mutations` says."""
    text = (ROOT / place(fault)[0]).read_text()
    wrong = planted(fault, text)
    assert wrong != text
    ast.parse(wrong)
    for word in fault.tests.split():
        if not word.startswith("-") and "/" in word:
            assert (ROOT / word.partition("::")[0]).exists()


def test_there_are_planted_faults_in_all_rooms() -> None:
    files = [place(fault)[0] for fault in faults()]
    assert len(files) >= 55
    assert {file.partition("/")[0] for file in files} == {"feeds", "models", "proto", "replay"}
