"""What the controls of a sensor and of the clock do in a real run, measured on its broker."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy import stats
from support.live_page import (
    MS,
    PFA,
    SECTORS,
    Live,
    S,
    delivered,
    end_ns,
    live,
    sectors_within,
    told,
)
from support.significance import assert_chance, assert_law, assert_sum

from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import MqttMessage

if TYPE_CHECKING:
    from playwright.sync_api import Browser

DEGRADED_PFA, DEGRADED_SNR_DB = 10, 6.0  # As docs/page.md says: times, and down
SEEN_S = 1.5  # So long at least one looks at the pace


@pytest.fixture(scope="module")
def shared(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    with live(browser, tmp_path_factory.mktemp("shared")) as run:
        yield run


@pytest.fixture
def run(shared: Live) -> Iterator[Live]:
    """A run that several tests use; each leaves it as its scene says, at its pace."""
    yield shared
    shared.as_in_the_beginning()


def test_latency_that_is_asked_for_is_that_of_every_message(run: Live) -> None:
    run.ask(Latency="400")
    link = {"latency_ms": 400.0}
    run.wait(lambda: len(run.broker.sent(link)) >= 100)
    for message in run.broker.sent(link):
        assert message.link_due_utc_ns - message.due_utc_ns == 400 * MS
        assert message.sent_utc_ns >= message.link_due_utc_ns
    run.set_speed(1)  # at which no machine is so slow that it misses a scan
    # With time at a stand, what has come of the radar ends 400 ms before what has of the gate.
    now_ns = run.freeze("gate")
    expected = sectors_within("radar", now_ns - S, now_ns - 400 * MS)
    run.wait(lambda: expected[-1] in told(run.broker.batches()))
    run.settle()
    assert max(told(run.broker.batches())) == expected[-1]
    assert max(told(run.broker.batches("gate"))) == sectors_within("gate", now_ns - S, now_ns)[-1]

    since, _ = run.as_in_the_scene()
    run.press("Go on")
    run.wait(lambda: len(run.broker.sent({}, since)) >= 20)
    assert {m.link_due_utc_ns - m.due_utc_ns for m in run.broker.sent({}, since)} == {0}


def test_jitter_that_is_asked_for_is_the_spread_of_delays(run: Live) -> None:
    run.ask(Latency="400", Jitter="50")
    link, count = {"latency_ms": 400.0, "jitter_ms": 50.0}, 250
    run.wait(lambda: len(run.broker.sent(link)) >= count)
    delays_ns = [m.link_due_utc_ns - m.due_utc_ns for m in run.broker.sent(link)[:count]]
    assert_law(np.array(delays_ns) / MS, stats.norm(400, 50).cdf, "delays")
    ends_ns = [end_ns(batch) for batch in run.broker.batches()]
    assert ends_ns != sorted(ends_ns)  # some overtook others on the way to the broker


def test_loss_that_is_asked_for_is_what_the_broker_never_got(run: Live) -> None:
    run.ask(Loss="20")
    link, count = {"loss": {"kind": "random", "probability": 0.2}}, 400
    run.wait(lambda: len(run.broker.sent(link)) >= count)
    lost = [m.fate == pb.LOST for m in run.broker.sent(link)[:count]]
    assert_chance(stats.binomtest(sum(lost), count, 0.2).pvalue, "lost")
    run.freeze()
    assert_ledger_is_what_came(run)


def test_losses_that_are_asked_for_in_bursts_come_in_bursts(run: Live) -> None:
    run.ask(Loss="40", Mean_burst="4")
    link = {"loss": {"kind": "gilbert-elliott", "mean_loss": 0.4, "mean_burst": 4.0}}
    count = 60
    run.wait(lambda: len(bursts(run, link)) > count)
    # So many bursts, and not those of so many messages: long ones would be cut off.
    lengths = bursts(run, link)[:count]
    assert_sum(sum(lengths), count * 4.0, count * 4.0 * (4.0 - 1), "geometric lengths of bursts")
    run.freeze()
    assert_ledger_is_what_came(run)


def bursts(run: Live, link: dict[str, object]) -> list[int]:
    """Numbers of messages that were lost in a row, but for the last."""
    fates = [message.fate for message in run.broker.sent(link)]
    runs = [(fate, len(list(same))) for fate, same in itertools.groupby(fates)]
    return [length for fate, length in runs[:-1] if fate == pb.LOST]


def assert_ledger_is_what_came(run: Live) -> None:
    """All that left has come, and nothing that was lost."""
    ledger = run.broker.ledger()
    came = told(run.broker.batches())
    # The client came after the first of either.
    first = max(min((x.scan, x.sector) for x in ledger), min(came))
    came = {sector for sector in came if sector >= first}
    assert came == {sector for sector in delivered(ledger) if sector >= first}
    assert len(came) < len(ledger)


def false_alarms(ledger: list[pb.Ledger]) -> int:
    """In as many directions as there are."""
    return sum(not plot.drone for entry in ledger[: SECTORS["radar"]] for plot in entry.plots)


def looks_snr_db(entry: pb.Ledger) -> list[float]:
    """Of the looks at the drone that hovers."""
    return [look.snr_db for look in entry.looks if look.drone == "hovering"]


def hovering_snr_db(ledger: list[pb.Ledger]) -> float:
    return float(np.mean([snr_db for entry in ledger for snr_db in looks_snr_db(entry)]))


def turn_under(run: Live, since: int, settings: dict[str, Any]) -> list[pb.Ledger]:
    """The ledger of all directions once, from when the radar was told to be so."""
    since_ns = utc_ns(settings["time_utc"]) + AHEAD_NS

    def found() -> list[pb.Ledger]:
        entries = [x for x in run.broker.ledger(since=since) if end_ns(x) > since_ns]
        hovering = (i for i, entry in enumerate(entries) if looks_snr_db(entry))
        # If the machine misses a scan, the drone is seen in a later turn.
        return entries[: max(SECTORS["radar"], next(hovering, len(entries)) + 1)]

    run.wait(lambda: len(found()) >= SECTORS["radar"] and any(map(looks_snr_db, found())))
    return found()


def utc_ns(text: str) -> int:
    return int(np.datetime64(text.removesuffix("Z"), "ns").astype(np.int64))


def assert_ratio(more: int, fewer: int, ratio: float, of: str) -> None:
    """Two counts of Poisson have means in that ratio; exact, given their sum."""
    p_value = stats.binomtest(more, more + fewer, ratio / (1 + ratio)).pvalue
    assert_chance(p_value, f"{of}: {more} and {fewer}")


def test_a_degraded_sensor_has_more_false_alarms_and_less_signal_until_it_is_on(run: Live) -> None:
    usual = turn_under(run, *run.as_in_the_scene())
    since, settings = run.choose("Degraded")
    assert settings["in_force"]["pfa"] == pytest.approx(PFA * DEGRADED_PFA)
    degraded = turn_under(run, since, settings)
    since, settings = run.choose("On")
    assert settings["in_force"]["pfa"] == PFA
    again = turn_under(run, since, settings)
    assert_ratio(false_alarms(degraded), false_alarms(usual), DEGRADED_PFA, "degraded")
    assert_ratio(false_alarms(again), false_alarms(usual), 1.0, "on again")
    snr_db = [hovering_snr_db(ledger) for ledger in (usual, degraded, again)]
    assert snr_db[0] - snr_db[1] == pytest.approx(DEGRADED_SNR_DB, abs=0.01)
    assert snr_db[2] == pytest.approx(snr_db[0], abs=0.01)


def test_a_sensor_that_is_off_says_nothing_until_it_is_on(run: Live) -> None:
    since, settings = run.choose("Off")
    assert settings["in_force"]["enabled"] is False
    run.wait(lambda: len(run.broker.batches("gate", since)) > SECTORS["gate"])
    off_ns = utc_ns(settings["time_utc"])
    for messages in (run.broker.batches(), run.broker.ledger()):
        assert max(map(end_ns, messages)) <= off_ns + AHEAD_NS
    run.wait(lambda: run.broker.on("plotfeed/radar/status", since))
    assert not run.broker.on("plotfeed/radar/status", since)[-1][1].get("enabled")
    since, settings = run.choose("On")
    assert settings["in_force"]["enabled"] is True
    run.wait(lambda: len(run.broker.batches(since=since)) > 20)


def test_a_story_is_told_by_a_click_and_taken_back_by_another(run: Live) -> None:
    run.as_in_the_scene()
    _, settings = run.settings_after(lambda: run.press("Outage of radar"))
    assert settings["controlled"] == {"link": {"down": True}}
    link = {"down": True}
    run.wait(lambda: len(run.broker.sent(link)) > 20)
    assert {message.fate for message in run.broker.sent(link)} == {pb.OUTAGE}
    run.page.get_by_role("button", name="Outage of radar", pressed=True).wait_for()
    for strip in ("Plots delivered", "Histogram of latency", "Messages lost", "Probability"):
        run.page.get_by_label(re.compile(f"^{strip}.*Outage of radar")).wait_for()
    since, settings = run.settings_after(lambda: run.press("Outage of radar"))
    assert settings["controlled"] == {}
    assert "link" not in settings["in_force"]
    run.page.get_by_role("button", name="Outage of radar", pressed=False).wait_for()
    run.wait(lambda: len(run.broker.sent({}, since)) > 20)
    assert {message.fate for message in run.broker.sent({}, since)} == {pb.SENT}


def test_what_was_asked_is_undone_step_by_step(run: Live) -> None:
    words = run.page.locator("#undo-words")
    run.as_in_the_scene()
    run.ask(Latency="300")
    words.get_by_text("radar: link.latency_ms 300").wait_for()
    _, bad = run.settings_after(lambda: run.press("The link goes bad"))
    assert bad["in_force"]["link"]["latency_ms"] == 600
    words.get_by_text("The link goes bad", exact=True).wait_for()
    for controlled in ({"link": {"latency_ms": 300}}, {}):
        _, undone = run.settings_after(lambda: run.press("Undo"))
        assert undone["controlled"] == controlled
    words.get_by_text("radar: as in the scene").wait_for()


def test_a_pfa_that_is_asked_for_is_that_of_false_alarms_until_it_is_taken_back(run: Live) -> None:
    usual = turn_under(run, *run.as_in_the_scene())
    since, settings = run.ask(Pfa="5e-4")
    assert settings["controlled"] == {"pfa": 5e-4}
    more = turn_under(run, since, settings)
    since, settings = run.as_in_the_scene()
    assert settings["controlled"] == {}
    assert settings["in_force"]["pfa"] == PFA
    again = turn_under(run, since, settings)
    assert_ratio(false_alarms(more), false_alarms(usual), 5.0, "more")
    assert_ratio(false_alarms(again), false_alarms(usual), 1.0, "as in the scene")


def test_nothing_comes_in_a_pause_and_a_step_is_all_that_lies_in_it(run: Live) -> None:
    run.set_speed(1)  # so that no machine is so slow that it misses a scan
    now_ns = run.freeze()
    since = run.broker.count
    run.page.wait_for_timeout(1000)
    assert run.broker.count == since
    for _ in range(2):
        since, before_ns = run.broker.count, now_ns
        now_ns = run.step()
        assert now_ns - before_ns == pytest.approx(S, abs=1000)
        for sensor in ("radar", "gate"):
            expected = sectors_within(sensor, before_ns, now_ns)
            for messages in (run.broker.batches, run.broker.ledger):
                assert [(x.scan, x.sector) for x in messages(sensor, since)] == expected
    since = run.broker.count
    run.press("Go on")
    run.wait(lambda: len(run.broker.batches(since=since)) >= 20)
    first = run.broker.batches(since=since)[0]
    assert (first.scan, first.sector) == sectors_within("radar", now_ns, now_ns + S)[0]


def test_time_runs_at_the_speed_that_is_asked_for_or_said_to_be_reached(run: Live) -> None:
    run.choose("Off")  # the gate alone is no burden for any machine
    for speed in (2, 10):
        run.set_speed(speed)
        since = run.broker.count
        run.wait(lambda: is_pace(run, since, speed))  # noqa: B023 - at once


def is_pace(run: Live, since: int, speed: int) -> bool:
    """Whether messages came at the pace that the session says it reaches of what is asked.

    That is when they came, by this clock, less when they were due, by the session's: it grows where
    the session is faster or slower than it says, which it does when that has changed by a tenth.
    """
    said = [of for _, of in run.broker.on("plotfeed/session") if of.get("speed") == speed]
    came_s = np.array([message.at_s for message in heard_of_gate(run, since)])
    if not said or not len(came_s) or came_s[-1] - came_s[0] < SEEN_S:
        return False
    reached = said[-1]["speed_reached"]
    assert reached <= speed
    due_s = np.array([end_ns(batch) / S for batch in run.broker.batches("gate", since)])
    behind_s = came_s - due_s[: len(came_s)] / reached
    third = (came_s[-1] - came_s[0]) / 3
    early = behind_s[came_s < came_s[0] + third].min()
    late = behind_s[came_s > came_s[-1] - third].min()
    return bool(abs(late - early) < 0.25 * 2 * third)


def heard_of_gate(run: Live, since: int) -> list[MqttMessage]:
    return [m for m in run.broker.client.heard[since:] if m.topic == "plotfeed/gate/plots"]
