"""`plotfeed report`: tables, JSON and charts of the same figures, and clear lines.

Of whole sessions over impaired links: what their record reports is what their scenes asked.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor import FieldDescriptor
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.command import plotfeed_here, refusal
from support.ledgers import as_received, entries, record_session, recorded, told, written
from support.links import link
from support.recordings import mcap_of
from support.significance import assert_chance

from plotfeed.feeds.lab.evidence import AskedByTime
from plotfeed.feeds.lab.gathering import FeedReport, SensorFigures
from plotfeed.feeds.lab.report import lines, print_report
from plotfeed.feeds.recording.recorded_settings import RecordedSettings
from plotfeed.models.residuals import Check
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS
from plotfeed.replay.mcap import McapReader
from plotfeed.testing import START_NS, flown, radar, rotating, scene

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


def test_a_chart_is_drawn_and_the_same_again_of_nothing_and_of_many_links_too(
    ledger_file: Path, tmp_path: Path, capsys: Capture
) -> None:
    def drawn(path: Path, name: str) -> bytes:
        assert printed(path, capsys, chart=tmp_path / name)[0] == 0
        return (tmp_path / name).read_bytes()

    for suffix in ("png", "svg", "pdf"):
        one, other = (drawn(ledger_file, f"{name}.{suffix}") for name in "ab")
        assert one == other
        assert len(one) > 10_000
    drawn(written(tmp_path / "e.mcap", recorded([pb.Ledger(sensor="r$a")])), "e.png")
    ledgers = entries(link(latency_ms=1.0), 200)
    for n, entry in enumerate(ledgers):
        entry.sensor = f"$s{n % 13}"
        for one in entry.messages:
            one.number //= 13
    many = drawn(written(tmp_path / "m.mcap", recorded(ledgers)), "m.svg")
    assert b"and 5 more, not drawn" in many


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


def test_wrong_input_is_told_in_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of charts, before anything is read."""
    missing = tmp_path / "none.mcap"
    with pytest.raises(PlotfeedError, match=r"a\.gif: expected a name that ends in \.png"):
        print_report(missing, as_json=False, chart=tmp_path / "a.gif")
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "matplotlib", None)
        without.setitem(sys.modules, "matplotlib.figure", None)
        with pytest.raises(PlotfeedError, match=r"pip install 'plotfeed\[charts\]'"):
            print_report(missing, as_json=False, chart=tmp_path / "a.png")
    done = plotfeed_here("report", missing)
    assert (done.returncode, done.stdout) == (1, "")
    assert "No such file" in done.stderr
    (tmp_path / "text.mcap").write_text("no recording\n" * 10)
    assert "expected an MCAP file" in refusal("report", tmp_path / "text.mcap")
    for messages in ([], recorded(looked()[:3], topic="plotfeed/other")):
        said = refusal("report", written(tmp_path / "other.mcap", messages))
        assert "no ledger: expected plotfeed.v1.LedgerBatch on a topic that ends in" in said


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


TIMES = st.integers(-(2**63), 2**63 - 1) | st.integers(0, 10**6)
OF_TYPE = {
    FieldDescriptor.CPPTYPE_DOUBLE: st.floats() | st.floats(0, 1),
    FieldDescriptor.CPPTYPE_INT64: TIMES,
    FieldDescriptor.CPPTYPE_INT32: st.integers(-(2**31), 2**31 - 1) | st.integers(-2, 3),
    FieldDescriptor.CPPTYPE_ENUM: st.integers(0, 9),
    FieldDescriptor.CPPTYPE_BOOL: st.booleans(),
}


def any_of(kind: Any, most: int = 0, **known: Any) -> st.SearchStrategy[Any]:
    """Messages of whatever numbers; lists of at most so many of them, if that is given."""
    plain = (f for f in kind.DESCRIPTOR.fields if f.cpp_type in OF_TYPE and not f.is_repeated)
    built = st.builds(kind, **{f.name: OF_TYPE[f.cpp_type] for f in plain} | known)
    return st.lists(built, max_size=most) if most else built


