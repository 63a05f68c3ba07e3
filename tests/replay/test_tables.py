"""Tables in CSV and in Parquet hold what the messages say, by readers of others."""

from __future__ import annotations

import csv
import io
import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.asterix_input import plots as plots_of
from support.command import plotfeed_here
from support.recordings import START_NS, block, block_048, message, plots, stored, written

from plotfeed.models.state import Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat015 import Geometry, PlotEncoder015
from plotfeed.proto.asterix.cat048 import PlotEncoder048
from plotfeed.proto.asterix.cat205 import BearingEncoder205
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.files import FileFormat, writer_to
from plotfeed.replay.parquet_tables import FIELDS
from plotfeed.replay.plots_csv import COLUMNS, PlotsCsvWriter, plots_in
from plotfeed.replay.recorded import Recorded, TableName

ROOT = Path(__file__).parents[2]
T_NS = START_NS + 500_000_000


def of_kind(kind: str, payload: bytes, topic: str = "p/truth") -> Recorded:
    content_type = f"application/x-protobuf; messageType=plotfeed.v1.{kind}"
    return message(payload, topic=topic, content_type=content_type)


def in_parquet(name: TableName, *messages: Recorded) -> tuple[list[dict[str, Any]], list[Any]]:
    """Rows of a table, times in ns, and what was said to each message."""
    file = io.BytesIO()
    writer = writer_to(file, FileFormat.PARQUET, name)
    said = [writer.write(each) for each in messages]
    writer.close()
    found = pq.read_table(io.BytesIO(file.getvalue()))
    assert found.column_names == list(FIELDS[name])
    rows: list[dict[str, Any]] = [{} for _ in range(found.num_rows)]
    for column in found.column_names:
        values = found[column]
        if "timestamp" in str(values.type):
            values = values.cast("int64")
        for row, value in zip(rows, values.to_pylist(), strict=True):
            row[column] = value
    return rows, said


def as_csv(column: str, value: Any) -> str:
    if value is None:
        return ""
    if column == "time_utc":
        return iso_utc(value)
    return f"{value:03d}" if column == "category" else str(value)


def table(*messages: Recorded) -> list[dict[str, str]]:
    """Rows of plots in CSV, which Parquet has as well."""
    text = written(PlotsCsvWriter, list(messages)).decode()
    rows = list(csv.DictReader(io.StringIO(text)))
    others, _ = in_parquet(TableName.PLOTS, *messages)
    assert rows == [{name: as_csv(name, row[name]) for name in COLUMNS} for row in others]
    return rows


def asterix(payload: bytes, category: int) -> Recorded:
    return message(
        payload,
        START_NS + 600_000_000,
        topic=f"plotfeed/north/asterix/{category:03d}",
        content_type=f"application/x-asterix; cat={category}",
    )


def two_plots(**more: Any) -> Plots:
    return plots_of(
        t_utc_ns=np.array([T_NS, T_NS + 1_000_000_000]),
        range_m=np.array([2000.0, 3000.0]),
        azimuth_deg=np.array([45.0, 90.0]),
        **more,
    )


def number(row: dict[str, str], column: str) -> float:
    return float(row[column] or math.nan)


def assert_row(row: Mapping[str, Any], **expected: Any) -> None:
    assert {name: row[name] for name in expected} == expected


