"""Tables in Parquet hold what the messages say, by pyarrow's own reader."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.command import plotfeed_here
from support.recordings import plots

from plotfeed.models.state import Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.plot_messages import plot_batches
from plotfeed.replay.files import FileFormat, writer_to
from plotfeed.replay.parquet_tables import FIELDS
from plotfeed.replay.recorded import Recorded, TableName

ROOT = Path(__file__).parents[2]
T_NS = 1_700_000_000_123_456_789
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


def message(topic: str, payload: bytes, kind: str = "") -> Recorded:
    content_type = f"application/x-protobuf; messageType=plotfeed.v1.{kind}" if kind else ""
    return Recorded(
        topic=topic,
        payload=payload,
        log_time_ns=T_NS,
        publish_time_ns=T_NS,
        content_type=content_type,
    )


def table(name: TableName, *messages: Recorded) -> tuple[list[dict[str, Any]], list[str | None]]:
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


def test_plots_have_a_column_for_each_measure_and_null_for_what_was_not_told() -> None:
    measured = Plots.of(
        t_utc_ns=np.array([T_NS, T_NS + 1]),
        range_m=np.array([100.25, 200.5]),
        snr=np.array([100.0, np.nan]),
    )
    rows, said = table(
        TableName.PLOTS,
        message(
            "p/radar/plots",
            plot_batches(["radar"], [1], [2], measured, [0, len(measured)])[0],
            "PlotBatch",
        ),
        message("p/radar/plots", b"\xff\xff", "PlotBatch"),
        message("p/radar/status", b"{}"),
    )
    assert said == [None, "no plots", "no plots"]
    assert [row["time_utc"] for row in rows] == [T_NS, T_NS + 1]
    assert [row["range_m"] for row in rows] == [100.25, 200.5]
    assert [row["snr_db"] for row in rows] == [20.0, None]
    assert rows[0]["sensor"] == "radar"
    assert rows[0]["azimuth_deg"] is None
    assert rows[0]["category"] is None


def test_the_ledger_makes_three_tables() -> None:
    ledger = message("p/truth", LEDGER.SerializeToString(), "Ledger")
    (look,), _ = table(TableName.LOOKS, ledger)
    assert (look["sensor"], look["scan"], look["sector"]) == ("radar", 17, 3)
    assert (look["drone"], look["time_utc"], look["pd"], look["detected"]) == (
        "d",
        T_NS,
        0.75,
        True,
    )
    assert look["emitted_utc"] is None
    truths, _ = table(TableName.TRUTHS, ledger)
    assert [truth["drone"] for truth in truths] == ["d", None]
    assert [truth["range_m"] for truth in truths] == [900.0, None]
    assert [truth["merged_drones"] for truth in truths] == [["e"], []]
    (fate,), _ = table(TableName.FATES, ledger)
    assert (fate["fate"], fate["number"], fate["not_to"]) == ("LOST", 4, ["MQTT"])
    assert fate["sent_utc"] is None
    rows, said = table(TableName.FATES, message("p/truth", b"\xff", "Ledger"))
    assert (rows, said) == ([], ["no fates"])


def test_tracks_have_their_sector_and_null_for_what_a_sensor_does_not_estimate() -> None:
    track = pb.Track(id="s-7", number=7, time_utc_ns=T_NS, latitude_deg=40.5, age_s=0.0, last=True)
    batch = pb.TrackBatch(sensor="s", scan=3, sector=1, kind=pb.PLAIN, tracks=[track])
    sent = message("p/s/tracks", batch.SerializeToString(), "TrackBatch")
    (row,), _ = table(TableName.TRACKS, sent)
    expected = {"sensor": "s", "scan": 3, "sector": 1, "kind": "plain", "id": "s-7", "number": 7}
    expected |= {"latitude_deg": 40.5, "age_s": 0.0, "height_m": None, "sigma_up_m": None}
    assert {name: row[name] for name in expected} == expected
    assert (row["coasted"], row["first"], row["last"]) == (False, False, True)
    rows, _ = table(TableName.TRACKS, message("p/truth", batch.SerializeToString(), "Ledger"))
    assert rows == []


def test_messages_are_whole() -> None:
    (row,), _ = table(TableName.MESSAGES, message("a/b", b"\x00\xff"))
    assert (row["topic"], row["payload"], row["octets"]) == ("a/b", b"\x00\xff", 2)
    assert row["content_type"] is None


def test_a_name_says_which_table(tmp_path: Path) -> None:
    source = tmp_path / "in.mcap"
    with source.open("wb") as file:
        writer = writer_to(file, FileFormat.MCAP)
        for each in plots(40):
            writer.write(each)
        writer.close()
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
    options = ("--broker", "none", "--speed", "max", "--duration", "60", "--record", record)
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
