"""`plotfeed report` as a user has it: tables, JSON and a chart of the same figures, clear lines."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.command import plotfeed_here
from support.ledgers import entries, recorded, told, written
from support.links import link
from support.recordings import mcap_of

from plotfeed.feeds.lab.report import lines, print_report
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError

Capture = pytest.CaptureFixture[str]
LOSSY = {
    "latency_ms": 100.0,
    "jitter_ms": 10.0,
    "loss": {"kind": "gilbert-elliott", "mean_loss": 0.2, "mean_burst": 3.0},
    "duplicate": 0.1,
    "corrupt": 0.1,
}


def looked() -> list[pb.Ledger]:
    """Messages on a lossy link, with looks and false alarms."""
    ledgers = entries(link(**LOSSY), 2000)
    for n, entry in enumerate(ledgers):
        detected = n % 3 > 0
        entry.looks.add(drone="d", range_m=1000.0 + 10 * n, pd=0.7, detected=detected)
        if detected:
            entry.plots.add(drone="d", time_utc_ns=n, range_m=1000.0 + 10 * n)
        entry.plots.add(time_utc_ns=n)
    return ledgers


@pytest.fixture(scope="module")
def ledger_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("report") / "there.mcap", recorded(looked()))


def printed(path: Path, capsys: Capture, **options: Any) -> tuple[int, str, str]:
    code = print_report(path, **{"as_json": False, "chart": None, **options})
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def cells_under(text: str, title: str, row: int = 0) -> list[str]:
    """Of a table's row, without what names it."""
    after = text.split(f"\n{title}", 1)[1].splitlines()
    header = next(i for i, line in enumerate(after) if line.startswith("  sensor"))
    return after[header + 1 + row].split()


def test_tables_and_json_tell_the_same(ledger_file: Path, capsys: Capture) -> None:
    code, text, _ = printed(ledger_file, capsys)
    assert code == 0
    found = json.loads(printed(ledger_file, capsys, as_json=True)[1])
    (only,), (sensor,) = found["links"], found["sensors"]
    assert only["link"] == LOSSY
    assert only["first_utc"] == found["first_utc"] == "2023-11-14T22:13:20.000000000Z"
    assert {len(only[of]["curve_ms"]) for of in ("asked", "delivered")} == {len(found["curve"])}
    assert sum(only["bursts"]["lengths"].values()) == only["bursts"]["bursts"]
    assert sum(at["looks"] for at in sensor["looks_by_range"]) == 500
    assert set(found["verdicts"]["checks"][0]) >= {"sensor", "link", "check", "asked", "found", "p"}
    times = ("mean_ms", "p50_ms", "p90_ms", "p99_ms", "max_ms")
    asked = [f"{only['asked'][name]:.3f}" for name in times]
    delivered = [f"{only['delivered'][name]:.3f}" for name in times]
    fit = [f"{only['fit']['distance']:.4f}", f"{only['fit']['p_value']:.2g}"]
    assert cells_under(text, "Delay") == ["radar", "1", "asked", *asked]
    assert cells_under(text, "Delay", 1) == ["delivered", str(only["sent"]), *delivered, *fit]
    loss, bursts = only["loss"], only["bursts"]
    assert cells_under(text, "Loss") == [
        *("radar", "1", str(loss["of"]), str(loss["count"])),
        *(f"{100 * loss['asked']:.2f}", f"{100 * loss['delivered']:.2f}", f"{loss['z']:+.1f}"),
        *(str(bursts["bursts"]), f"{bursts['asked_mean']:.3f}"),
        *(f"{bursts['delivered_mean']:.3f}", f"{bursts['z']:+.1f}"),
    ]


def test_a_chart_is_drawn_and_the_same_again(
    ledger_file: Path, tmp_path: Path, capsys: Capture
) -> None:
    for suffix in ("png", "svg", "pdf"):
        one, other = (tmp_path / f"{name}.{suffix}" for name in "ab")
        for chart in (one, other):
            assert printed(ledger_file, capsys, chart=chart)[0] == 0
        assert one.read_bytes() == other.read_bytes()
        assert one.stat().st_size > 10_000


def test_a_chart_of_nothing_and_one_of_many_links_are_drawn(
    tmp_path: Path, capsys: Capture
) -> None:
    empty = written(tmp_path / "e.mcap", recorded([pb.Ledger(sensor="r$a")]))
    assert printed(empty, capsys, chart=tmp_path / "e.png")[0] == 0
    ledgers = entries(link(latency_ms=1.0), 200)
    for n, entry in enumerate(ledgers):
        entry.sensor = f"$s{n % 13}"
        for one in entry.messages:
            one.number //= 13
    many = written(tmp_path / "m.mcap", recorded(ledgers))
    assert printed(many, capsys, chart=tmp_path / "m.svg")[0] == 0
    assert "and 5 more, not drawn" in (tmp_path / "m.svg").read_text()