def test_a_batch_of_ours_is_a_row_for_each_plot_with_what_was_measured() -> None:
    batch = pb.PlotBatch(sensor="north", scan=3)
    batch.plots.add(time_utc_ns=T_NS, range_m=1234.5, azimuth_deg=0.0, snr_db=-1.0, channel=2)
    batch.plots.add(time_utc_ns=T_NS + 1, bistatic_range_m=7.0, kind="drone", identity='a,"b"\nc')
    batch.plots[1].range_rate_m_s = -3.5
    topic = "plotfeed/north/plots"
    rows = table(of_kind("PlotBatch", batch.SerializeToString(), topic))
    first, second = rows
    assert_row(first, sensor="north", time_utc="2026-01-01T12:00:00.500000000Z", topic=topic)
    assert_row(second, sensor="north", time_utc="2026-01-01T12:00:00.500000001Z", topic=topic)
    assert_row(first, range_m="1234.5", azimuth_deg="0.0", snr_db="-1.0", channel="2")
    assert_row(first, elevation_deg="", doppler_m_s="")
    assert_row(second, range_m="", bistatic_range_m="7.0", doppler_m_s="-3.5")
    assert_row(second, kind="drone", identity='a,"b"\nc')


def test_plots_of_048_are_in_metres() -> None:
    (payload,) = PlotEncoder048(25, 13).blocks(two_plots(height_m=304.8, amplitude_dbm=-60.0))
    rows = table(asterix(payload, 48))
    assert [row["time_utc"] for row in rows] == [
        "2026-01-01T12:00:00.500000000Z",
        "2026-01-01T12:00:01.500000000Z",
    ]
    assert [number(row, "range_m") for row in rows] == pytest.approx([2000, 3000], abs=3.7)
    assert [number(row, "azimuth_deg") for row in rows] == [45.0, 90.0]
    assert [number(row, "altitude_m") for row in rows] == pytest.approx([304.8, 304.8])
    expected = {"height_m": "", "amplitude_dbm": "-60.0", "sensor": "north", "category": "048"}
    assert_row(rows[0], **expected, sac="25", sic="13")


@pytest.mark.parametrize("geometry", [Geometry.MONOSTATIC, Geometry.MULTISTATIC])
def test_plots_of_015_have_their_range_in_the_column_of_its_kind(geometry: Geometry) -> None:
    kind, other = "range_m", "bistatic_range_m"
    measured: dict[str, Any] = {"elevation_deg": 7.0, "snr": 10.0}
    if geometry is Geometry.MULTISTATIC:
        kind, other = other, kind
        measured[kind] = np.array([2000.0, 3000.0])
    given_plots = two_plots(**measured, **{f"sigma_{kind}": 2.5})
    (payload,) = PlotEncoder015(25, 14, geometry=geometry).blocks(given_plots)
    rows = table(asterix(payload, 15))
    assert [number(row, kind) for row in rows] == pytest.approx([2000, 3000])
    assert number(rows[0], f"sigma_{kind}") == pytest.approx(2.6)
    assert number(rows[0], "elevation_deg") == pytest.approx(7.0, abs=0.003)
    assert_row(rows[0], **{other: ""}, snr_db="10.0", sic="14")


def test_bearings_of_205_have_no_range_and_records_that_are_no_plots_are_no_rows() -> None:
    encoder = BearingEncoder205(25, 15, latitude_deg=40.0, longitude_deg=-3.0)
    rows = table(*(asterix(payload, 205) for payload in encoder.blocks(two_plots(), T_NS)))
    assert [(number(row, "azimuth_deg"), row["range_m"]) for row in rows] == [(45, ""), (90, "")]
    assert table(asterix(block(15, "c0", "190d", "04"), 15)) == []
    assert table(asterix(block(205, "a0", "190d", "01"), 205)) == []


def test_times_of_day_are_those_nearest_to_the_message() -> None:
    midnight_ns = START_NS + 43_200_000_000_000
    early = message(block_048(1), midnight_ns - 1)
    late = message(block_048(86_399), midnight_ns + 1)
    assert [row["time_utc"] for row in table(early, late)] == [
        "2026-01-02T00:00:01.000000000Z",
        "2026-01-01T23:59:59.000000000Z",
    ]


