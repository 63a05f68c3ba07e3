"""`inject` asks the session what became of its reports, and ends with 1 where none arrived."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from support.command import plotfeed, plotfeed_here, running
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.cli.inject import SessionAnswers
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference


def flight_file(folder: Path, latitude_deg: float) -> Path:
    path = folder / "flight.csv"
    rows = [f"{1767268800 + i / 10},{latitude_deg + i * 1e-6},-3.73,700" for i in range(8)]
    path.write_text("\n".join(["time_s,latitude_deg,longitude_deg,altitude_m", *rows]))
    return path


def test_it_says_what_became_of_the_reports(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=radar(period_s=0.5, sectors=8)))
    near, far = flight_file(tmp_path, 40.46), tmp_path / "far.csv"
    far.write_text(near.read_text().replace("40.46", "-33.0"))
    with running("run", scene) as session:
        usual = ("--broker", f"mqtt://127.0.0.1:{session.port('MQTT')}")
        usual += ("--set", "altitude_reference=ellipsoid")
        taken = plotfeed("inject", near, "--now", *usual)
        assert (taken.returncode, taken.stderr) == (0, "")
        assert "session of test: the flight comes to 1.11 km from radar, which sees to 10 km" in (
            taken.stdout
        )
        assert "8 reports sent" in taken.stdout
        old = plotfeed("inject", near, *usual)
        assert old.returncode == 1
        assert "8 refused" in old.stdout
        assert "meanwhile the session refused, of all that came: stale 8" in old.stderr
        elsewhere = plotfeed("inject", far, "--now", *usual)
        assert elsewhere.returncode == 1
        assert "no sensor can see the flight" in elsewhere.stderr
        nobody = plotfeed("inject", near, "--now", *usual, "--prefix", "other")
        assert nobody.returncode == 1
        assert "no session was there" in nobody.stderr


@pytest.mark.parametrize("name", ["a/b", "a+", "#", "x" * 65, "a\nb"])
def test_a_drone_without_a_name_is_refused_before_anything_is_sent(
    name: str, tmp_path: Path
) -> None:
    words = ("--broker", "mqtt://127.0.0.1:1", "--set", "altitude_reference=ellipsoid")
    done = plotfeed_here("inject", flight_file(tmp_path, 40.0), "--drone", name, *words)
    assert done.returncode == 2
    assert "--drone: " in done.stderr
    assert "expected 1 to 64 printable characters" in done.stderr


@pytest.mark.asyncio
async def test_whatever_comes_on_the_topics_is_no_error() -> None:
    answers = SessionAnswers("p", "d")
    for kind in ("errors", "session", "radar/description", "radar/status"):
        for told in (b"", b"{}", b"[]", b"1", b"\xff", b"[" * 100_000, b'{"sensor": {}}'):
            answers.hear(f"p/{kind}", told, None)
    assert answers.scene is None
    assert answers.nearest([]) is None
    await asyncio.wait_for(answers.end(), 1.0)


def test_the_nearest_sensor_is_the_one_whose_range_is_entered_deepest() -> None:
    async def answered() -> SessionAnswers:
        return SessionAnswers("p", "d")

    answers = asyncio.run(answered())
    for name, latitude_deg, range_m in (("short", 40.0, 100.0), ("long", 40.02, 9000.0)):
        place = {"latitude_deg": latitude_deg, "longitude_deg": 3.0, "height_m": 100.0}
        told = {"sensor": name, "range_max_m": range_m, **place}
        answers.hear(f"p/{name}/description", json.dumps(told).encode(), None)
    report = PositionReport(
        t_utc_ns=1,
        latitude_deg=40.01,
        longitude_deg=3.0,
        altitude_m=0.0,
        altitude_reference=AltitudeReference.ABOVE_TAKEOFF,
    )
    sensor, near_m, sees_m, hindrance = answers.nearest([report]) or ("", 0.0, 0.0, None)
    assert (sensor, sees_m, hindrance) == ("long", 9000.0, None)
    assert near_m == pytest.approx(1110.4, abs=2.0)
