"""`plotfeed score`, on the recording of a session whose radar has tracks of its own."""

from __future__ import annotations

import json
import re
import xml.dom.minidom
from html.parser import HTMLParser
from pathlib import Path

import pytest
from support.command import plotfeed_here
from support.ledgers import record_session, recorded, written
from support.recordings import START_NS
from support.scene_files import radar, scene_file, scene_text
from support.scored_flights import APART, csv_of, ledger_of

from plotfeed.feeds.lab.score import (
    LimitVerdict,
    ScoreLimit,
    load_profile,
    mark_of,
    shipped_profiles,
)
from plotfeed.feeds.lab.scoring import FIGURE_NAMES
from plotfeed.models.verdicts import Interval
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Stage

MORE = 'report = ["asterix-062", "plots"]\ntracks = { kind = "plain" }'


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("score")
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=radar(more=MORE))
    return record_session(scene_file(folder, text), folder / "there.mcap", 30.0)


def score_of(*words: object) -> dict:
    done = plotfeed_here("score", *words, "--json")
    assert done.stderr == ""
    return json.loads(done.stdout)


def test_the_plain_tracker_of_a_radar_is_scored_from_end_to_end(
    recording: Path, tmp_path: Path
) -> None:
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
    assert Tags(page.read_text()).tags.count("svg") == 6  # NEES and latency among them
    for part in ("GOSPA, m", "completeness, %", "visitor", "radar", "as known"):
        assert part in done.stdout
    last = "No profile: nothing is judged. --profile asks for limits."
    assert done.stdout.splitlines()[-1] == last


def test_tracks_of_another_file_are_scored_and_profiles_judge_them(
    recording: Path, tmp_path: Path
) -> None:
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


class Suites:
    """What another reader of XML finds."""

    def __init__(self, path: Path) -> None:
        document = xml.dom.minidom.parseString(path.read_bytes())  # noqa: S318 - ours
        (self.suite,) = document.getElementsByTagName("testsuite")
        self.cases = {
            case.getAttribute("name"): {child.nodeName for child in case.childNodes}
            for case in document.getElementsByTagName("testcase")
        }

    def counts(self) -> list[int]:
        names = ("tests", "failures", "errors", "skipped")
        return [int(self.suite.getAttribute(name)) for name in names]


def test_junit_has_a_case_for_each_limit(recording: Path, tmp_path: Path) -> None:
    tracks, file = csv_of(tmp_path / "t.csv", recording, until_s=5.0), tmp_path / "x.xml"
    words = ("score", recording, "--tracks", tracks, "--profile", "example-f3411", "--junit", file)
    assert plotfeed_here(*words).returncode == 1
    found = Suites(file)
    # It died, nobody knows when its reports came, and how rare it is so short a run cannot decide.
    assert found.counts() == [5, 0, 1, 4]
    assert found.cases["tracker"] == {"error"}
    assert sorted(map(len, found.cases.values())) == [1] * 5
    assert "last report" in file.read_text()
    assert plotfeed_here(*words).returncode == 2
    assert plotfeed_here(*words, "--force").returncode == 1


class Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.outside: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.outside += [
            value
            for name, value in attrs
            if name in ("src", "href", "xlink:href") and value and not value.startswith("#")
        ]


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


def test_html_is_one_file_the_same_to_the_byte_and_names_are_text_in_it_and_xml(
    tmp_path: Path,
) -> None:
    ledgers = recorded(ledger_of({"<b>&\x07$x$": APART["a"]}))
    messages = [each._replace(log_time_ns=START_NS) for each in ledgers]
    told = {"sensor": "radar", "latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0,
            "scan_period_s": 1.0}  # fmt: skip
    described = messages[0]._replace(
        topic="plotfeed/radar/description",
        payload=json.dumps(told).encode(),
        content_type="application/json",
    )
    path = written(tmp_path / "x.mcap", [described, *messages])
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
    found = Tags(one)
    assert found.outside == []
    assert not {"b", "i", "script"} & {*found.tags}
    assert found.tags.count("svg") == 4
    assert "\x07" not in done.stdout
    assert Suites(junit).cases.keys() == {"tracker", "a<b>"}


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--profile", "nothing"], r"nothing: expected a file that ends in .toml, or one of"),
        (["--set", "here"], "--set here: expected KEY=VALUE"),
        (["--set", "protected_deg=[95,0]"], "--set protected_deg: expected a latitude"),
        (["--set", "cutof_m=5"], "--set cutof_m: no such key; did you mean cutoff_m"),
        (["--set", 'leave_out=["x"]'], "leave_out: no drone 'x': expected of visitor"),
        (["--topic", "a/#/b"], "# is the last one"),
        (["--topic", "nobody/here"], ""),
    ],
)
def test_wrong_use_is_told_in_a_line(recording: Path, words: list[str], why: str) -> None:
    done = plotfeed_here("score", recording, *words)
    if why:
        assert done.returncode == 2
        assert re.search(why, done.stderr)
        assert len(done.stderr.splitlines()) == 1
    else:  # a tracker of which there is nothing has failed
        assert done.returncode == 1
        assert "The tracker failed: the tracker reported no tracks." in done.stdout


def test_what_is_no_recording_with_a_ledger_is_refused(recording: Path, tmp_path: Path) -> None:
    with McapReader(recording) as log:
        others = [m for m in log.messages() if not m.topic.endswith("/truth")]
    done = plotfeed_here("score", written(tmp_path / "x.mcap", others))
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "no ledger" in done.stderr


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
