"""The command as a user types it: what it prints, its exit codes, and what it says of mistakes."""

from __future__ import annotations

import json
import os
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
from support.command import PLOTFEED, Started, plotfeed, plotfeed_here, running
from support.recordings import block_048, plots, written
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until

from plotfeed.replay.mcap import McapWriter
from plotfeed.testing import MqttReceiver

FAST = radar(period_s=0.2, sectors=8)
START = "2026-01-01T12:00:00.05Z"
SIMULATED = ("--broker", "none", "--speed", "max", "--duration")


def is_one_line(text: str) -> bool:
    return len(text.splitlines()) == 1 and text.startswith("plotfeed: ")


def test_the_entry_point_is_the_command() -> None:
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    assert project["scripts"] == {"plotfeed": "plotfeed.feeds.cli.__main__:main"}
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


def test_what_is_not_there_or_unreadable_is_one_line_each(tmp_path: Path) -> None:
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


def ended(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """As a user starts it, with what that takes."""
    return subprocess.run(
        list(map(str, words)),
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def test_a_signal_while_it_starts_is_no_traceback(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST))
    for delay_s in (0.0, 0.3):
        process = subprocess.Popen(
            [*PLOTFEED, "run", str(scene)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        time.sleep(delay_s)
        process.terminate()
        _, err = process.communicate(timeout=PATIENCE_S)
        assert b"Traceback" not in err
    for module in ("click", "numpy"):  # Ctrl-C while it is imported
        path = tmp_path / f"{module}.py"
        path.write_text("raise KeyboardInterrupt")
        done = ended(*PLOTFEED, "demo", "--duration", "1", PYTHONPATH=str(tmp_path))
        assert (done.returncode, done.stdout, done.stderr.strip()) == (130, "", "")
        path.unlink()


FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_a_full_disk_is_told_with_the_name_of_the_file_and_leaves_nothing(tmp_path: Path) -> None:
    source, target = tmp_path / "in.mcap", tmp_path / "out.jsonl"
    source.write_bytes(written(McapWriter, plots(1000)))
    scene = scene_file(tmp_path, scene_text(sensors=FAST))
    for words, more in (
        (("convert", source, FULL, "--to", "jsonl"), ""),
        (("convert", source, FULL, "--to", "mcap"), ""),
        (("run", scene, *SIMULATED, "1", "--json", "--record", FULL, "--force"), ""),
        (
            ("run", scene, *SIMULATED, "60", "--write", FULL),
            "; what came after is not in the file\n",  # and the session goes on
        ),
    ):
        done = plotfeed_here(*words)
        assert done.returncode == 1
        assert f"{FULL}: No space left on device{more}" in done.stderr
    assert done.stdout.splitlines()[-1].startswith("drones 1 ")
    with FULL.open("w") as full:
        words = [*PLOTFEED, "schema", "messages"]
        out = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert out.returncode == 1
    assert out.stderr == "plotfeed: standard output: No space left on device\n"
    code = (
        "import resource, sys\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))\n"
        "from plotfeed.feeds.cli.main import main\n"
        "main()"
    )
    done = ended(sys.executable, "-c", code, "convert", source, target)
    assert (done.returncode, done.stderr) == (1, f"plotfeed: {target}: File too large\n")
    assert not target.exists()


def test_without_a_broker_no_topic_is_listed(tmp_path: Path) -> None:
    done = plotfeed_here("run", scene_file(tmp_path, scene_text()), *SIMULATED, "1")
    assert "plotfeed/" not in done.stdout
    assert "  MQTT        none, so no topics" in done.stdout


def test_shells_complete_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    for shell in ("bash", "zsh", "fish"):
        monkeypatch.setenv("COMP_WORDS", "plotfeed re")
        monkeypatch.setenv("COMP_CWORD", "re" if shell == "fish" else "1")
        for how, said in (("source", "plotfeed"), ("complete", "record")):
            monkeypatch.setenv("_PLOTFEED_COMPLETE", f"{shell}_{how}")
            done = plotfeed_here()
            assert said in done.stdout
            assert done.stderr == ""


def test_show_ends_quietly_when_nobody_reads_on(tmp_path: Path) -> None:
    path, scene = tmp_path / "raw.ast", scene_file(tmp_path, scene_text(sensors=FAST))
    assert plotfeed_here("run", scene, *SIMULATED, "60", "--write", path).returncode == 0
    shown = Started("show", path, "--list")
    assert shown.stdout.readline().startswith("CAT0")
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


def test_a_broker_that_does_not_answer_is_one_line_and_exit_code_1(
    tmp_path: Path, flight: Path
) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST))
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
