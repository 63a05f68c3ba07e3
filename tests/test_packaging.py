from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("feeds", "models", "proto", "replay")


def run(*command: str | Path, **environment: str) -> str:
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy of what is tracked, so that it leaves nothing behind beside it."""
    source = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for room in (*ROOMS, "face", "tests", "tools"):
        shutil.copytree(ROOT / room, source / room, ignore=shutil.ignore_patterns("__pycache__"))
    built = tmp_path_factory.mktemp("built")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    options = ("--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", str(built))
    run(*pip, "wheel", *options, str(source))
    (path,) = built.glob("*.whl")
    return path


def test_the_wheel_holds_all_that_the_rooms_do_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        packed = {n for n in archive.namelist() if ".dist-info/" not in n}
    expected = {
        f"plotfeed/{path.relative_to(ROOT)}"
        for room in ROOMS
        for path in (ROOT / room).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert packed == expected | {
        f"plotfeed/{name}" for name in ("__init__.py", "testing.py", "py.typed")
    }
    for name in (
        "plotfeed/feeds/scene/examples/section-4.toml",
        "plotfeed/feeds/py.typed",
        "plotfeed/models/py.typed",
        "plotfeed/proto/py.typed",
        "plotfeed/replay/py.typed",
        "plotfeed/proto/plotfeed.proto",
        "plotfeed/proto/plotfeed_pb2.pyi",
        "plotfeed/proto/ledger.proto",
    ):
        assert name in packed


def test_the_wheel_is_of_the_right_kind(wheel: Path) -> None:
    assert wheel.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (n for n in names if n.endswith(".dist-info/METADATA"))
        text = archive.read(metadata).decode()
    assert "Name: plotfeed\n" in text
    assert "License-Expression: Apache-2.0\n" in text
    assert any(n.endswith("LICENSE") for n in names)


def test_what_was_installed_from_the_wheel_works(wheel: Path, tmp_path: Path) -> None:
    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv")
    python = tmp_path / "venv" / "bin" / "python"
    place = Path(
        run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    )
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python)
    run(*pip, "install", "--no-deps", "--no-index", wheel)
    # The dependencies are those of this environment, which must not bring its own plotfeed along.
    (place / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    code = "import plotfeed.feeds.cli.main as m; print(m.__file__)"
    assert Path(run(python, "-c", code).strip()).is_relative_to(place)
    script = tmp_path / "venv" / "bin" / "plotfeed"
    assert json.loads(run(script, "schema"))["title"] == "Scene"
    assert "message Telemetry" in run(script, "schema", "messages")
    scene = place / "plotfeed" / "feeds" / "scene" / "examples" / "section-4.toml"
    found = json.loads(run(script, "check", scene, "--json"))
    assert found["sensors"][0]["id"] == "active"
    run(script, "demo", "--broker", "none", "--speed", "max", "--duration", "5")
