"""What is installed of a clone: by pip from a wheel, and in the image, with the services around it.

The image is built where an engine answers; else its steps are taken without one.
"""

from __future__ import annotations

import fnmatch
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.brokers import free_port, mosquitto
from support.waiting import PATIENCE_S

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("feeds", "models", "proto", "replay")
SERVICES = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
TAG = "plotfeed-test"
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")


def run(*command: str | Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def instructions() -> list[tuple[str, str]]:
    """Of the Dockerfile, in its order."""
    lines = [line for line in (ROOT / "Dockerfile").read_text().splitlines() if line[:1] != "#"]
    joined = "\n".join(lines).replace("\\\n", " ").splitlines()
    return [(word, rest.strip()) for word, _, rest in (x.partition(" ") for x in joined if x)]


STEPS = instructions()


def of(word: str) -> list[str]:
    return [rest for found, rest in STEPS if found == word]


def is_sent_to_the_engine(name: str) -> bool:
    """Whether .dockerignore lets a path through: the last pattern that fits it counts."""
    sent = True
    for line in (ROOT / ".dockerignore").read_text().splitlines():
        pattern = line.removeprefix("!").removeprefix("**/")
        parts = Path(name).parts
        above = ["/".join(parts[: n + 1]) for n in range(len(parts))]
        names = [*above, *parts] if "**/" in line else above
        if line[:1] != "#" and any(fnmatch.fnmatchcase(each, pattern) for each in names):
            sent = line.startswith("!")
    return sent


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built as the image does, of what it copies; tests and tools lie beside that."""
    source, built = (tmp_path_factory.mktemp(name) for name in ("source", "built"))
    copied = [line.split() for line in of("COPY") if not line.startswith("--from")]
    for name in (name for *names, _ in copied for name in names):
        assert is_sent_to_the_engine(name), f".dockerignore keeps {name} away"
    targets = [(name, target) for *names, target in copied for name in names]
    for name, target in (*targets, ("tests", "tests"), ("tools", "tools")):
        if (ROOT / name).is_dir():
            assert target == name
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, source / name, ignore=ignored)
        else:
            (source / target).mkdir(exist_ok=True)
            shutil.copy(ROOT / name, source / target)
    (install,) = (run for run in of("RUN") if re.match(r"pip install .* \.$", run))
    options = [*shlex.split(install)[2:-1], "--no-index", "--wheel-dir", str(built)]
    run(*PIP, "wheel", *options, str(source))
    (path,) = built.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an environment in which that wheel is."""
    venv = tmp_path_factory.mktemp("venv")
    run(sys.executable, "-m", "venv", "--without-pip", venv)
    python = venv / "bin" / "python"
    place = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    run(*PIP, "--python", python, "install", "--no-deps", "--no-index", wheel)
    # The dependencies are those of this environment, which must not bring its own plotfeed along.
    (Path(place) / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return venv


def test_the_wheel_is_of_the_right_kind_and_holds_all_that_the_rooms_do(wheel: Path) -> None:
    assert wheel.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (n for n in names if n.endswith(".dist-info/METADATA"))
        text = archive.read(metadata).decode()
    assert "Name: plotfeed\n" in text
    assert "License-Expression: Apache-2.0\n" in text
    assert any(n.endswith("LICENSE") for n in names)
    packed = {n for n in names if ".dist-info/" not in n}
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


def test_what_was_installed_from_the_wheel_works(installed: Path) -> None:
    code = "import plotfeed.feeds.cli.main as m; print(m.__file__)"
    main = Path(run(installed / "bin" / "python", "-c", code).strip())
    assert main.is_relative_to(installed)
    script = installed / "bin" / "plotfeed"
    assert json.loads(run(script, "schema"))["title"] == "Scene"
    assert "message Telemetry" in run(script, "schema", "messages")
    scene = main.parents[1] / "scene" / "examples" / "section-4.toml"
    found = json.loads(run(script, "check", scene, "--json"))
    assert found["sensors"][0]["id"] == "active"
    run(script, "demo", "--broker", "none", "--speed", "max", "--duration", "5")


class Service:
    """A process as a service of an image, whose lines are read until one of them is as asked."""

    def __init__(self, installed: Path, arguments: list[str]) -> None:
        assert json.loads(*of("ENTRYPOINT")) == ["plotfeed"]
        self.process = subprocess.Popen(
            [installed / "bin" / "plotfeed", *arguments],
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def line(self, pattern: str) -> re.Match[str]:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.search(pattern, line):
                return found
        raise AssertionError(f"no {pattern}: {self.process.communicate()}")

    def stop(self) -> None:
        """As `docker stop` does; it ends by itself, with nothing to complain of."""
        self.process.send_signal(signal.SIGTERM)
        _, errors = self.process.communicate(timeout=PATIENCE_S)
        assert (self.process.returncode, errors) == (0, "")


@pytest.fixture
def services() -> Iterator[list[Service]]:
    """Those that a test has started; none is left behind."""
    started: list[Service] = []
    yield started
    for each in started:
        if each.process.poll() is None:
            each.process.kill()
            each.process.communicate(timeout=PATIENCE_S)


def test_the_image_is_small_and_never_root() -> None:
    assert [word for word, _ in STEPS].count("FROM") == 2  # what builds is left behind
    last = STEPS[len(STEPS) - [word for word, _ in reversed(STEPS)].index("FROM") :]
    user = dict(last)["USER"].split(":")[0]
    assert user.isdigit()
    assert user != "0"
    assert dict(last)["COPY"] == "--from=build /opt/plotfeed /opt/plotfeed"
    assert all("--require-hashes" in run for run in of("RUN") if "--requirement" in run)
    for kept in (".git/config", ".venv/bin/python", "tests/conftest.py", "feeds/__pycache__/x.pyc"):
        assert not is_sent_to_the_engine(kept)


def test_the_image_installs_all_that_its_extras_need() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    named = re.findall(r"--requirement (\S+)", " ".join(of("RUN")))
    held = {
        re.split("[<=>]", line)[0]
        for name in named
        for line in (ROOT / name).read_text().splitlines()
        if "==" in line
    }
    needed = [*project["dependencies"], *extras["page"], "setuptools>=77"]
    assert {re.split("[<=>]", each)[0] for each in needed} <= held


def test_the_services_find_each_other_and_the_subscriber_prints_plots(
    installed: Path, services: list[Service], tmp_path: Path
) -> None:
    port = free_port()
    (mounted,) = (volume.split(":") for volume in SERVICES["mosquitto"]["volumes"])
    assert mounted[1:] == ["/mosquitto/config/mosquitto.conf", "ro"]
    settings = (ROOT / mounted[0]).read_text()
    assert "\nlistener 1883\n" in settings
    settings = settings.replace("\nlistener 1883\n", f"\nlistener {port} 127.0.0.1\n")
    listens = f"0.0.0.0:{of('EXPOSE')[0]}"  # where the page asks for a token
    image_s, of_compose = json.loads(*of("CMD")), SERVICES["plotfeed"]["command"]
    assert image_s == ["demo", "--page", listens]
    assert of_compose == ["demo", "--broker", "mqtt://mosquitto:1883", "--page", listens]
    here = {"mqtt://mosquitto:1883": f"mqtt://127.0.0.1:{port}", listens: f"0.0.0.0:{free_port()}"}
    with mosquitto(tmp_path, port, settings, per_listener=False):
        for name in ("plotfeed", "subscriber"):
            arguments = SERVICES[name]["command"]
            for theirs, ours in here.items():
                arguments = [word.replace(theirs, ours) for word in arguments]
            services.append(Service(installed, arguments))
        demo, subscriber = services
        demo.line(r"page +http://\S+/\?token=\S+$")
        demo.line("^look at it")
        subscriber.line(r"^plotfeed/\w+/asterix/048  CAT048  .*040 RHO=")
        demo.stop()
        subscriber.stop()


def test_services_are_open_to_this_machine_alone_and_hand_signals_on() -> None:
    assert set(SERVICES) == {"mosquitto", "plotfeed", "subscriber"}
    for name, service in SERVICES.items():
        for port in service.get("ports", []):
            assert port.startswith("127.0.0.1:"), name
        assert service["init"], name
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert not {"privileged", "network_mode", "stop_signal"} & service.keys(), name
        assert service.get("user", "10001") != "0", name
    assert not any("truth" in word for word in SERVICES["subscriber"]["command"])


def test_the_page_of_the_container_names_what_is_there() -> None:
    page = (ROOT / "docs" / "container.md").read_text()
    rows = set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE))
    assert rows == set(SERVICES)
    for port in (port for each in SERVICES.values() for port in each.get("ports", [])):
        assert port.rpartition(":")[0] in page


def docker(*arguments: str, timeout_s: float = 900.0) -> subprocess.CompletedProcess[str]:
    words = ["docker", *arguments]
    return subprocess.run(words, capture_output=True, text=True, check=False, timeout=timeout_s)


@pytest.fixture(scope="module")
def image() -> Iterator[str]:
    """Built as the page says; skips where no engine answers, or the base cannot be had."""
    if shutil.which("docker") is None or docker("info").returncode:
        pytest.skip("no container engine answers")
    base = of("FROM")[-1]
    if docker("image", "inspect", base).returncode and docker("pull", base).returncode:
        pytest.skip(f"no container engine answers: it has no {base}")
    built = docker("build", "--tag", TAG, str(ROOT))
    assert built.returncode == 0, built.stderr
    yield TAG
    docker("image", "rm", TAG)


def test_the_image_runs_a_demo_as_nobody_in_particular_and_stops(image: str) -> None:
    options = ("--rm", "--init", "--read-only", "--tmpfs", "/tmp", "--cap-drop", "ALL")  # noqa: S108
    user = docker("run", *options, "--entrypoint", "id", image, "-u").stdout.strip()
    assert user not in ("", "0")
    demo = ("demo", "--broker", "none", "--speed", "max", "--duration", "10")
    done = docker("run", *options, image, *demo)
    assert done.returncode == 0, done.stderr
    assert re.search(r"plots [1-9]", done.stdout)
    container = docker("run", "--detach", *options[1:], image).stdout.strip()
    try:
        follow = ["docker", "logs", "--follow", container]
        lines: Any = subprocess.Popen(
            follow, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert any(line.startswith("look at it") for line in lines.stdout)
        assert docker("stop", container).returncode == 0
        asked: dict[str, Any] = json.loads(docker("inspect", container).stdout)[0]["State"]
        assert asked["ExitCode"] == 0  # 137 is that of one that had to be killed
        lines.communicate(timeout=PATIENCE_S)
    finally:
        docker("rm", "--force", container)
