"""Plots of birds and clutter are no false alarms to a report, and its verdicts stay right."""

from __future__ import annotations

import json
from pathlib import Path

from support.command import plotfeed_here
from support.scene_files import radar, scene_file, scene_text

OTHERS = """
[[birds]]
id = "gulls"
count = 5
rcs_m2 = 0.01
path = [
    { east_m = 800.0, north_m = 1500.0, above_site_m = 80.0 },
    { east_m = -900.0, north_m = 1500.0, above_site_m = 80.0 },
]

[[clutter]]
id = "woods"
plots_per_km2 = 20.0
area = [
    { east_m = -1500.0, north_m = -500.0, above_site_m = 0.0 },
    { east_m = 1500.0, north_m = -500.0, above_site_m = 0.0 },
    { east_m = 1500.0, north_m = -2000.0, above_site_m = 0.0 },
]
"""


def test_a_report_counts_birds_as_looks_and_clutter_as_neither(tmp_path: Path) -> None:
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=radar(), port=1883) + OTHERS
    path, record = scene_file(tmp_path, text), tmp_path / "there.mcap"
    run = ("run", path, "--speed", "max", "--broker", "none", "--json", "--duration", "20")
    done = plotfeed_here(*run, "--record", record)
    assert done.returncode == 0, done.stderr
    told = plotfeed_here("report", record, "--json")
    assert told.returncode == 0, told.stdout + told.stderr
    report = json.loads(told.stdout)
    (sensor,) = report["sensors"]
    assert set(sensor["plots_of_others"]) == {"bird", "clutter"}
    assert sensor["plots_of_others"]["clutter"] > 100
    assert sensor["plots_of_others"]["bird"] > 20
    checks = {check["check"]: check for check in report["verdicts"]["checks"]}
    alarms = checks["false alarms"]
    assert alarms["p"] is not None
    assert alarms["found"] < 3 * alarms["asked"] + 0.5  # of 40 scans
    assert checks["Pd"]["of"] > 200
    assert report["verdicts"]["wrong"] == []
    text = plotfeed_here("report", record).stdout
    assert "plots of no drone and no false alarms" in text
    listed = plotfeed_here("show", record, "--list", "--topic", "plotfeed/truth").stdout
    assert "of clutter/woods" in listed
    assert "of bird/gulls-" in listed
