"""Tracks beside flights of a trial: logs of drones, or what another tracker recorded."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.command import plotfeed_here
from support.recordings import START_NS
from support.scored_flights import APART, NS, SITE, Flight
from support.told_tracks import told_tracks

from plotfeed.feeds.lab.flights import read_trial
from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.content_types import asterix_content_type
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.asterix_files import RawWriter
from plotfeed.replay.recorded import Recorded

FLIGHT = APART["a"]


def rows_of(flight: Flight, late_s: float = 0.0, sigma_m: float = 0.0) -> list[str]:
    """Time and place each second, as wrong as that, by a clock that is late."""
    rng, rows = np.random.default_rng(1), []
    for second in range(61):
        place = SITE.to_geodetic(flight.at(second) + sigma_m * rng.standard_normal(3))
        latitude_deg, longitude_deg, height_m = map(float, place)
        time = iso_utc(START_NS + round((second + late_s) * NS))
        rows.append(f"{time},{latitude_deg:.9f},{longitude_deg:.9f},{height_m:.3f}")
    return rows


def log_of(path: Path, flight: Flight = FLIGHT) -> Path:
    """As a table of a drone's own log."""
    head = "time,latitude,longitude,altitude_ellipsoid_m"
    path.write_text("\n".join([head, *rows_of(flight)]) + "\n")
    return path


def tracks_of(path: Path, late_s: float = 0.0, **flights: Flight) -> Path:
    """A tracker's table, whose clock is late by that, of flights by its names for them."""
    rows = ["track,time_utc,latitude_deg,longitude_deg,height_m"]
    for name, flight in (flights or {"1": FLIGHT}).items():
        rows += [f"{name},{row}" for row in rows_of(flight, late_s, 2.0)]
    path.write_text("\n".join(rows) + "\n")
    return path


def test_logs_are_drones_of_their_own_and_what_is_none_is_refused_in_a_line(tmp_path: Path) -> None:
    paths = [tmp_path / folder / "uav.csv" for folder in ("one", "two", "three")]
    for path in paths:
        path.parent.mkdir()
        log_of(path)
    assert read_trial(paths).drones == ["uav", "uav uav", "uav uav uav"]
    paths[0].write_text("a,b\n1,2\n")
    with pytest.raises(PlotfeedError) as refused:
        read_trial(paths)
    assert "\n" not in str(refused.value)


def test_a_log_of_a_drone_is_the_truth_and_the_clock_is_found(tmp_path: Path) -> None:
    turning = Flight((1000.0, 500.0, 100.0), (12.0, -5.0, 0.0))
    log = log_of(tmp_path / "uav.csv", turning)
    tracks = tracks_of(tmp_path / "t.csv", 2.6, mine=turning)
    done = plotfeed_here("score", tracks, "--truth", log, "--json")
    told = json.loads(done.stdout)
    assert [each["drone"] for each in told["drones"]] == ["uav"]
    assert told["figures"]["position_rms_m"] > 30.0
    (finding,) = told["findings"]
    assert finding.startswith(("times are 2.6", "times are 2.5"))
    assert told["figures_without"]["position_rms_m"] < 4.0
    assert told["possible"] is None
    assert told["figures"]["latency_p50_s"] is None


def test_tracks_of_another_tracker_are_the_truth_too(tmp_path: Path) -> None:
    """Of two drones, one of which nobody follows."""
    reference = tracks_of(tmp_path / "reference.csv", **APART)
    words = ("score", tracks_of(tmp_path / "t.csv"), "--truth", reference, "--json")
    told = json.loads(plotfeed_here(*words).stdout)
    assert [each["drone"] for each in told["drones"]] == ["a", "b"]
    assert [each["completeness"] > 0.9 for each in told["drones"]] == [True, False]
    done = plotfeed_here(*words, "--set", 'leave_out=["b"]')
    assert json.loads(done.stdout)["figures"]["completeness"] > 0.9


def test_raw_asterix_of_a_reference_is_of_the_day_of_the_tracks(tmp_path: Path) -> None:
    reference = tmp_path / "reference.ast"
    one = told_tracks(1, np.random.default_rng(1))
    with reference.open("wb") as file:
        writer = RawWriter(file)
        for second in range(61):
            latitude_deg, longitude_deg, height_m = SITE.to_geodetic(FLIGHT.at(second)[None])
            t_ns = START_NS + second * NS
            told = one.but(t_utc_ns=np.array([t_ns]), track=np.array([7]), height_m=height_m,
                           latitude_deg=latitude_deg, longitude_deg=longitude_deg,
                           last=np.array([False]))  # fmt: skip
            (block,) = TrackEncoder062(25, 10).blocks(told)
            writer.write(
                Recorded(topic="x", payload=block, log_time_ns=t_ns, publish_time_ns=t_ns,
                         content_type=asterix_content_type(62))
            )  # fmt: skip
        writer.close()
    done = plotfeed_here("score", tracks_of(tmp_path / "t.csv"), "--truth", reference, "--json")
    told_score = json.loads(done.stdout)
    assert [each["drone"] for each in told_score["drones"]] == ["25.10.7"]
    assert told_score["figures"]["completeness"] > 0.95
    assert told_score["figures"]["position_rms_m"] < 6.0


@pytest.mark.parametrize("suffix", [".csv", ".tsv"])
def test_of_a_truth_without_heights_nothing_is_told_in_space(tmp_path: Path, suffix: str) -> None:
    """Nor that the tracker's are wrong; and what has no place is counted, and spoils nothing."""
    delimiter = "," if suffix == ".csv" else "\t"
    rows = [row.split(",")[:4] for row in tracks_of(tmp_path / "x.csv").read_text().splitlines()]
    rows[30][2], rows[31][2] = "200.0", "north"
    reference = tmp_path / f"reference{suffix}"
    reference.write_text("".join(delimiter.join(row) + "\n" for row in rows))
    words = ["score", tracks_of(tmp_path / "t.csv"), "--truth", reference, "--json"]
    told = json.loads(plotfeed_here(*words).stdout)
    assert told["findings"] == []
    assert told["figures"]["completeness"] > 0.95
    for name in ("space_gospa_m", "height_rms_m", "bias_up_m"):
        assert told["figures"][name] is None
    assert told["notes"][:2] == [
        f"reference{suffix}: 2 places of the truth cannot be used",
        f"reference{suffix} does not tell all heights: nothing is told in space",
    ]
    done = plotfeed_here(*words, "--set", "dimensions=3")
    assert done.returncode == 2
    assert "dimensions = 3: the truth tells no heights" in done.stderr
