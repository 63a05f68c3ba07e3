"""What Python lacks on Windows of what it has here, by the stubs of the standard library."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

MODULES = ("os", "signal", "socket", "select", "time", "mmap", "sys")  # Of which Windows has a part


def lacks() -> dict[str, list[str] | None]:
    """Names that Windows lacks by module; None for a module that it has not at all."""
    missing = [path.stem for path in _stubs().glob("*.pyi") if _is_missing(path.stem)]
    partly = {name: sorted(_names(name, "linux") - _names(name, "win32")) for name in MODULES}
    return {**partly, **dict.fromkeys(missing)}


def _is_missing(module: str) -> bool:
    here, there = (
        {name for name in _names(module, system) if not name.startswith("_")}
        for system in ("linux", "win32")
    )
    return bool(here) and not there


def _stubs() -> Path:
    """The stubs that mypy brings."""
    found = find_spec("mypy")
    assert found is not None
    assert found.origin is not None
    return Path(found.origin).parent / "typeshed" / "stdlib"


@cache
def _names(module: str, platform: str) -> frozenset[str]:
    """What it defines on that system; names of types that stubs import are none."""
    path = _stubs() / f"{module}.pyi"
    path = path if path.exists() else _stubs() / module / "__init__.pyi"
    system = SimpleNamespace(platform=platform, version_info=sys.version_info)
    return frozenset(_defined(ast.parse(path.read_text("utf-8")).body, system))


def _defined(body: Sequence[ast.stmt], system: SimpleNamespace) -> Iterator[str]:
    for each in body:
        match each:
            case ast.If(test=test, body=then, orelse=otherwise):
                code = compile(ast.Expression(test), "stub", "eval")
                holds = eval(code, {"sys": system, "TYPE_CHECKING": True})  # noqa: S307
                yield from _defined(then if holds else otherwise, system)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.AnnAssign(target=ast.Name(id=name)):
                yield name
            case ast.Assign(targets=[ast.Name(id=name)]):
                yield name
            case ast.ImportFrom(names=names, module=source) if source in ("_socket", "select"):
                yield from (alias.asname for alias in names if alias.asname)


def uses(source: str, lacking: dict[str, list[str] | None]) -> list[str]:
    """What of that a text of Python names, as `os.fork`, and the modules that it imports."""
    found = []
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Attribute(value=ast.Name(id=module), attr=name):
                found += [f"{module}.{name}"] * (name in (lacking.get(module) or ()))
            case ast.ImportFrom(module=str(module), names=names):
                found += [module] * (lacking.get(module, ()) is None)
                found += [
                    f"{module}.{alias.name}"
                    for alias in names
                    if alias.name in (lacking.get(module) or ())
                ]
            case ast.Import(names=names):
                found += [alias.name for alias in names if lacking.get(alias.name, ()) is None]
    return found