HOSTILE = any_of(
    pb.Ledger,
    sensor=st.sampled_from(["a", "b", "\n"]),
    looks=any_of(pb.Look, 4, drone=st.sampled_from(["", "d"])),
    plots=any_of(pb.PlotTruth, 4, drone=st.sampled_from(["", "d"])),
    messages=any_of(pb.Sent, 6),
    link=st.sampled_from(["", '{"latency_ms":1.0,"jitter_ms":1.0}', '{"down":true}', "x"]),
)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30, deadline=None
)
@given(st.lists(HOSTILE, max_size=6), any_of(pb.Plot, 4))
def test_whatever_a_ledger_says_is_told_or_left_out(
    tmp_path: Path, ledgers: list[pb.Ledger], plots: list[pb.Plot]
) -> None:
    for entry in ledgers:
        if len(entry.plots) == len(plots):
            for truth, measured in zip(entry.plots, plots, strict=True):
                truth.time_utc_ns = measured.time_utc_ns
    messages = []
    for entry in ledgers:
        of = {"sensor": entry.sensor, "scan": entry.scan, "sector": entry.sector}
        batch = pb.PlotBatch(**of, plots=plots).SerializeToString()
        messages += recorded([batch], topic=f"plotfeed/{entry.sensor}/plots")
    messages += recorded([*ledgers, pb.Ledger(sensor="a")])
    found = told(written(tmp_path / "hostile.mcap", messages))
    assert all("\n" not in line for line in lines(found))
    json.dumps(found.as_values(), allow_nan=False)


# Whole sessions.


def at(east_m: float, north_m: float, above_site_m: float) -> dict[str, float]:
    return {"east_m": east_m, "north_m": north_m, "above_site_m": above_site_m}


DELAYED = {"latency_ms": 80.0, "jitter_ms": 15.0, "delay_correlation": 0.3}
BURSTS = {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 3.0}
IMPAIRED = DELAYED | {"duplicate": 0.05, "corrupt": 0.05, "loss": BURSTS}
EVENTS = [
    {"from_s": 40.0, "to_s": 70.0, "set": {"pfa_factor": 5}},
    {"from_s": 80.0, "to_s": 90.0, "set": {"link": {"down": True}}},
]
AREA = [at(-1500.0, -500.0, 0.0), at(1500.0, -500.0, 0.0), at(1500.0, -2000.0, 0.0)]
FLOCK = [at(800.0, 1500.0, 80.0), at(-900.0, 1500.0, 80.0)]
TURNING = {"elevation_min_deg": -5.0, "pfa": 1e-5, "range_max_m": 10_000.0, "integration_s": 0.01}
SCENE = scene(
    [
        radar(id="lossy", scan=rotating(0.5), link=IMPAIRED, event=EVENTS, **TURNING),
        radar(id="weak", sic=2, scan=rotating(1.0), **TURNING | {"power_w": 0.5}),
    ],
    [flown(f"d{n}", at(n, 800.0, 200.0), at(-900.0, 1200.0, 200.0)) for n in (1500.0, 900.0)],
    seed=3,
    birds=[{"id": "gulls", "count": 5, "rcs_m2": 0.01, "path": FLOCK}],
    clutter=[{"id": "woods", "plots_per_km2": 20.0, "area": AREA}],
)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_session(SCENE, tmp_path_factory.mktemp("session") / "session.mcap", 100.0)


@pytest.fixture(scope="module")
def reported(session: Path) -> FeedReport:
    return told(session)


def sensor_of(report: FeedReport, name: str) -> SensorFigures:
    return next(x for x in report.sensors if x.sensor == name)


def checks_of(report: FeedReport, sensor: str) -> dict[str, Check]:
    return {c.name: c for c in report.verdicts.checks if c.sensor == sensor and not c.link}


