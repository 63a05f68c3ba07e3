from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from support.road import fly, radar, scene
from support.sapient_tasks import ONE, task
from support.scene_files import radar as radar_text
from support.scene_files import scene_file, scene_text

from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.sapient.envelope import node_id

REPORT = 'report = ["sapient"]'


@pytest.fixture
def without_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [n for n in sys.modules if n.startswith("sapient_msg.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "sapient_msg", None)


@pytest.mark.usefixtures("without_extra")
def test_without_the_extra_a_scene_is_refused_in_one_line() -> None:
    with pytest.raises(PlotfeedError) as caught:
        fly(scene([radar(report=["sapient"])], seed=1), 1.0)
    assert str(caught.value) == "SAPIENT needs sapient-proto: pip install 'plotfeed[sapient]'"


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        (
            {"__init__.py": "", "bsi_flex_335_v1_0/__init__.py": ""},
            "SAPIENT needs sapient-proto, and another package has its name: "
            "pip install 'plotfeed[sapient]'",
        ),
        (
            {
                "__init__.py": "",
                "bsi_flex_335_v2_0/__init__.py": "",
                "bsi_flex_335_v2_0/sapient_message_pb2.py": "raise TypeError('two\\nof them')",
            },
            "sapient-proto does not load (two of them): pip install 'plotfeed[sapient]', "
            "without sapient-msg or sapient-py",
        ),
        (
            {
                "__init__.py": "",
                "bsi_flex_335_v2_0/__init__.py": "",
                "bsi_flex_335_v2_0/sapient_message_pb2.py": "import nothing_like_it",
            },
            "sapient-proto does not load (No module named 'nothing_like_it'): "
            "pip install 'plotfeed[sapient]', without sapient-msg or sapient-py",
        ),
    ],
)
def test_what_is_installed_wrongly_is_told_in_one_line(
    files: dict[str, str], expected: str, tmp_path: Path
) -> None:
    for name, text in files.items():
        path = tmp_path / "sapient_msg" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    program = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from plotfeed.feeds.formats.sapient import need_sapient\n"
        "try:\n    need_sapient()\nexcept Exception as e:\n    print(type(e).__name__, e)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == f"PlotfeedError {expected}"


@pytest.mark.usefixtures("without_extra")
def test_without_the_extra_show_says_so() -> None:
    (line,) = message_lines("plotfeed/radar/sapient", b"x", None, as_json=False)
    assert line.endswith("pip install 'plotfeed[sapient]'")


def test_the_command_says_it_too(tmp_path: Path) -> None:
    path = scene_file(tmp_path, scene_text(sensors=radar_text(more=REPORT)))
    program = (
        "import sys; sys.modules['sapient_msg'] = None\n"
        f"sys.argv = ['plotfeed', 'run', {str(path)!r}, '--broker', 'none', '--duration', '1']\n"
        "from plotfeed.feeds.cli.main import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "pip install 'plotfeed[sapient]'" in done.stderr


def test_a_scene_without_sapient_does_not_import_it(tmp_path: Path) -> None:
    path = scene_file(tmp_path, scene_text())
    program = (
        "import asyncio, sys\n"
        "from plotfeed.feeds.timing.clock import InstantClock\n"
        "from plotfeed.feeds.scene.scene import load\n"
        "from plotfeed.feeds.session.session import run\n"
        f"scene = load({str(path)!r})\n"
        "asyncio.run(run(scene, clock=InstantClock(), broker='none', duration_s=1))\n"
        "print([name for name in sys.modules if 'sapient_msg' in name])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"middleware": "nowhere"}, "sapient.middleware"),
        ({"location": "here"}, "sapient.location"),
        ({"default_class_confidence": 1.4}, "sapient.default_class_confidence"),
        ({"default_class": ""}, "sapient.default_class"),
        ({"status_interval_s": 0}, "sapient.status_interval_s"),
        ({"detection_confidence": float("nan")}, "sapient.detection_confidence"),
    ],
)
def test_a_wrong_key_is_named(settings: dict[str, object], key: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene([radar(report=["sapient"])], seed=1, sapient=settings)
    assert [found for found, _ in caught.value.problems] == [key]


def test_messages_are_shown_as_a_line_and_as_json() -> None:
    flown = fly(scene([radar(report=["sapient"], pfa=1e-4)], seed=1), 3.0)
    shown = {}
    for payload in flown.payloads("radar/sapient"):
        (line,) = message_lines("plotfeed/radar/sapient", payload, None, as_json=False)
        (text,) = message_lines("plotfeed/radar/sapient", payload, None, as_json=True)
        message = json.loads(text)["message"]["SapientMessage"]
        assert message["node_id"] == node_id(1, "radar")
        assert line.split("  ")[:3] == [
            "plotfeed/radar/sapient",
            message["timestamp"],
            message["node_id"][:8],
        ]
        shown[line.split("  ")[3]] = line
    assert "  azimuth " in shown["detection_report"]
    assert "  SNR " in shown["detection_report"]
    assert "BSI Flex 335 v2.0" in shown["registration"]
    assert "SYSTEM_GOODBYE" in shown["status_report"]


def test_tasks_are_shown_too() -> None:
    asked = task(ONE, mode_change="standby")
    (line,) = message_lines("plotfeed/radar/sapient/task", asked, None, as_json=False)
    assert ONE in line
    assert '"mode_change": "standby"' in line


def test_what_is_no_sapient_is_shown_as_such() -> None:
    for payload in (b"", b"\xff\xff", b"\x12\x01a"):
        (line,) = message_lines("plotfeed/radar/sapient", payload, None, as_json=False)
        assert "not what the topic says" in line
