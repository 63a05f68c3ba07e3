"""`plotfeed score`: sessions whose radar has tracks of its own, and trials with other truths."""

from __future__ import annotations

import json
import re
import xml.dom.minidom
from pathlib import Path

import numpy as np
import pytest
from support.command import plotfeed_here, refusal
from support.ledgers import record_session, recorded, written
from support.recordings import START_NS, message
from support.scene_files import radar, scene_file, scene_text
from support.scored_flights import APART, NS, SITE, Flight, csv_of, ledger_of, read_of
from support.told_tracks import told_tracks

from plotfeed.feeds.lab.flights import read_trial, scene_of
from plotfeed.feeds.lab.possible import Possible, RecordedRun, possible, read_run
from plotfeed.feeds.lab.score import (
    LimitVerdict,
    ScoreLimit,
    load_profile,
    mark_of,
    shipped_profiles,
)
from plotfeed.feeds.lab.scoring import FIGURE_NAMES, Score
from plotfeed.feeds.recording.recorded_tracks import TracksRead, read_tracks
from plotfeed.feeds.scene.scene import load
from plotfeed.models.verdicts import Interval
from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.content_types import JSON, asterix_content_type
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.asterix_files import RawWriter
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Stage

MORE = 'report = ["asterix-062", "plots"]\ntracks = { kind = "plain" }\n'


