from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.command import plotfeed_here
from support.sapient_rules import ONE, task
from support.scene_files import radar as radar_text
from support.scene_files import scene_file, scene_text

from plotfeed.feeds.formats.sapient import need_sapient
from plotfeed.feeds.formats.sapient.sapient_node import MIN_GAP_NS, Groups
from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.recording.record_text import Style
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.models.beam import Sector, Timetable
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.sapient.envelope import node_id, stamp_ns
from plotfeed.testing import fly, radar, scene

REPORT = 'report = ["sapient"]'


@pytest.fixture
def not_imported() -> Iterator[None]:
    """What a test imports of it in its place is forgotten again."""

    def taken_out() -> dict[str, ModuleType]:
        names = [name for name in sys.modules if name.partition(".")[0] == "sapient_msg"]
        return {name: sys.modules.pop(name) for name in names}

    held = taken_out()
    yield
    taken_out()
    sys.modules |= held


@pytest.fixture
def without_extra(not_imported: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sapient_msg", None)


@pytest.mark.usefixtures("without_extra")
def test_without_the_extra_a_scene_that_needs_it_is_refused_in_one_line() -> None:
    assert fly(scene([radar()], seed=1), 1.0).payloads("radar/plots")
    assert sys.modules["sapient_msg"] is None
    with pytest.raises(PlotfeedError) as caught:
        fly(scene([radar(report=["sapient"])], seed=1), 1.0)
    assert str(caught.value) == "SAPIENT needs sapient-proto: pip install 'plotfeed[sapient]'"


INSTALL = "pip install 'plotfeed[sapient]'"
ONE_ALONE = f"{INSTALL}, without sapient-msg or sapient-py"


@pytest.mark.parametrize(
    ("folder", "module", "expected"),
    [
        ("v1_0", None, f"SAPIENT needs sapient-proto, and another package has its name: {INSTALL}"),
        ("v2_0", "raise TypeError('two\\nof them')",
         f"sapient-proto does not load (two of them): {ONE_ALONE}"),
        ("v2_0", "import nothing_like_it",
         f"sapient-proto does not load (No module named 'nothing_like_it'): {ONE_ALONE}"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("not_imported")
def test_what_is_installed_wrongly_is_told_in_one_line(
    folder: str, module: str | None, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "sapient_msg" / f"bsi_flex_335_{folder}"
    package.mkdir(parents=True)
    for path in (package.parent, package):
        (path / "__init__.py").touch()
    if module is not None:
        (package / "sapient_message_pb2.py").write_text(module)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PlotfeedError) as caught:
        need_sapient()
    assert str(caught.value) == expected


@pytest.mark.usefixtures("without_extra")
def test_commands_say_it_too(tmp_path: Path) -> None:
    path = scene_file(tmp_path, scene_text(sensors=radar_text(more=REPORT)))
    done = plotfeed_here("run", path, "--broker", "none", "--duration", 1)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    (line,) = message_lines("plotfeed/radar/sapient", b"x", None)
    for said in (line, done.stderr):
        assert "pip install 'plotfeed[sapient]'" in said


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        ("middleware", "nowhere"),
        ("location", "here"),
        ("default_class_confidence", 1.4),
        ("default_class", ""),
        ("status_interval_s", 0),
        ("detection_confidence", float("nan")),
    ],
)
def test_a_wrong_key_is_named(key: str, wrong: object) -> None:
    with pytest.raises(SceneError) as caught:
        scene([radar(report=["sapient"])], seed=1, sapient={key: wrong})
    assert [found for found, _ in caught.value.problems] == [f"sapient.{key}"]


def test_messages_are_shown_as_a_line_and_as_json() -> None:
    flown = fly(scene([radar(report=["sapient"], pfa=1e-4)], seed=1), 3.0)
    shown = {}
    for payload in flown.payloads("radar/sapient"):
        (line,) = message_lines("plotfeed/radar/sapient", payload, None)
        (text,) = message_lines("plotfeed/radar/sapient", payload, None, style=Style.JSON)
        message = json.loads(text)["message"]["SapientMessage"]
        assert message["node_id"] == node_id(1, "radar")
        stamp = ["plotfeed/radar/sapient", message["timestamp"], message["node_id"][:8]]
        assert line.split("  ")[:3] == stamp
        shown[line.split("  ")[3]] = line
    assert "  azimuth " in shown["detection_report"]
    assert "  SNR " in shown["detection_report"]
    assert "BSI Flex 335 v2.0" in shown["registration"]
    assert "SYSTEM_GOODBYE" in shown["status_report"]
    asked = task(ONE, mode_change="standby")
    (line,) = message_lines("plotfeed/radar/sapient/task", asked, None)
    assert ONE in line
    assert '"mode_change": "standby"' in line


def test_what_is_no_sapient_is_shown_as_such() -> None:
    for payload in (b"", b"\xff\xff", b"\x12\x01a"):
        (line,) = message_lines("plotfeed/radar/sapient", payload, None)
        assert "not what the topic says" in line


# Groups of sectors.

schedules = st.tuples(
    st.integers(20_000_000, 5_000_000_000), st.sampled_from([1, 1, 4, 7, 8, 31, 32, 100, 256])
)
times = st.integers(1_000_000_000, 1_800_000_000).map(lambda s: s * 1_000_000_000)


def sectors(t_utc_ns: int, period_ns: int, count: int, n: int) -> list[Sector]:
    found = [Timetable(period_ns, count).sector_at(t_utc_ns)]
    while len(found) < n:
        found.append(Timetable(period_ns, count).next_sector(found[-1]))
    return found


@given(schedules, times)
def test_stamps_are_80_ms_apart_whatever_the_scan(schedule: tuple[int, int], t_ns: int) -> None:
    period_ns, count = schedule
    groups = Groups(period_ns, count)
    ends = [
        stamp_ns(sector.end_ns)
        for sector in sectors(t_ns, period_ns, count, 6 * groups.size)
        if groups.ends_with(sector)
    ]
    assert len(ends) in (5, 6)
    assert all(b - a >= MIN_GAP_NS for a, b in pairwise(ends))


@given(schedules, times)
def test_no_detection_waits_for_longer_than_it_must(schedule: tuple[int, int], t_ns: int) -> None:
    """A group is as short as the rule allows, but for a sector where rounding would break it."""
    period_ns, count = schedule
    groups = Groups(period_ns, count)
    fewest = -(-MIN_GAP_NS * count // period_ns)
    assert fewest <= groups.size <= fewest + 1
    run = sectors(t_ns, period_ns, count, 3 * groups.size)
    for sector in run:
        last = next((s for s in run if groups.ends_with(s) and s.end_ns >= sector.end_ns), None)
        if last is not None:
            assert last.end_ns - sector.start_ns <= groups.longest_ns + 1
            assert groups.number(last) == groups.number(sector)


def test_groups_are_as_large_as_worked_out_by_hand() -> None:
    """560,000,007 ns in 7: rounding might take the last nanosecond of 80 ms."""
    given_schedules = (10**9, 32), (10**9, 1), (80 * 10**6, 1), (20 * 10**6, 1), (560_000_007, 7)
    assert [Groups(*each).size for each in given_schedules] == [3, 1, 1, 4, 2]
