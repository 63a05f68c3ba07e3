"""The command as a user types it: what it prints, its exit codes, and what it says of mistakes."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import time
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from support.brokers import deaf_server, free_port
from support.command import PLOTFEED, Started, plotfeed, plotfeed_here, running, started
from support.recordings import block_048
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until

from plotfeed.proto.asterix.codec.decode import decode_lenient
from plotfeed.testing import MqttReceiver

FAST = radar(period_s=0.2, sectors=8)
START = "2026-01-01T12:00:00.05Z"
SIMULATED = ("--broker", "none", "--speed", "max", "--duration")


def is_one_line(text: str) -> bool:
    return len(text.splitlines()) == 1 and text.startswith("plotfeed: ")


def test_the_entry_point_is_the_command_and_waits_for_no_library_of_a_session() -> None:
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    assert project["scripts"] == {"plotfeed": "plotfeed.feeds.cli.__main__:main"}
    code = (
        "import sys, plotfeed.feeds.cli.main\n"
        "print({'numpy', 'pydantic', 'google', 'asyncio', 'mcap'} & sys.modules.keys())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
    assert version("plotfeed") in plotfeed_here("--version").stdout


def test_the_last_line_tells_the_speed_that_was_reached(tmp_path: Path) -> None:
    """Which no machine does of ten thousand."""
    scene = scene_file(tmp_path, scene_text(start_utc=START, sensors=FAST))
    how = ("--broker", "none", "--duration", "20")
    *_, line = plotfeed_here("run", scene, *how, "--speed", "10000").stdout.splitlines()
    assert re.search(r"^drones 1 .*  speed x[0-9.e+]+ of x10000$", line)
    assert "missed" not in line
    *_, line = plotfeed_here("run", scene, *how, "--speed", "max").stdout.splitlines()
    assert line.startswith("drones 1 ")
    assert "speed" not in line


WRONG_USE: tuple[tuple[tuple[str, ...], str], ...] = (
    (("fly",), "No such command 'fly'"),
    (("run",), "Missing argument"),
    *((("demo", "--speed", speed), "--speed") for speed in ("fast", "-1", "nan")),
    (("demo", "--duration", "0"), "--duration"),
    (("demo", "--broker", "http://here"), "mqtt://"),
    (("demo", "--broker", "mqtt://:1883"), "mqtt://"),
    (("demo", "--broker", "mqtt://user:secret@here"), "PLOTFEED_MQTT_"),
    (("demo", "--broker", "mqtt://here:99999"), "99999"),
    (("demo", "--broker", "mqtt://[::1"), "mqtt://"),
    (("show", "http://here/x"), "expected a file, mqtt://HOST:PORT/TOPIC-FILTER or udp://"),
    (("show", "udp://127.0.0.1:8600", "--stage", "after"), "--stage: only of a file"),
    (("show", "here.mcap", "--topic", "a#"), "+ is a whole level"),
    (("schema", "nothing"), "nothing"),
    (("inject", "absent.csv", "--set", "columns.x"), "--set columns.x"),
)


def test_wrong_use_is_exit_code_2_and_says_what_is_wrong() -> None:
    for arguments, says in WRONG_USE:
        done = plotfeed_here(*arguments)
        assert (done.returncode, done.stdout) == (2, ""), arguments
        assert says in done.stderr, (arguments, done.stderr)
        assert "secret" not in done.stderr


def test_what_is_not_there_or_no_scene_is_one_line_each(tmp_path: Path) -> None:
    absent = tmp_path / "absent.csv"
    for verb, where in (
        *((verb, absent) for verb in ("run", "check", "inject", "show")),
        ("show", tmp_path),
    ):
        done = plotfeed_here(verb, where)
        assert done.returncode in (1, 2)
        assert is_one_line(done.stderr)
        assert str(where) in done.stderr
    done = plotfeed_here("demo", "--duration", "1", "--write", tmp_path / "no" / "where")
    assert done.returncode == 1
    assert is_one_line(done.stderr)
    for content in (b"\xff" * 100, b"hello, this is no ASTERIX", b"\0"):
        absent.write_bytes(content)
        done = plotfeed_here("show", absent)
        assert done.returncode == 2
        assert str(absent) in done.stderr
    scene = scene_file(tmp_path, scene_text().replace("power_w", "powr_w"))
    for verb in ("run", "check"):
        done = plotfeed_here(verb, scene)
        assert (done.returncode, done.stdout) == (2, "")
        text = scene.read_text().split("\n")
        table, key = text.index("[[sensor]]") + 1, text.index("powr_w = 500.0") + 1
        assert done.stderr.splitlines() == [
            f"plotfeed: {scene}: line {table}: sensor[0].power_w of 'radar': missing",
            f"plotfeed: {scene}: line {key}: sensor[0].powr_w of 'radar': no such key; "
            "did you mean power_w?",
        ]


def test_the_demo_says_where_to_connect_and_what_it_did() -> None:
    done = plotfeed("demo", "--duration", "1.5")
    assert (done.returncode, done.stderr) == (0, "")
    for word in ("scene field-day", "MQTT", "plotfeed/tower/plots"):
        assert word in done.stdout
    counts = dict(re.findall(r"(drones|messages|missed scans) (\d+)", done.stdout.splitlines()[-1]))
    assert counts["drones"] == "21"
    # A machine that stalls for all that time says what it missed instead.
    assert int(counts["messages"]) + int(counts.get("missed scans", 0)) > 0
    totals = json.loads(plotfeed_here("demo", *SIMULATED, "1", "--json").stdout)
    assert totals["drones"] == 21
    assert totals["messages"] > 0
    assert totals["undelivered"] == 0


@pytest.mark.parametrize(("how", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_a_signal_is_a_clean_end(how: signal.Signals, code: int, tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST))
    with (
        running("run", scene) as session,
        MqttReceiver(session.port("MQTT"), 5, "plotfeed/radar/status") as client,
    ):
        client.wait_for(lambda m: json.loads(m.payload)["state"] == "ONLINE")
        returned, out, err = session.end(how)
        client.wait_for(lambda m: json.loads(m.payload)["state"] == "OFFLINE")
    assert (returned, err) == (code, "")
    assert out.startswith("drones 1 ")


def test_a_signal_while_it_starts_is_no_traceback(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST))
    for delay_s in (0.0, 0.3):
        process = subprocess.Popen(
            [*PLOTFEED, "run", str(scene)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        time.sleep(delay_s)
        process.terminate()
        _, err = process.communicate(timeout=PATIENCE_S)
        assert "Traceback" not in err


def test_check_tells_pd_and_errors_against_range(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text())
    text = plotfeed_here("check", scene)
    assert text.returncode == 0
    assert "radar (active_radar, SAC 0 SIC 1)" in text.stdout
    found = json.loads(plotfeed_here("check", scene, "--json").stdout)
    assert (found["scene"], found["drones"]) == ("test", 1)
    (sensor,) = found["sensors"]
    pds = [row["pd"] for row in sensor["table"]]
    assert all(0 <= pd <= 1 for pd in pds)
    bigger = json.loads(plotfeed_here("check", scene, "--json", "--rcs-m2", "1.0").stdout)
    assert bigger["sensors"][0]["table"][-1]["pd"] > pds[-1]
    # Eight beams of 2 degrees, a turn in half a second: 22.2 ms on a target.
    for beams, told in ((8, None), (7, "for 0.0194 s of a turn"), (1, "for 0.00278 s of a turn")):
        more = f"receive_beams = {beams}"
        fast = radar(more=more).replace("integration_s = 0.01", "integration_s = 0.022")
        done = plotfeed_here("check", scene_file(tmp_path, scene_text(sensors=fast)))
        assert ("integration_s is 0.022, but the beam is on a target" in done.stdout) == bool(told)
        assert told is None or told in done.stdout


def recorded(folder: Path, name: str, duration_s: float, scene: Path | None = None) -> Path:
    """ASTERIX as a session wrote it in simulated time."""
    scene = scene or scene_file(folder, scene_text(start_utc=START, sensors=FAST))
    done = plotfeed_here("run", scene, *SIMULATED, duration_s, "--write", folder / name)
    assert done.returncode == 0, done.stderr
    return folder / name


def test_the_same_scene_gives_the_same_octets_in_simulated_and_in_real_time(tmp_path: Path) -> None:
    # Turns are long, so that a machine that stalls for a while is late but skips none of them.
    sensors = radar(period_s=3.0, sectors=60, more="receive_beams = 8")
    scene = scene_file(tmp_path, scene_text(start_utc=START, sensors=sensors))
    expected = recorded(tmp_path, "max", 3.0, scene).read_bytes()
    records, errors = decode_lenient(expected)
    assert errors == []
    assert sum(r.category == 34 for r in records) >= 60
    assert sum(r.category == 48 for r in records) >= 1
    paths = [tmp_path / "with-broker", tmp_path / "without"]
    how = ("run", scene, "--duration", 3, "--write")
    with started(*how, paths[0]) as one, started(*how, paths[1], "--broker", "none") as other:
        for session, path in zip((one, other), paths, strict=True):
            session.communicate(PATIENCE_S)
            assert session.wait() == 0
            assert path.read_bytes() == expected


def test_a_full_disk_ends_the_file_and_not_the_session(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(start_utc=START, sensors=FAST))
    done = plotfeed_here("run", scene, *SIMULATED, "60", "--write", "/dev/full")
    assert done.returncode == 1
    assert done.stderr == (
        "plotfeed: /dev/full: No space left on device; what came after is not in the file\n"
    )
    assert done.stdout.splitlines()[-1].startswith("drones 1 ")


def test_show_ends_quietly_when_nobody_reads_on(tmp_path: Path) -> None:
    path = recorded(tmp_path, "raw.ast", 60.0)
    shown = Started("show", path, "--list")
    assert shown.stdout.readline().startswith("CAT034")
    shown.stdout.close()
    assert shown.stderr.read() == ""
    shown.stderr.close()
    assert shown.wait(PATIENCE_S) == 0


def test_show_prints_what_a_broker_has(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST))
    wanted = {"plotfeed/radar/status", "plotfeed/truth", "plotfeed/radar/plots"}
    heard: set[str] = set()
    with running("run", scene) as session:
        url = f"mqtt://127.0.0.1:{session.port('MQTT')}"

        def hears_all() -> bool:
            done = plotfeed_here("show", url, "--count", 50, "--json")
            heard.update(json.loads(line)["topic"] for line in done.stdout.splitlines())
            return heard >= wanted

        done = plotfeed_here("show", f"{url}/plotfeed/+/asterix/#", "--count", "5")
        assert done.returncode == 0
        lines = done.stdout.splitlines()
        assert len(lines) == 5
        assert all(x.startswith("plotfeed/radar/asterix/0") for x in lines)
        done = plotfeed_here("show", f"{url}/plotfeed/truth", "--count", "2", "--json")
        assert all("Ledger" in json.loads(x)["message"] for x in done.stdout.splitlines())
        wait_until(hears_all)
        assert plotfeed_here("show", url, "--duration", "0.1").returncode == 0


def test_show_prints_what_comes_by_udp() -> None:
    port = free_port()
    shown = Started("show", f"udp://127.0.0.1:{port}", "--count", "2")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while shown.poll() is None:  # until it listens, and has enough
            sender.sendto(block_048(43_200) + b"\xca\xfe", ("127.0.0.1", port))
            time.sleep(0.05)
    out, _ = shown.communicate(PATIENCE_S)
    assert shown.wait() == 0
    start = f"udp/127.0.0.1/{port}  CAT048  12:00:00.000  010 SAC=25 SIC=13"
    assert [line.startswith(start) for line in out.splitlines()] == [True, True]


def test_a_broker_that_does_not_answer_is_one_line_and_exit_code_1(tmp_path: Path) -> None:
    flight, scene = tmp_path / "flight.csv", scene_file(tmp_path, scene_text(sensors=FAST))
    rows = "".join(f"{1767268800 + i},40,-3,9\n" for i in range(5))
    flight.write_text(f"time,latitude_deg,longitude_deg,altitude_m\n{rows}")
    nobody = f"mqtt://127.0.0.1:{free_port()}"
    with deaf_server() as port:
        deaf = f"mqtt://127.0.0.1:{port}"
        commands = {
            ("run", scene, "--broker", nobody): nobody,
            ("run", scene, "--broker", deaf): deaf,
            ("show", nobody): nobody,
            ("inject", flight, "--broker", deaf, "--set", "altitude_reference=ellipsoid"): deaf,
        }
        begun = [Started(*command) for command in commands]
        for process, url in zip(begun, commands.values(), strict=True):
            _, err = process.communicate(PATIENCE_S)
            assert process.wait() == 1
            assert is_one_line(err)
            assert url in err
