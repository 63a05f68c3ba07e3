from __future__ import annotations

import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from plotfeed.feeds.telemetry import position_report
from plotfeed.feeds.telemetry.position_report import AltitudeDatum, PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference

REPORT = PositionReport(
    t_utc_ns=0,
    latitude_deg=40.0,
    longitude_deg=-3.0,
    altitude_m=100.0,
    altitude_reference=AltitudeReference.ELLIPSOID,
)
ABOVE_TAKEOFF = replace(REPORT, altitude_reference=AltitudeReference.ABOVE_TAKEOFF)
ABOVE_SEA = replace(REPORT, altitude_reference=AltitudeReference.MEAN_SEA_LEVEL)

WITH_GRID = """
import sys
import pyproj
from plotfeed.feeds.telemetry.position_report import egm96_undulation_m
from plotfeed.feeds.telemetry.position_report import Refused
pyproj.datadir.append_data_dir(sys.argv[1])
print(egm96_undulation_m(20.0, 30.0), egm96_undulation_m(-20.0, -30.0))
try:
    egm96_undulation_m(70.0, 0.0)
except Refused as refused:
    print(refused.reason, refused.detail)
assert not pyproj.network.is_network_enabled()
"""


def test_each_reference_gives_a_height_above_the_ellipsoid() -> None:
    datum = AltitudeDatum(takeoff_height_m=650.0, geoid_undulation_m=51.0)
    assert datum.height_m(REPORT) == 100.0
    assert datum.height_m(ABOVE_TAKEOFF) == 750.0
    assert datum.height_m(ABOVE_SEA) == 151.0


def test_without_a_takeoff_height_the_key_is_named() -> None:
    with pytest.raises(Refused, match=r"telemetry\.takeoff_height_m") as caught:
        AltitudeDatum(None, None).height_m(ABOVE_TAKEOFF)
    assert caught.value.reason is Reason.ALTITUDE


def test_without_undulation_or_grid_both_mends_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(position_report, "EGM96_GRIDS", ("no_such_grid.gtx",))
    position_report._egm96.cache_clear()
    try:
        with pytest.raises(Refused, match=r"telemetry\.geoid_undulation_m.*plotfeed\[geoid\]") as e:
            AltitudeDatum().height_m(ABOVE_SEA)
        assert e.value.reason is Reason.ALTITUDE
    finally:
        position_report._egm96.cache_clear()


def test_an_installed_grid_gives_the_undulation(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    # Undulation = latitude + longitude / 2, every 10 degrees from 60 south to 60 north.
    latitudes, longitudes = range(-60, 61, 10), range(-180, 181, 10)
    header = struct.pack(">4d2i", -60, -180, 10, 10, len(latitudes), len(longitudes))
    values = [latitude + longitude / 2 for latitude in latitudes for longitude in longitudes]
    grid = header + struct.pack(f">{len(values)}f", *values)
    (tmp_path / "egm96_15.gtx").write_bytes(grid)
    command = [sys.executable, "-c", WITH_GRID, str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    first, second = run.stdout.splitlines()
    assert [float(v) for v in first.split()] == pytest.approx([35.0, -35.0], abs=1e-6)
    assert second.startswith("altitude the EGM96 grid has no value")
