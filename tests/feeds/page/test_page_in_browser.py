"""What people do on the page: what they ask for and what becomes of it, who may, and from where."""

from __future__ import annotations

import struct
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from support import made_up_session
from support.brokers import free_port
from support.chromium import looking, new_context, requests, until, until_shown, wait_beside
from support.made_up_session import MadeUpSession
from support.page_server import Served, clock_button, on_stage, wait_for_command

from plotfeed import testing
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.page.page_access import PageAddress, Tokens
from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.view import View

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

WIDE = "0.0.0.0"  # noqa: S104 - with a token


def press(page: Page, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def fill(page: Page, **fields: str) -> None:
    """Fields of the sensor by their labels, and apply them."""
    for label, value in fields.items():
        page.get_by_label(label.replace("_", " "), exact=True).fill(value)
    press(page, "Apply")


def tell_keys(served: Served, **keys: Any) -> None:
    """Keys of the radar that are in force, whoever asked for them."""
    settings = {**served.server._view._news["settings"], "radar": keys}
    served.view.tell(settings=settings)


BURSTS = {"kind": "gilbert-elliott", "mean_loss": 0.02, "mean_burst": 4}
FORM_COMMANDS: list[tuple[dict[str, str], dict[str, Any]]] = [
    ({"Latency": "250"}, {"link": {"latency_ms": 250}}),
    ({"Jitter": "12.5"}, {"link": {"jitter_ms": 12.5}}),
    ({"Loss": "2"}, {"link": {"loss": {"kind": "random", "probability": 0.02}}}),
    ({"Loss": "2", "Mean_burst": "4"}, {"link": {"loss": BURSTS}}),
    ({"Loss": "0"}, {"link": {"loss": None}}),
    ({"Pfa": "1e-7", "Latency": "0"}, {"pfa": 1e-7, "link": {"latency_ms": 0}}),
]


def test_what_is_filled_in_is_asked_of_the_sensor_and_then_in_force(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    for fields, expected in FORM_COMMANDS:
        fill(page, **fields)
        wait_for_command(page, stage, {"sensor": "radar", "set": expected})
        page.get_by_text("In force.").wait_for()
        if "Latency" in fields:
            page.locator("#latency-now").get_by_text(f"{fields['Latency']} ms").wait_for()
        press(page, "As in the scene")
        wait_for_command(page, stage, {"sensor": "radar", "reset": True})
        page.locator("#latency-now").get_by_text("120 ms").wait_for()
        stage.commands.clear()
    # What is refused or no number says why and changes nothing.
    answer, pfa = page.locator("#answer"), page.get_by_label("Pfa", exact=True)
    fill(page, Pfa="2")
    page.locator("#answer[data-failed]").get_by_text("pfa").wait_for()
    assert pfa.input_value() == "2"  # to be mended
    fill(page, Pfa="1e-5")
    answer.get_by_text("In force.").wait_for()
    stage.commands.clear()
    for field, text in (("Pfa", "many"), ("Latency", "1e")):
        page.get_by_label(field, exact=True).select_text()
        page.keyboard.type(text)
        press(page, "Apply")
        answer.get_by_text(f"{field}: a number such as").wait_for()
        assert answer.get_attribute("data-failed") is not None
        assert page.locator("#pfa-now").text_content() == "1e-5"
        assert not stage.commands
        page.get_by_label(field, exact=True).fill("1e-5" if field == "Pfa" else "120")
    # Figures are told by as many digits as people read.
    tell_keys(served, pfa=1.9999999999999998e-5, link=None)
    page.locator("#pfa-now").get_by_text("2e-5", exact=True).wait_for()


def test_what_somebody_fills_in_is_left_alone_until_it_is_asked_for(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    latency = page.get_by_label("Latency", exact=True)
    latency.focus()
    page.evaluate("plotfeed.feed.ask({ sensor: 'radar', set: { link: { latency_ms: 77 } } })")
    page.locator("#latency-now").get_by_text("77 ms").wait_for()
    assert latency.input_value() == "120"
    latency.blur()
    assert latency.input_value() == "77"
    latency.fill("78")
    latency.blur()
    tell_keys(served, link={"latency_ms": 500})
    page.locator("#latency-now").get_by_text("500 ms").wait_for()
    assert latency.input_value() == "78"
    assert page.get_by_label("Jitter").input_value() == "0"
    # Also while the answer to what was asked before is on its way.
    page.evaluate(
        """() => {
          const { feed } = plotfeed, ask = feed.ask.bind(feed), held = globalThis.held = [];
          feed.ask = async (command) => {
            const answer = await ask(command);
            await new Promise((arrives) => held.push(arrives));
            return answer;
          };
        }"""
    )
    loss, answer = page.get_by_label("Loss", exact=True), page.locator("#answer")
    loss.fill("1")
    for button, then in (("Apply", "2"), ("Apply", "2"), ("As in the scene", "3")):
        press(page, button)
        until(page, "held.length === 1")
        if loss.input_value() != then:
            loss.fill(then)
        page.evaluate("document.getElementById('answer').textContent = ''; held.pop()()")
        answer.get_by_text("In force.").wait_for()
    of_loss = {"link": {"loss": {"kind": "random", "probability": 0.02}}}
    wanted = {"set": of_loss}, {"reset": True}
    assert stage.commands[-2:] == [{"sensor": "radar", **each} for each in wanted]
    assert (latency.input_value(), loss.input_value()) == ("120", "3")


def test_a_sensor_is_switched_off_degraded_and_on_again_and_another_one_chosen(
    page: Page, stage: MadeUpSession, served: Served
) -> None:
    page.get_by_role("radio", name="On", exact=True, checked=True).wait_for()
    state = page.locator("#sensors tr").first.locator("td").last
    for name, keys in (
        ("Degraded", {"enabled": True, "pfa": 1e-4, "loss_db": 10}),
        ("Off", {"enabled": False}),
        ("On", {"enabled": True, "pfa": 1e-5, "loss_db": 4}),
    ):
        page.get_by_role("radio", name=name, exact=True).check()
        wait_for_command(page, stage, {"sensor": "radar", "set": keys})
        state.get_by_text(name.lower(), exact=True).wait_for()
    assert stage.sensors["radar"].sensor.pfa == stage.scene.sensor[0].pfa  # type: ignore[union-attr]
    # No state is chosen of a sensor that is worse than degraded.
    tell_keys(served, loss_db=90.0)
    page.locator("#sensors").get_by_text("degraded").wait_for()
    assert page.locator("input[name=state]:checked").count() == 0
    page.locator("#sensors").get_by_role("button", name="gate").click()
    page.get_by_role("heading", name="gate: settings").wait_for()
    assert page.get_by_label("Loss", exact=True).input_value() == "5"
    assert page.get_by_label("Mean burst").input_value() == "3"
    page.get_by_label("Latency", exact=True).fill("80")
    page.get_by_label("Latency", exact=True).press("Enter")
    wait_for_command(page, stage, {"sensor": "gate", "set": {"link": {"latency_ms": 80}}})
    page.get_by_role("checkbox", name="Show gate").uncheck()
    assert page.evaluate("[...plotfeed.display.hidden]") == ["gate"]
    until(page, "'gate' in (plotfeed.picture.news.details ?? {})")


def test_each_button_says_what_it_says_and_one_time_line_serves_recordings_too(
    page: Page, stage: MadeUpSession
) -> None:
    def asks(name: str, **expected: Any) -> None:
        stage.commands.clear()
        press(page, name)
        wait_for_command(page, stage, expected)

    clocks = {"Go on": {"paused": False}, "Pause": {"paused": True}, "Step 1 s": {"step_s": 1}}
    for name, clock in clocks.items():
        clock_button(page, name).click()
        wait_for_command(page, stage, {"clock": clock})
    asks("Restart", session={"restart": True})
    asks("Record", record={"start": True})
    page.get_by_role("button", name="Stop 0:00.0").wait_for()
    stage.commands.clear()
    press(page, "Restart")
    page.get_by_text("This ends the recording to").wait_for()
    assert not stage.commands
    asks("Restart", session={"restart": True})
    asks("Stop 0:00.0", record={"stop": True})
    page.get_by_role("button", name="Record", exact=True).wait_for()  # else one would be ended
    asks("Load", session={"scene": "road"})
    asks("As in the scene", sensor="radar", reset=True)
    page.get_by_label("Speed").select_option("10")
    wait_for_command(page, stage, {"clock": {"speed": 10}})
    asks("Replay", replay={"load": "morning.mcap"})
    words, position = page.locator("#back-text"), page.get_by_label("Position in the recording")
    words.get_by_text("0:00.0 / 1:30.0").wait_for()
    position.fill("12.5")
    wait_for_command(page, stage, {"replay": {"position_s": 12.5}})
    words.get_by_text("0:12.5 / 1:30.0").wait_for()
    hold = page.locator("#hold")
    for said, then, paused in (("Pause", "Play", True), ("Play", "Pause", False)):
        hold.get_by_text(said).wait_for()
        hold.click()
        wait_for_command(page, stage, {"replay": {"paused": paused}})
        hold.get_by_text(then).wait_for()
    asks("10 s ahead", replay={"skip_s": 10})
    words.get_by_text("0:22.5 / 1:30.0").wait_for()
    asks("10 s back", replay={"skip_s": -10})
    words.get_by_text("0:12.5 / 1:30.0").wait_for()
    asks("Back to a session", replay={"stop": True})
    words.get_by_text("Now", exact=True).wait_for()
    assert page.get_by_label("Look back").get_attribute("max") == "0"


def test_what_is_not_allowed_is_disabled_and_said_and_so_is_a_speed_that_is_not_reached(
    page: Page, served: Served
) -> None:
    why = "A replay is not changed."
    refuses = dict.fromkeys(("sensor", "record", "step"), why)
    served.view.session({"refuses": refuses, "notes": ["Times are recorded."]})
    page.get_by_text(f"Times are recorded. {why}").wait_for()
    assert page.evaluate("document.getElementById('sensor-form').inert")
    assert page.get_by_role("button", name="Record").is_disabled()
    assert clock_button(page, "Go on").is_enabled()
    served.view.session({"refuses": {}, "notes": []})
    until(page, "!document.getElementById('sensor-form').inert")
    why = "Real time cannot be held."
    served.view.session({"refuses": dict.fromkeys(("pause", "step", "speed"), why)})
    page.get_by_text(why).wait_for()
    for name in ("Go on", "Step 1 s"):
        assert clock_button(page, name).is_disabled()
    assert page.get_by_label("Speed").is_disabled()
    assert page.get_by_role("button", name="Restart").is_enabled()
    for reached, told in ((5.93, "reaches × 5.9"), (9.99, "")):
        served.view.totals(SessionCounters(speed=10.0, speed_reached=reached))
        until(page, f"document.getElementById('reached').textContent === '{told}'")


@pytest.mark.usefixtures("goes_on")
def test_the_audience_sees_and_does_what_the_presenter_gives(
    browser: Browser, page: Page, served: Served, stage: MadeUpSession
) -> None:
    with looking(browser, f"{served.url}audience/") as other:
        truth, pause = other.get_by_role("button", name="Truth"), clock_button(other, "Pause")
        assert truth.is_disabled()
        for name in ("Pause", "Step 1 s", "Restart", "Record", "Load", "Replay"):
            assert other.get_by_role("button", name=name).first.is_disabled(), name
        assert other.get_by_role("button", name="Connect here").is_enabled()
        assert other.evaluate("document.getElementById('sensor-form').inert")
        until(other, "document.getElementById('total-drones').textContent === '–'")
        other.get_by_text("has not given the audience the controls").first.wait_for()
        press(page, "Audience")
        assert page.get_by_label("Its address").input_value() == f"{served.url}audience/"
        page.get_by_role("checkbox", name="It may use the controls").check()
        until(other, "!document.getElementById('pause').disabled")
        pause.click()
        wait_for_command(other, stage, {"clock": {"paused": True}})
        page.get_by_role("checkbox", name="It may see the truth").check()
        until(other, "!document.getElementById('truth').disabled")
        truth.click()
        until(other, "plotfeed.picture.drones !== null")
        page.get_by_role("checkbox", name="It may see the truth").uncheck()
        until(other, "plotfeed.picture.drones === null")
        until(other, "document.getElementById('truth').disabled")
        done = page.get_by_label("Actions, the newest first")
        for told in (
            "presenter 1 audience: controls",
            "audience 1 clock: paused",
            "presenter 1 audience: truth false",
        ):
            done.get_by_text(told).last.wait_for()


FIGURES = {
    "gospa_m": 12.34, "ospa_m": 8.7, "completeness": 0.75, "spuriousness": 0.25,
    "position_error_m": 5.61, "latency_s": 0.042, "latency_p95_s": None,
}  # fmt: skip
AZIMUTH = {
    "sensor": "radar-3", "check": "azimuth", "unit": "deg", "claimed": 0.0, "found": 2.013,
    "z": 37.1, "of": 58, "wrong": True, "why_not": "",
}  # fmt: skip


def score(second: int, *feed: dict[str, Any]) -> dict[str, Any]:
    return {
        "time_utc": f"2026-01-01T12:00:{second:02}Z", "tracks_topic": "tracker/tracks",
        "cutoff_m": 50.0, "drones": 4, "tracks": 4,
        "reports": 100, "unreadable": 3, "problem": "a track of the future", "now": FIGURES,
        "window_s": second, "window": FIGURES, "feed_false_rate": 0.01, "feed": list(feed),
    }  # fmt: skip


def test_the_score_is_shown_with_the_truth_alone_and_a_fleet_where_it_is_told_of(
    page: Page, served: Served
) -> None:
    card, fleet = (page.locator(f"[data-card={name}]") for name in ("score", "fleet"))
    truth = page.get_by_role("button", name="Truth")
    served.view.score(score(1))
    frames = page.evaluate("plotfeed.picture.framesTaken")
    until(page, f"plotfeed.picture.framesTaken > {frames + 3}")
    assert not card.is_visible()
    assert not fleet.is_visible()
    truth.click()
    until(page, "document.getElementById('score-body').checkVisibility()")
    words = card.inner_text()
    for told in ("12.3 m", "75 %", "25 %", "5.6 m", "0.04 s", "3 reports of tracks left out"):
        assert told in words
    assert "nothing to judge yet" in words
    served.view.score(score(2, AZIMUTH))
    told = "Feed differs from its claims: radar-3: azimuth 2.01 deg"
    until(page, f"document.getElementById('score-feed').textContent === '{told}'")
    unheard = dict.fromkeys(FIGURES)
    silent = {"reports": 0, "tracks": 0, "unreadable": 0, "now": unheard, "window": unheard}
    served.view.score(score(3) | silent)
    until(page, "document.getElementById('score-values').hidden")
    words = card.inner_text()
    assert "No tracks have come on tracker/tracks" in words
    assert "GOSPA" not in words
    assert not page.locator("#score-strip").is_visible()
    truth.click()
    until(page, "document.getElementById('score-body').hidden")
    assert "Shown with the truth" in card.inner_text()
    assert "radar-3" not in card.inner_text()
    row = {"sensors": ["a", "b", "c", "d"], "state": "RUNNING", "worker": "host:7", "claim": 2}
    told_of = {"part": "0-0", "age_s": 0.34, "lateness_p99_us": 1200.0} | row
    gaps = ["nothing of part 0-0: 0.50 s, since host:6 died"]
    served.view.tell(fleet={"parts": [told_of], "takeovers": 1, "gaps": 1, "last_gaps": gaps})
    until(page, "document.getElementById('fleet-rows').checkVisibility()")
    line = "0-0.2 RUNNING host:7: a, b and 2 more; heard 0.3 s ago, late by 1.20 ms (p99)"
    for said in ("Parts 1, take-overs 1", line, *gaps):
        assert said in fleet.inner_text()


# Whether the strip tells what was detected beside what the looks' own odds come to.
PREDICTED_AS_TOLD = """(() => {
  const sum = (numbers) => numbers.reduce((a, b) => a + b, 0);
  const shown = document.getElementById("pd-text").textContent;
  return Object.values(plotfeed.picture.news.details ?? {}).some(({ detections: of }) => {
    const [detected, expected] = [of.detected, of.expected].map((all) => sum(all) / sum(of.looks));
    return detected !== expected
      && shown === `${detected.toFixed(3)}, predicted ${expected.toFixed(3)}`;
  });
})()"""


def test_two_browsers_see_the_same_and_what_either_changes_and_may_save_the_picture(
    browser: Browser, page: Page, served: Served
) -> None:
    words = "document.getElementById('latency-text').textContent"
    until(page, rf"/^asked 120, is 1[12]\d ± \d+ ms$/.test({words})")
    until(page, PREDICTED_AS_TOLD)
    with looking(browser, served.url) as other:
        fill(page, Latency="333")
        other.locator("#latency-now").get_by_text("333 ms").wait_for()
        assert other.get_by_label("Latency", exact=True).input_value() == "333"
        fill(other, Jitter="20")
        page.locator("#jitter-now").get_by_text("20 ms").wait_for()
        clock_button(page, "Go on").click()
        clock_button(other, "Pause").click()
        clock_button(page, "Go on").wait_for()
        page.get_by_role("button", name="Truth").click()
        until(page, "plotfeed.picture.drones !== null")
        assert other.evaluate("plotfeed.picture.drones") is None
    until(page, "document.getElementById('total-plots').textContent !== '0'")
    assert page.locator("#total-drones").inner_text() == "16"
    served.view.tell(refusal="plotfeed/telemetry/x: missing: time_utc")
    page.get_by_text("Last refused: plotfeed/telemetry/x: missing: time_utc").wait_for()
    with page.expect_download() as saving:
        press(page, "PNG")
    assert saving.value.suggested_filename.startswith("plotfeed-road-")
    data = Path(saving.value.path()).read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", data[16:24])
    assert width == page.evaluate("document.getElementById('screen').width")
    assert 0 < height - page.evaluate("document.getElementById('screen').height") < 100


def test_a_lost_connection_is_said_and_comes_back_by_itself_and_an_old_token_is_said(
    browser: Browser, stage: MadeUpSession
) -> None:
    address = PageAddress(WIDE, free_port())
    again = MadeUpSession(View(), made_up_session.scene(5))
    url = f"http://127.0.0.1:{address.port}/?token=one"
    with ExitStack() as first, ExitStack() as second:
        first.enter_context(on_stage(stage, address=address, tokens=Tokens("one")))
        page = second.enter_context(looking(browser, url))
        assert "token" not in page.url
        veil = page.locator("#veil")
        page.get_by_role("button", name="Truth").click()
        until(page, "plotfeed.picture.drones !== null")
        assert veil.is_hidden()
        first.close()
        veil.get_by_text("Connection lost").wait_for()
        assert "lost" in page.locator("#connection").inner_text()
        asked = page.evaluate("plotfeed.feed.ask({ clock: { paused: true } })")
        assert asked["ok"] is False
        with on_stage(again, address=address, tokens=Tokens("one")):
            veil.wait_for(state="hidden")
            until(page, "plotfeed.picture.drones?.rows === 5")  # the truth is asked again
            page.get_by_text("Connected").wait_for()
            fill(page, Latency="250")
            wanted = {"sensor": "radar", "set": {"link": {"latency_ms": 250}}}
            wait_for_command(page, again, wanted)
            page.locator("#latency-now").get_by_text("250 ms").wait_for()
        with on_stage(stage, address=address, tokens=Tokens("other")):
            veil.get_by_text("The address has changed").wait_for()


def test_no_request_leaves_for_anybody_else(browser: Browser, served: Served) -> None:
    context = new_context(browser)
    page = context.new_page()
    asked = requests(context, page)
    page.goto(served.url)
    until_shown(page)
    for name in ("Truth", "Light", "Zoom in", "Show all sensors"):
        press(page, name)
    for name in ("Go on", "Pause", "Step 1 s", "Restart"):
        clock_button(page, name).click()
    fill(page, Latency="10")
    page.get_by_text("In force.").wait_for()
    basemap = Basemap("application/json", b'{"lines": [], "areas": [], "points": []}')
    scene = testing.scene([testing.radar(id="north")], seed=1)
    served.view.scene(scene, basemap)
    page.get_by_role("heading", name="north: settings").wait_for()
    host = f"127.0.0.1:{served.port}"
    wait_beside(page, lambda: any(url.startswith(f"http://{host}/basemap") for url in asked))
    context.close()
    assert len(asked) > 10
    assert f"ws://{host}/feed" in asked
    assert not [url for url in asked if not url.startswith((f"http://{host}/", f"ws://{host}/"))]