@pytest.mark.parametrize(
    "other",
    [
        asterix(block(34, "e0", "190d", "01", "000080"), 34),
        asterix(b"\x30\0", 48),
        message(b"{}", content_type="application/json", topic="plotfeed/errors"),
        of_kind("PlotBatch", b"\xff", "plotfeed/north/plots"),
        of_kind("Ledger", b""),
    ],
)
def test_what_holds_no_plots_is_told(other: Recorded) -> None:
    file = io.BytesIO()
    writer = PlotsCsvWriter(file)
    assert writer.write(other) == "no plots"
    assert file.getvalue().decode() == ",".join(COLUMNS) + "\n"
    assert in_parquet(TableName.PLOTS, other) == ([], ["no plots"])


@given(
    st.binary(max_size=60),
    st.sampled_from(["application/x-asterix", of_kind("PlotBatch", b"").content_type, ""]),
    st.sampled_from(["a/plots", "a/asterix/048", ""]),
    st.integers(0, (1 << 64) - 1),
)
def test_any_octets_are_rows_or_none(
    payload: bytes, content_type: str, topic: str, t_ns: int
) -> None:
    one = message(payload, t_ns, content_type=content_type, topic=topic)
    if plots_in(one) is not None:
        text = written(PlotsCsvWriter, [one]).decode()
        assert all(set(row) == set(COLUMNS) for row in csv.DictReader(io.StringIO(text)))


def test_what_transponders_say_and_tracks_of_062_have_their_columns() -> None:
    payload = block(
        48,
        *("ffd0", "190d", "000000", "a0", "80004000", "0fff", "0578", "20c8"),
        *("3c660c", "10c236d41820", "0102"),
    )
    (row,) = table(asterix(payload, 48))
    said = {"mode_3a": "7777", "ssr_amplitude_dbm": "-56.0", "address": "3C660C", "track": "258"}
    assert_row(row, flight_level="350.0", identity="DLH65A  ", amplitude_dbm="", **said)
    payload = block(
        62,
        *("9f0d20", "190d", "0c8000", "00800000", "ff800000", "0007d0", "fff830", "0040ffc0"),
        *("01f4", "00", "0578"),
    )
    (row,) = table(asterix(payload, 62))
    assert row["time_utc"].endswith("T01:46:40.000000000Z")
    place = {"latitude_deg": "45.0", "longitude_deg": "-45.0", "east_m": "1000.0"}
    moves = {"north_m": "-1000.0", "velocity_east_m_s": "16.0", "velocity_north_m_s": "-16.0"}
    assert_row(row, **place, **moves, track="500", flight_level="350.0", category="062")


LEDGER = pb.Ledger(
    sensor="radar",
    scan=17,
    sector=3,
    looks=[pb.Look(drone="d", time_utc_ns=T_NS, range_m=900.0, pd=0.75, detected=True)],
    plots=[
        pb.PlotTruth(drone="d", time_utc_ns=T_NS, range_m=900.0, merged_drones=["e"]),
        pb.PlotTruth(time_utc_ns=T_NS + 1),
    ],
    messages=[
        pb.Sent(topic="t", due_utc_ns=T_NS, fate=pb.LOST, number=4, octets=9, not_to=["MQTT"])
    ],
)


def test_the_ledger_makes_three_tables() -> None:
    ledger = of_kind("Ledger", LEDGER.SerializeToString())
    (look,), _ = in_parquet(TableName.LOOKS, ledger)
    assert_row(look, sensor="radar", scan=17, sector=3, emitted_utc=None)
    assert_row(look, drone="d", time_utc=T_NS, pd=0.75, detected=True)
    (truth, alarm), _ = in_parquet(TableName.TRUTHS, ledger)
    assert_row(truth, drone="d", range_m=900.0, merged_drones=["e"])
    assert_row(alarm, drone=None, range_m=None, merged_drones=[])
    (fate,), _ = in_parquet(TableName.FATES, ledger)
    assert_row(fate, fate="LOST", number=4, not_to=["MQTT"], sent_utc=None)
    assert in_parquet(TableName.FATES, of_kind("Ledger", b"\xff")) == ([], ["no fates"])


