"""A recording of a whole run, replayed from its page in a browser and moved along."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest
from support.chromium import until
from support.live_page import MS, Live, S, live, told

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Stage

if TYPE_CHECKING:
    from playwright.sync_api import Browser

STOP = re.compile(r"^Stop \d")
"""The button of a recording that runs, with its seconds."""
GLOW_S = 10.0
SHOWN = """() => {
  const { picture: { plots } } = plotfeed, shown = [];
  for (let row = plots.begin; row < plots.end; row++)
    shown.push([plots.sensor[plots.at(row)], plots.t_utc_ms[plots.at(row)]]);
  return shown.sort((a, b) => a[1] - b[1]);
}"""


@pytest.fixture
def run(browser: Browser, tmp_path: Path) -> Iterator[Live]:
    with live(browser, tmp_path) as run:
        yield run


class Told(NamedTuple):
    """What a recording holds, with the times at which it left."""

    start_ns: int
    ledger: list[tuple[int, pb.Ledger]]
    """Entries of sectors that were handed over since it began: of others there are no plots."""
    sectors: list[tuple[int, tuple[int, int]]]
    """Scans and sectors of the radar of which plots left."""


def recorded(run: Live, folder: Path) -> Told:
    """What was recorded from the page, at a pace at which busy machines miss no scan."""
    run.set_speed(2)
    run.press("Record")
    since = run.broker.count
    run.wait(lambda: len(run.broker.batches(since=since)) > 400)
    run.page.get_by_role("button", name=STOP).click()
    until(run.page, "plotfeed.picture.news.session.recordings.length === 1")
    (path,) = folder.glob("*.mcap")
    with McapReader(path) as log:
        start_ns = log.summary().start_ns
        messages = list(log.messages())
    assert start_ns
    batches = [
        (m.log_time_ns, m.stage, pb.PlotBatch.FromString(m.payload))
        for m in messages
        if m.topic.endswith("/plots")
    ]
    handed_over = {(b.sensor, b.scan, b.sector) for _, stage, b in batches if stage == Stage.BEFORE}
    entries = [
        (m.log_time_ns, pb.Ledger.FromString(m.payload))
        for m in messages
        if m.topic == "plotfeed/truth" and m.stage == Stage.AFTER
    ]
    return Told(
        start_ns,
        [(at_ns, e) for at_ns, e in entries if (e.sensor, e.scan, e.sector) in handed_over],
        [
            (at_ns, (b.scan, b.sector))
            for at_ns, stage, b in batches
            if stage == Stage.AFTER and b.sensor == "radar"
        ],
    )


def test_a_recording_is_loaded_moved_along_and_left(run: Live, tmp_path: Path) -> None:
    start_ns, entries, sectors = recorded(run, tmp_path)
    page = run.page
    run.press("Replay")
    until(page, "plotfeed.picture.news.session.replay.position_s > 0.3")
    assert page.get_by_role("button", name="Record", exact=True).is_disabled()
    page.get_by_text("Times are those of the recording").wait_for()

    # In a pause, moved along: what has not faded there, and nothing is sent.
    page.locator("#replay-pause").click()
    page.locator("#replay-pause").get_by_text("Play").wait_for()
    page.wait_for_timeout(300)
    heard = run.broker.count
    second = 0.0
    for share in (0.7, 0.8, 0.5):
        second = round((entries[int(share * len(entries))][0] - start_ns) / S, 1)
        page.get_by_label("Position in the recording").fill(str(second))
        now_ms = (start_ns + second * S) / MS
        until(page, "ms => Math.abs(plotfeed.picture.nowMs(0) - ms) < 0.1", now_ms)
        wanted = [
            [int(entry.sensor == "gate"), float(plot.time_utc_ns) / MS]
            for at_ns, entry in entries
            if now_ms - 1000 * GLOW_S < at_ns / MS <= now_ms and entry.messages[0].delivered
            for plot in entry.plots
        ]
        assert len(wanted) > 20
        shown = page.evaluate(SHOWN)
        first_ms = now_ms - 1000 * GLOW_S
        assert [row for row in shown if row[1] > first_ms] == sorted(
            (row for row in wanted if row[1] > first_ms), key=lambda row: row[1]
        )
    assert run.broker.count == heard

    # Going on: the messages of there.
    page.locator("#replay-pause").click()
    run.wait(lambda: len(run.broker.batches(since=heard)) > 30)
    from_ns = start_ns + round(second * S)
    from_there = {sector for at_ns, sector in sectors if at_ns >= from_ns}
    assert not told(run.broker.batches(since=heard)) - from_there
    assert not run.broker.ledger(since=heard)

    page.locator("#replay-stop").click()
    page.get_by_text("no replay").wait_for()
    left = run.broker.count
    run.wait(lambda: run.broker.ledger(since=left))
    assert page.get_by_role("button", name="Record", exact=True).is_enabled()