def session_of(folder: Path, more: str = "") -> Path:
    """The record of 40 s with the plain tracker of a radar."""
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=radar(more=MORE + more))
    return record_session(load(scene_file(folder, text)), folder / "there.mcap", 40.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return session_of(tmp_path_factory.mktemp("score"))


def score_of(*words: object) -> dict:
    done = plotfeed_here("score", *words, "--json")
    assert done.stderr == ""
    return json.loads(done.stdout)


def test_the_plain_tracker_of_a_radar_is_scored(recording: Path, tmp_path: Path) -> None:
    told = score_of(recording)
    assert told["figures"].keys() == set(FIGURE_NAMES)
    assert told["scene"] == "test"
    assert told["source"] == "there.mcap: plotfeed/radar/asterix/062"
    assert [each["drone"] for each in told["drones"]] == ["visitor"]
    assert told["figures"]["completeness"] > 0.7
    assert 0.0 < told["figures"]["position_rms_m"] < 30.0
    assert told["figures"]["latency_p50_s"] >= 0.0
    assert told["failure"] == ""
    assert told["drones"][0]["initiation_s"] > 0.5
    assert told["drones"][0]["alert_m"] == pytest.approx(1700.0, abs=60.0)
    page = tmp_path / "x.html"
    done = plotfeed_here("score", recording, "--out", page)
    assert done.returncode == 0
    assert tags_of(page.read_text()).count("svg") == 6  # NEES and latency among them
    for part in ("GOSPA, m", "completeness, %", "visitor", "radar", "as known"):
        assert part in done.stdout
    last = "No profile: nothing is judged. --profile asks for limits."
    assert done.stdout.splitlines()[-1] == last


def test_profiles_judge_tracks_of_another_file(recording: Path, tmp_path: Path) -> None:
    good = csv_of(tmp_path / "good.csv", recording)
    profile = tmp_path / "p.toml"
    profile.write_text(
        '[profile]\ntitle = "x"\n[[limit]]\nfigure = "gospa_m"\nat_most = 20.0\n'
        '[[limit]]\nfigure = "far_share"\nbeyond_m = 60.0\nat_most = 1e-4\n'
        '[[limit]]\nfigure = "position_rms_m"\nat_most = 12.0\n'
    )
    done = plotfeed_here("score", recording, "--tracks", good, "--profile", profile)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == (
        "2 of 3 limits kept, 1 undecided; any verdict is wrong in at most 5% of such runs."
    )
    poor = csv_of(tmp_path / "poor.csv", recording, off_deg=3e-4)
    words = ("score", recording, "--tracks", poor, "--profile", profile)
    done = plotfeed_here(*words, "--set", "cutoff_m=60")
    assert done.returncode == 1
    assert done.stdout.splitlines()[-1].startswith("0 of 3 limits kept, 2 failed, 1 undecided;")
    assert "your places are 33.3 m too far north" in done.stdout


def test_a_recording_of_a_broker_has_all_that_is_needed(recording: Path, tmp_path: Path) -> None:
    """Without the scene, sensors stand where they said; the score is the same."""
    with McapReader(recording) as log:
        heard = [
            message._replace(stage=Stage.RECEIVED) for message in log.messages(stages=[Stage.AFTER])
        ]
    path = written(tmp_path / "heard.mcap", heard)
    one, other = score_of(recording), score_of(path)
    assert (one["scene"], other["scene"]) == ("test", "")
    assert other["figures"]["alert_median_m"] is None
    for told in (one, other):
        del told["figures"]["alert_median_m"]
    assert other["figures"] == pytest.approx(one["figures"], nan_ok=True)


def suite_of(path: Path) -> tuple[list[int], dict[str, set[str]]]:
    """What another reader of XML finds: counts, and what came of each case."""
    document = xml.dom.minidom.parseString(path.read_bytes())  # noqa: S318 - ours
    (suite,) = document.getElementsByTagName("testsuite")
    counts = [int(suite.getAttribute(n)) for n in ("tests", "failures", "errors", "skipped")]
    cases = document.getElementsByTagName("testcase")
    return counts, {case.getAttribute("name"): {child.nodeName for child in case.childNodes}
                    for case in cases}  # fmt: skip


def test_junit_has_a_case_for_each_limit(recording: Path, tmp_path: Path) -> None:
    tracks, file = csv_of(tmp_path / "t.csv", recording, until_s=5.0), tmp_path / "x.xml"
    words = ("score", recording, "--tracks", tracks, "--profile", "example-f3411", "--junit", file)
    assert plotfeed_here(*words).returncode == 1
    counts, cases = suite_of(file)
    # It died, nobody knows when its reports came, and how rare it is so short a run cannot decide.
    assert counts == [5, 0, 1, 4]
    assert cases["tracker"] == {"error"}
    assert sorted(map(len, cases.values())) == [1] * 5
    assert "last report" in file.read_text()
    assert plotfeed_here(*words).returncode == 2
    assert plotfeed_here(*words, "--force").returncode == 1


def tags_of(page: str) -> list[str]:
    return re.findall(r"<(\w+)", page)


def test_a_page_is_marked_as_kept_where_every_limit_is_passed() -> None:
    limit = ScoreLimit(figure="gospa_m", at_most=10.0)
    passed, open_, failed = (
        LimitVerdict(limit, "known_gospa_m", Interval(*found), 1, "long a run")
        for found in ((5.0, 4.0, 6.0), (9.0, 7.0, 11.0), (20.0, 19.0, 21.0))
    )
    assert mark_of("", [passed, passed]) == "kept"
    assert mark_of("", [passed, open_]) == mark_of("", []) == ""
    assert mark_of("", [passed, open_, failed]) == mark_of("dead", [passed]) == "broken"
    assert open_.note == "as known; about 4 times as long a run would decide"
    stamped = LimitVerdict(limit, "gospa_m", Interval(5.0, 4.0, 6.0), 1, "long a run")
    assert stamped.note == "as stamped"


def test_html_is_one_file_and_names_are_text_in_it_and_in_xml(tmp_path: Path) -> None:
    ledgers = recorded(ledger_of({"<b>&\x07$x$": APART["a"]}))
    told = {"sensor": "radar", "latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}
    described = message(
        json.dumps(told).encode(), topic="plotfeed/radar/description", content_type=JSON
    )
    messages = [described, *(each._replace(log_time_ns=START_NS) for each in ledgers)]
    path = written(tmp_path / "x.mcap", messages)
    tracks = csv_of(tmp_path / "x.csv", path)
    profile = tmp_path / "p.toml"
    profile.write_text(
        '[profile]\ntitle = "<i>"\n[[limit]]\nname = "a\\u0007<b>"\nfigure = "gospa_m"\n'
        "at_most = 5.0\n"
    )
    pages, junit = [tmp_path / "x.html", tmp_path / "y.html"], tmp_path / "x.xml"
    words = ("score", path, "--tracks", tracks, "--profile", profile, "--junit", junit, "--force")
    for out in pages:
        done = plotfeed_here(*words, "--out", out)
        assert (done.returncode, done.stderr) == (0, "")
    one, other = (out.read_text() for out in pages)
    assert one == other
    assert re.findall(r'\b(?:src|href)="[^"#]', one) == []
    assert not {"b", "i", "script"} & {*tags_of(one)}
    assert tags_of(one).count("svg") == 4
    assert "\x07" not in done.stdout
    assert suite_of(junit)[1].keys() == {"tracker", "a<b>"}


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--profile", "nothing"], r"nothing: expected a file that ends in .toml, or one of"),
        (["--set", "here"], "--set here: expected KEY=VALUE"),
        (["--set", "protected_deg=[95,0]"], "--set protected_deg: expected a latitude"),
        (["--set", "cutof_m=5"], "--set cutof_m: no such key; did you mean cutoff_m"),
        (["--set", 'leave_out=["x"]'], "leave_out: no drone 'x': expected of visitor"),
        (["--topic", "a/#/b"], "# is the last one"),
    ],
)
def test_wrong_use_is_told_in_a_line(recording: Path, words: list[str], why: str) -> None:
    assert re.search(why, refusal("score", recording, *words))