def test_tracks_have_their_sector_and_null_for_what_a_sensor_does_not_estimate() -> None:
    track = pb.Track(id="s-7", number=7, time_utc_ns=T_NS, latitude_deg=40.5, age_s=0.0, last=True)
    batch = pb.TrackBatch(sensor="s", scan=3, sector=1, kind=pb.PLAIN, tracks=[track])
    sent = of_kind("TrackBatch", batch.SerializeToString(), "p/s/tracks")
    (row,), _ = in_parquet(TableName.TRACKS, sent)
    assert_row(row, sensor="s", scan=3, sector=1, kind="plain", id="s-7", number=7)
    assert_row(row, latitude_deg=40.5, age_s=0.0, height_m=None, sigma_up_m=None)
    assert_row(row, coasted=False, first=False, last=True)
    rows, _ = in_parquet(TableName.TRACKS, of_kind("Ledger", batch.SerializeToString()))
    assert rows == []
    (row,), _ = in_parquet(TableName.MESSAGES, message(b"\x00\xff", topic="a/b", content_type=""))
    assert_row(row, topic="a/b", payload=b"\x00\xff", octets=2, content_type=None)


def test_a_name_says_which_table(tmp_path: Path) -> None:
    source = stored(tmp_path / "in.mcap", plots(40))
    for name, expected in (
        ("any.parquet", TableName.PLOTS),
        ("here-messages.parquet", TableName.MESSAGES),
        ("other.asterix-048.parquet", TableName.ASTERIX_048),
    ):
        done = plotfeed_here("convert", source, tmp_path / name)
        assert done.returncode == 0, done.stderr
        assert pq.read_schema(tmp_path / name).names == list(FIELDS[expected])
    wrong = plotfeed_here("convert", source, tmp_path / "x-fates.parquet")
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
    assert "40 left out: no fates" in wrong.stderr
    gone = plotfeed_here("convert", source, tmp_path / "x.parquet", "--table", "fates")
    assert "the end of OUT's name" in gone.stderr
    read = plotfeed_here("convert", tmp_path / "any.parquet", tmp_path / "back.mcap")
    assert read.returncode == 2
    assert "parquet" in read.stderr


def test_without_pyarrow_one_line_names_the_extra(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['pyarrow'] = None\n"
        "import io\n"
        "from plotfeed.replay.files import FileFormat, writer_to\n"
        "from plotfeed.proto.errors import PlotfeedError\n"
        "try:\n    writer_to(io.BytesIO(), FileFormat.PARQUET)\n"
        "except PlotfeedError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "Parquet needs pyarrow: pip install 'plotfeed[parquet]'\n"


def test_pandas_and_duckdb_read_them_as_the_example_does(tmp_path: Path) -> None:
    python = ROOT / ".venv-tables" / "bin" / "python"
    if not python.exists():
        pytest.skip("pandas and DuckDB are not installed: make .venv-tables/.ready")
    record, scene = tmp_path / "radar.mcap", ROOT / "examples" / "scenes" / "radar-udp.toml"
    options = ("--broker", "none", "--speed", "max", "--duration", "30", "--record", record)
    assert plotfeed_here("run", scene, *options).returncode == 0
    for name in ("plots", "truths", "looks"):
        done = plotfeed_here("convert", record, tmp_path / f"radar-{name}.parquet")
        assert done.returncode == 0
    program = str(ROOT / "examples" / "read_parquet.py")
    done = subprocess.run(
        [str(python), program, str(tmp_path / "radar")], capture_output=True, text=True, check=True
    )
    first, second = done.stdout.splitlines()
    detected, looks = (int(word) for word in first.split()[1:4:2])
    assert first.startswith("visitor: ")
    assert 0 < detected <= looks
    plots_of_it, sigma_m = int(second.split()[1]), float(second.split()[5])
    assert plots_of_it == detected
    assert 0.1 < sigma_m < 5.0
