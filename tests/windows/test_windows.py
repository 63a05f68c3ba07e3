"""Commands where Python has nothing but what it has on Windows: here, with the rest hidden.

No test was ever run on Windows itself; what differs there beyond that is not seen here.
"""

from __future__ import annotations

import ast
import csv
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.brokers import free_port
from support.waiting import PATIENCE_S

# The stubs that mypy brings.
STUBS = Path(find_spec("mypy").origin).parent / "typeshed" / "stdlib"  # type: ignore[union-attr, arg-type]
MODULES = ("os", "signal", "socket", "select", "time", "mmap", "sys")  # Of which Windows has a part


def lacks() -> dict[str, list[str] | None]:
    """Names that Windows lacks by module; None for a module that it has not at all."""
    found: dict[str, list[str] | None] = {}
    for name in (*MODULES, *(path.stem for path in STUBS.glob("*.pyi"))):
        here, there = (_names(name, system) for system in ("linux", "win32"))
        if name in MODULES:
            found[name] = sorted(here - there)
        elif _public(here) and not _public(there):
            found[name] = None
    return found


def _public(names: Iterable[str]) -> set[str]:
    return {name for name in names if not name.startswith("_")}


@cache
def _names(module: str, platform: str) -> frozenset[str]:
    """What it defines on that system; names of types that stubs import are none."""
    path = STUBS / f"{module}.pyi"
    path = path if path.exists() else STUBS / module / "__init__.pyi"
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


def uses(source: str, lacking: dict[str, list[str] | None]) -> set[str]:
    """What of that a text of Python names, as `os.fork`, and the modules that it imports."""
    named: set[tuple[str, str]] = set()  # A module, and a name in it
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Attribute(value=ast.Name(id=module), attr=name):
                named.add((module, name))
            case ast.ImportFrom(module=str(module), names=names):
                named |= {(module, ""), *((module, alias.name) for alias in names)}
            case ast.Import(names=names):
                named |= {(alias.name, "") for alias in names}
    whole = {module for module, name in named if not name and lacking.get(module, ()) is None}
    parts = {each for each in named if each[1] in (lacking.get(each[0]) or ())}
    return whole | {".".join(each) for each in parts}


HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PRODUCT = ("face", "feeds", "models", "proto", "replay")
SCENE = ROOT / "examples" / "scenes" / "radar-udp.toml"
FLIGHT = ROOT / "examples" / "flights" / "visit.csv"
GUARDED = {
    "feeds/page/page_access.py": {"socket.TCP_USER_TIMEOUT"},  # where the system has it
    "feeds/timing/clock.py": {"os.O_NONBLOCK", "os.O_CLOEXEC", "time.CLOCK_MONOTONIC"},  # Linux's
    "feeds/transport/sapient.py": {"socket.TCP_USER_TIMEOUT"},  # where the system has it
}


def test_one_module_alone_uses_what_windows_lacks() -> None:
    lacking = lacks()
    assert lacking.keys() >= {"termios", "fcntl", "resource", "pwd", "grp", "tty"}
    assert {"fork", "getuid", "killpg"} <= set(lacking["os"] or ())
    found = {
        str(path.relative_to(ROOT)): names
        for room in PRODUCT
        for path in sorted((ROOT / room).rglob("*.py"))
        if (names := uses(path.read_text("utf-8"), lacking))
    }
    assert {"fcntl", "termios", "os.killpg", "signal.SIGKILL"} <= found.pop(
        "feeds/console/posix.py"
    )
    assert found == GUARDED