def test_what_is_no_recording_with_a_ledger_is_refused(recording: Path, tmp_path: Path) -> None:
    with McapReader(recording) as log:
        others = [m for m in log.messages() if not m.topic.endswith("/truth")]
    assert "no ledger" in refusal("score", written(tmp_path / "x.mcap", others))


# Profiles.


def test_shipped_profiles_are_labelled_as_examples() -> None:
    names = shipped_profiles()
    assert len(names) >= 6
    for name in names:
        found = load_profile(name)
        assert name.startswith("example-")
        assert found.profile.title.startswith("Example: figures like those of ")
        assert "Passing says nothing of any standard." in found.profile.note
        assert "complian" not in found.model_dump_json()


HEAD = '[profile]\ntitle = "x"\n'


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "profile: missing"),
        (HEAD, "limit: missing"),
        ("limit = []\n" + HEAD, "limit: at least one"),
        (HEAD + '[[limit]]\nfigure = "gospa_m"', "expected at_most or at_least"),
        (HEAD + '[[limit]]\nfigure = "gospa_m"\nat_most = 1\nat_least = 0', "or at_least"),
        (HEAD + '[[limit]]\nfigure = "nosuch"\nat_most = 1', "figure: expected one of"),
        (HEAD + '[[limit]]\nfigure = "far_share"\nat_most = 1', "needed by far_share"),
        (HEAD + '[[limit]]\nfigure = "gospa_m"\nat_most = 1\nperiod_s = 2.0', "is not of gospa_m"),
        (HEAD + '[[limit]]\nfigure = "gospa_m"\nat_most = "much"', "limit"),
        (HEAD + '[settings]\nnosuch = 1\n[[limit]]\nfigure = "gospa_m"\nat_most = 1', "settings"),
        (HEAD + '[settings]\ncutoff_m = 0\n[[limit]]\nfigure = "ospa_m"\nat_most = 1', "cutoff_m"),
        (HEAD + '[settings]\norder = "p"\n[[limit]]\nfigure = "ospa_m"\nat_most = 1', "order"),
        ("][", "no TOML"),
    ],
)
def test_a_wrong_profile_is_told_of(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(text)
    with pytest.raises(PlotfeedError, match=why) as refused:
        load_profile(str(path))
    assert "\n" not in str(refused.value)
    assert str(path) in str(refused.value)


# Whose fault a loss is: no tracker is blamed for what sensors or links did not bring.


def split(path: Path, tracks: TracksRead | None = None) -> Possible:
    """Of the radar's own tracks, or of others."""
    run = read_run(path)
    found = possible(run, Score(run.truths, tracks or read_tracks(path, scene_of(path))))
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("more", "whose"),
    [("degradation = { pd_factor = 0.25 }", "feed"), ("link = { latency_ms = 4000 }", "link")],
)
def test_a_loss_is_of_whoever_caused_it(
    tmp_path: Path, more: str, whose: str, recording: Path
) -> None:
    found = [split(recording), split(session_of(tmp_path, more))]
    before, after = ({"feed": of.of_feed_m, "link": of.of_link_m} for of in found)
    assert after[whose] > 1.5 * before[whose] + 3.0
    other = "link" if whose == "feed" else "feed"
    assert after[other] < 1.5 * before[other] + 3.0