def test_what_cannot_be_used_is_noted_and_names_cannot_move_the_cursor(tmp_path: Path) -> None:
    ledgers = looked()[:10]
    for entry in ledgers:
        entry.sensor = "ra\x1b[2Jdar"
        entry.link = '{"\\u001b[2J": 1}'
    path = tmp_path / "a.mcap"  # with the attachments of a session, and not its scene
    path.write_bytes(mcap_of(recorded([*ledgers, b"\xff\xff\xff"])))
    found = told(path)
    assert found.entries == 10
    no_scene, no_ledger = found.notes
    assert no_scene.startswith("its scene cannot be used: ")
    assert no_ledger == "1 entries are no ledger and are left out"
    assert "\x1b" not in "\n".join(lines(found))


def test_wrong_input_is_a_line_that_says_what_was_expected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of charts, before anything is read."""
    missing = tmp_path / "none.mcap"
    with pytest.raises(PlotfeedError, match=r"a\.gif: expected a name that ends in \.png"):
        print_report(missing, as_json=False, chart=tmp_path / "a.gif")
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "matplotlib", None)
        without.setitem(sys.modules, "matplotlib.figure", None)
        with pytest.raises(PlotfeedError, match=r"pip install 'plotfeed\[charts\]'"):
            print_report(missing, as_json=False, chart=tmp_path / "a.png")
    (tmp_path / "text.mcap").write_text("no recording\n" * 10)
    (tmp_path / "plain.mcap").write_bytes(mcap_of([]))
    other = recorded(looked()[:3], topic="plotfeed/other")
    written(tmp_path / "other.mcap", other)
    no_ledger = "holds no ledger: expected plotfeed.v1.LedgerBatch on a topic that ends in"
    for name, code, words in (
        ("none.mcap", 1, "No such file"),
        ("text.mcap", 2, "expected an MCAP file"),
        ("plain.mcap", 2, no_ledger),
        ("other.mcap", 2, no_ledger),
    ):
        done = plotfeed_here("report", tmp_path / name)
        assert (done.returncode, done.stdout) == (code, ""), name
        assert len(done.stderr.splitlines()) == 1
        assert done.stderr.startswith("plotfeed: ")
        assert words in done.stderr


def test_what_is_whole_of_a_damaged_file_counts(tmp_path: Path, capsys: Capture) -> None:
    octets = mcap_of(recorded(looked()), flush_every=100)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(octets[: len(octets) * 3 // 4])
    code, text, error = printed(cut, capsys)
    assert code == 2
    assert error
    assert all(line.startswith(f"plotfeed: {cut}: octet ") for line in error.splitlines())
    assert 0 < told(cut).entries < 500
    assert "Delay" in text
    cut.write_bytes(octets[:200])
    with pytest.raises(PlotfeedError, match="holds no ledger that is whole: octet"):
        printed(cut, capsys)


times = st.integers(-(2**63), 2**63 - 1) | st.integers(0, 10**6)
numbers = st.floats() | st.floats(0, 1)
sents = st.builds(
    pb.Sent,
    due_utc_ns=times,
    sent_utc_ns=times,
    link_due_utc_ns=times,
    number=times,
    copy=st.integers(-2, 3),
    fate=st.integers(0, 9),
    delivered=st.booleans(),
    octets=st.integers(-(2**31), 2**31 - 1),
)
looks = st.builds(pb.Look, range_m=numbers, pd=numbers, detected=st.booleans())
truths = st.builds(
    pb.PlotTruth,
    drone=st.sampled_from(["", "d"]),
    time_utc_ns=times,
    range_m=numbers,
    azimuth_deg=numbers,
    elevation_deg=numbers,
)
hostile = st.builds(
    pb.Ledger,
    sensor=st.sampled_from(["a", "b", "\n"]),
    scan=times,
    sector=st.integers(-(2**31), 2**31 - 1),
    looks=st.lists(looks, max_size=4),
    plots=st.lists(truths, max_size=4),
    messages=st.lists(sents, max_size=6),
    link=st.sampled_from(["", '{"latency_ms":1.0,"jitter_ms":1.0}', '{"down":true}', "x"]),
)
plot = st.builds(
    pb.Plot,
    time_utc_ns=times,
    range_m=numbers,
    azimuth_deg=numbers,
    sigma_range_m=numbers,
    sigma_azimuth_deg=numbers,
)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30, deadline=None
)
@given(st.lists(hostile, max_size=6), st.lists(plot, max_size=4))
def test_whatever_a_ledger_says_is_told_or_left_out(
    tmp_path: Path, ledgers: list[pb.Ledger], plots: list[pb.Plot]
) -> None:
    for entry in ledgers:
        if len(entry.plots) == len(plots):
            for truth, measured in zip(entry.plots, plots, strict=True):
                truth.time_utc_ns = measured.time_utc_ns
    batches = [
        pb.PlotBatch(sensor=entry.sensor, scan=entry.scan, sector=entry.sector, plots=plots)
        for entry in ledgers
    ]
    messages = [
        message
        for batch in batches
        for message in recorded([batch.SerializeToString()], topic=f"plotfeed/{batch.sensor}/plots")
    ]
    messages += recorded([*ledgers, pb.Ledger(sensor="a")])
    found = told(written(tmp_path / "hostile.mcap", messages))
    assert all("\n" not in line for line in lines(found))
    json.dumps(found.as_values(), allow_nan=False)