@pytest.fixture(scope="module")
def poorer(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a Python that lacks it."""
    told = tmp_path_factory.mktemp("windows") / "lacks.json"
    told.write_text(json.dumps(lacks()), "utf-8")
    return os.environ | {
        "PLOTFEED_TEST_LACKS": str(told),
        "PYTHONIOENCODING": "cp1252",
        "PYTHONPATH": os.pathsep.join([str(HERE / "poorer"), str(HERE.parent)]),
        "PYTHONWARNDEFAULTENCODING": "1",
    }


@contextmanager
def started(poorer: dict[str, str], *words: object) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, *map(str, words)],
        env=poorer,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="cp1252",
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def ended(poorer: dict[str, str], *words: object) -> tuple[int, str, str]:
    with started(poorer, "-m", "plotfeed.feeds.cli", *words) as process:
        out, err = process.communicate(timeout=PATIENCE_S)
        return process.returncode, out, err


def test_commands_that_need_no_network_do_as_ever_and_every_module_can_be_imported(
    poorer: dict[str, str], tmp_path: Path
) -> None:
    """With the code that each ends with, and words that it says."""
    here = tmp_path
    quick = ("--broker", "none", "--speed", "max", "--duration", 20)
    tracker = f'{sys.executable} -c "import time; print(1, flush=True); time.sleep(999)"'
    scored = ("--tracker", tracker, "--duration", 3, "--runs", 1, "--folder", here / "score")
    serial = "plotfeed: mavlink:COM3,57600: No such file or directory"
    fine: list[tuple[object, ...]] = [
        ("check", SCENE, "--chart", here / "check.png"),
        ("chart", SCENE, "--runs", "2", "--duration", "2", "--chart", here / "chart.png"),
        ("needs", SCENE, "--runs", "2", "--duration", "2", "--write", here / "lean.toml"),
        ("run", SCENE, *quick, "--record", here / "a.mcap", "--write", here / "a.ast"),
        ("run", here / "a.mcap", *quick, "--record", here / "again.mcap"),
        ("demo", *quick, "--json"),
        ("show", here / "a.mcap"),
        ("show", "--json", here / "a.ast"),
        *(("convert", here / "a.mcap", here / f"a.{to}") for to in ("pcap", "csv", "jsonl")),
        ("convert", here / "a.mcap", here / "a.csv", "--force"),
        ("merge", here / "a.mcap", here / "again.mcap", here / "both.mcap"),
        ("report", here / "a.mcap"),
        ("score", here / "a.mcap", "--feed"),
        ("sweep", SCENE, "--runs", 2, "--duration", 5, "--processes", 1, "--out", here / "sweep"),
        ("replay", here / "a.mcap", "--udp", f"127.0.0.1:{free_port()}", "--speed", "max"),
        ("schema",),
        ("schema", "asyncapi"),
        ("scenes",),
        ("sensors", "echodyne"),
    ]
    commands = [
        *((words, 0, "") for words in fine),
        # The tracker was killed, and had not ended by itself.
        (("score", SCENE, *scored), 1, "the tracker reported no tracks"),
        (("inject", "mavlink:serial:COM3:57600"), 1, serial),
    ]
    lines = "".join(json.dumps([*map(str, words)]) + "\n" for words, _, _ in commands)
    with started(poorer, HERE / "windows_commands.py") as process:
        out, err = process.communicate(lines, timeout=2 * PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    *answers, imported = out.splitlines()
    for (words, expected, says), answer in zip(commands, answers, strict=True):
        code, said, complained = json.loads(answer)
        assert (code, "Traceback" in complained) == (expected, False), (words, said, complained)
        assert says in said + complained
    rows = list(csv.reader((here / "a.csv").read_text("utf-8").splitlines()))
    assert len(rows) > 10
    assert len({len(row) for row in rows}) == 1
    assert json.loads(imported) > 250


def introduced(process: subprocess.Popen[str]) -> dict[str, str]:
    """The addresses that a session says as it begins."""
    said = []
    assert process.stdout is not None
    for line in process.stdout:
        said.append(line)
        if line.startswith("look at it"):
            return dict(re.findall(r"^ +(\w.*?)  +(\w+://[^ \n]+)", "".join(said), re.MULTILINE))
    raise AssertionError(process.communicate())


def test_a_session_a_flight_and_a_recorder_meet_and_ctrl_c_ends_them(
    poorer: dict[str, str], tmp_path: Path
) -> None:
    command, udp = ("-m", "plotfeed.feeds.cli"), free_port()
    with started(poorer, *command, "run", SCENE, "--page", free_port()) as session:
        url = introduced(session)["MQTT"]
        heard, datagrams = tmp_path / "heard.mcap", tmp_path / "datagrams.mcap"
        with (
            started(poorer, *command, "record", f"{url}/#", heard, "--count", 200) as recorder,
            started(poorer, *command, "record", f"udp://127.0.0.1:{udp}", datagrams) as receiver,
        ):
            flight = tmp_path / "flight.csv"
            flight.write_text("".join(FLIGHT.read_text("utf-8").splitlines(True)[:5]), "utf-8")
            how = ("--now", "--set", "altitude_reference=ellipsoid")
            injected = ended(poorer, "inject", flight, *how, "--broker", url)
            assert injected[0] == 0, injected
            out, err = recorder.communicate(timeout=PATIENCE_S)
            assert recorder.returncode == 0, (out, err)
            replayed = ended(poorer, "replay", heard, "--udp", f"127.0.0.1:{udp}", "--speed", 100)
            assert replayed[0] == 0, replayed
            receiver.send_signal(signal.SIGINT)
            out, err = receiver.communicate(timeout=PATIENCE_S)
            assert receiver.returncode == 130, (out, err)
        shown = ended(poorer, "show", datagrams)
        assert (shown[0], bool(re.search(r" 048 +[1-9]", shown[1]))) == (0, True), shown
        session.send_signal(signal.SIGINT)
        out, err = session.communicate(timeout=PATIENCE_S)
        assert (session.returncode, "Traceback" in err) == (130, False), err
