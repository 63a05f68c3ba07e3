"""What the README prints and has somebody type, beside a demo that runs."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import paho
import pytest
from support.asterix_readers import asterix_decoder
from support.command import Running, plotfeed, plotfeed_here, running
from support.waiting import first_lines

README = (Path(__file__).parents[1] / "README.md").read_text()
PORT = re.compile(r":\d{4,5}(?: \(.*?\))?")
SITE = '[scene]\nname = "here"\nseed = 1\n[scene.site]\n' + (
    "latitude_deg = 40.0\nlongitude_deg = -3.0\nheight_m = 600.0\n"
)


@pytest.fixture(scope="module")
def demo() -> Iterator[Running]:
    with running("demo") as session:
        yield session


def block_with(text: str) -> list[str]:
    """The lines of the indented block that begins with that text."""
    lines = README.split("\n")
    start = next(n for n, line in enumerate(lines) if line.startswith(f"    {text}"))
    end = next(n for n in range(start, len(lines)) if not lines[n].startswith("    "))
    return [line[4:] for line in lines[start:end]]


def test_a_demo_introduces_itself_as_printed(demo: Running) -> None:
    printed = [PORT.sub(":PORT", line) for line in block_with("scene ")]
    # Another program may have the page's usual port: a line before the first says so.
    said = [PORT.sub(":PORT", line) for line in demo.introduction if "is taken: the" not in line]
    gap = printed.index("  ...")
    assert said[:gap] == printed[:gap]
    assert said[gap - len(printed) + 1 :] == printed[gap + 1 :]


def test_the_client_that_is_printed_hears_records(demo: Running, tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert '"127.0.0.1", 1883' in code
    client = tmp_path / "client.py"
    client.write_text(code.replace("1883", str(demo.port("MQTT"))))
    # With asterix-decoder and paho alone: libasterix, which is beside paho, has its name.
    (tmp_path / "paho").symlink_to(Path(paho.__path__[0]), target_is_directory=True)
    command = [asterix_decoder(), "-u", client]
    (line,) = first_lines(command, 1, PYTHONPATH=str(tmp_path))
    assert re.match(r"\{'category': (34|48|62|63), ", line)


def test_show_prints_plots_as_printed(demo: Running) -> None:
    typed, printed = block_with("$ .venv/bin/plotfeed show")
    source = typed.split()[-1].replace(":1883/", f":{demo.port('MQTT')}/")
    shown = plotfeed("show", source, "--count", "1").stdout
    number = re.compile(r"-?\d[\d.:]*")
    assert number.sub("N", shown.strip()) == number.sub("N", printed)


def test_the_sensor_that_is_printed_is_sound(tmp_path: Path) -> None:
    (sensor,) = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)
    scene = tmp_path / "here.toml"
    scene.write_text(SITE + sensor)
    done = plotfeed_here("check", scene)
    assert (done.returncode, done.stderr) == (0, "")