def test_a_scripted_outage_is_a_setting_of_its_own(reported: FeedReport) -> None:
    (down,) = (x for x in reported.links if (x.sensor, x.number) == ("lossy", 2))
    assert down.messages == down.other_fates["outage"] > 200
    assert down.last_utc_ns - down.first_utc_ns == pytest.approx(10e9, abs=0.2e9)
    assert len(reported.links) == 3


def test_neither_birds_nor_clutter_are_false_alarms(session: Path, reported: FeedReport) -> None:
    told = sensor_of(reported, "lossy")
    assert set(told.plots_of_others) == {"bird", "clutter"}
    assert min(told.plots_of_others.values()) > 100
    assert told.plots > told.plots_of_others["bird"]
    alarms = checks_of(reported, "lossy")["false alarms"]
    assert_chance(alarms.p, f"{alarms.found} of {alarms.expected}")
    assert reported.verdicts.wrong == []
    assert any("plots of no drone and no false alarms" in line for line in lines(reported))
    listed = plotfeed_here("show", session, "--list", "--topic", "plotfeed/truth").stdout
    assert "of clutter/woods" in listed
    assert "of bird/gulls-" in listed


def test_sectors_that_the_link_lost_or_spoilt_are_no_fault_of_the_feed(session: Path) -> None:
    """A tenth of the messages is lost, a twentieth has a bit flipped, and ten seconds are down."""
    claimed = FeedReport(session, "claimed")
    lossy, checks = sensor_of(claimed, "lossy"), checks_of(claimed, "lossy")
    assert 0.15 < lossy.lost / (lossy.lost + lossy.entries) < 0.35
    for name in ("Pd", "false alarms", "range", "azimuth spread"):
        assert_chance(checks[name].p, f"{checks[name]}")


def test_what_a_broker_has_heard_is_told_as_far_as_it_goes(
    session: Path, reported: FeedReport, tmp_path: Path
) -> None:
    with McapReader(session) as log:  # without its scene, and without plots of one sensor
        messages = [m for m in as_received(log.messages()) if "weak/" not in m.topic]
    heard = told(written(tmp_path / "heard.mcap", messages))
    assert heard.scene == ""
    assert heard.as_values()["links"] == reported.as_values()["links"]
    whole, lossy = sensor_of(reported, "lossy"), sensor_of(heard, "lossy")
    assert lossy.plots_from == "plots, as received"
    assert 0.6 * whole.joined < lossy.joined < 0.9 * whole.joined
    assert not lossy.is_known
    weak = sensor_of(heard, "weak")
    assert (weak.joined, weak.plots_from, [*weak.histograms]) == (0, "", [])
    assert weak.plots > 80
    assert list(checks_of(heard, "lossy")) == ["plots"]
    for heard_of, at in zip(lossy.looks_by_range, whole.looks_by_range, strict=True):
        assert (heard_of.from_m, heard_of.looks, heard_of.found) == (at.from_m, at.looks, at.found)
        assert heard_of.expected == pytest.approx(at.expected, rel=1e-9)  # the ledger's own
    assert {name: sum(n) for name, n in lossy.histograms.items()} == dict.fromkeys(
        ("range", "azimuth", "elevation"), lossy.joined
    )


def test_what_control_changed_counts_from_then_on() -> None:
    sensor, settings = SCENE.sensor[1], RecordedSettings(SCENE)
    asked = AskedByTime(SCENE, sensor, settings, START_NS)
    first = START_NS // NS + 1

    def alarms(scan: int) -> float:
        then = asked.in_sector(scan, 0)
        return np.nan if then is None else then.false_alarms[0]

    before = alarms(first)
    said = {"controlled": {"pfa_factor": 3}, "in_force": {}}
    settings.take(sensor.id, json.dumps(said).encode(), START_NS + 10 * NS)
    settings.take(sensor.id, b"{", START_NS + 11 * NS)
    assert alarms(first) == before
    assert alarms(first + 20) == pytest.approx(3 * before)
    settings.take(
        sensor.id, json.dumps({"controlled": {"pfa": "much"}}).encode(), START_NS + 30 * NS
    )
    assert np.isnan(alarms(first + 40))