def test_a_tracker_that_says_nothing_is_to_blame(recording: Path) -> None:
    found = split(recording, read_of([]))
    assert found.of_tracker_m > 3 * np.hypot(found.of_feed_m, found.of_link_m)
    assert "most is the tracker's" in str(found)
    assert found.completeness > 0.9
    assert 0.5 < found.position_rms_m / found.bound_m < 2.0
    assert f"no tracker does better than {found.bound_m:.1f} m" in str(found)
    assert found.placeless == 0
    truths = read_run(recording).truths
    without_plots = possible(RecordedRun(truths), Score(truths, read_of([])))
    assert without_plots is None


# Truth by logs of drones, or by what another tracker recorded.

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
    told = score_of(tracks, "--truth", log)
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
    words = (tracks_of(tmp_path / "t.csv"), "--truth", reference)
    told = score_of(*words)
    assert [each["drone"] for each in told["drones"]] == ["a", "b"]
    assert [each["completeness"] > 0.9 for each in told["drones"]] == [True, False]
    without = score_of(*words, "--set", 'leave_out=["b"]')
    assert without["figures"]["completeness"] > 0.9


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
            writer.write(message(block, t_ns, content_type=asterix_content_type(62)))
        writer.close()
    scored = score_of(tracks_of(tmp_path / "t.csv"), "--truth", reference)
    assert [each["drone"] for each in scored["drones"]] == ["25.10.7"]
    assert scored["figures"]["completeness"] > 0.95
    assert scored["figures"]["position_rms_m"] < 6.0


@pytest.mark.parametrize("suffix", [".csv", ".tsv"])
def test_of_a_truth_without_heights_nothing_is_told_in_space(tmp_path: Path, suffix: str) -> None:
    """Nor that the tracker's are wrong; and what has no place is counted, and spoils nothing."""
    delimiter = "," if suffix == ".csv" else "\t"
    rows = [row.split(",")[:4] for row in tracks_of(tmp_path / "x.csv").read_text().splitlines()]
    rows[30][2], rows[31][2] = "200.0", "north"
    reference = tmp_path / f"reference{suffix}"
    reference.write_text("".join(delimiter.join(row) + "\n" for row in rows))
    words = (tracks_of(tmp_path / "t.csv"), "--truth", reference)
    told = score_of(*words)
    assert told["findings"] == []
    assert told["figures"]["completeness"] > 0.95
    for name in ("space_gospa_m", "height_rms_m", "bias_up_m"):
        assert told["figures"][name] is None
    assert told["notes"][:2] == [
        f"reference{suffix}: 2 places of the truth cannot be used",
        f"reference{suffix} does not tell all heights: nothing is told in space",
    ]
    said = refusal("score", *words, "--set", "dimensions=3")
    assert "dimensions = 3: the truth tells no heights" in said
