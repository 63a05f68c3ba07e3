"""What somebody asks for on the page, and what becomes of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from support.chromium import until
from support.made_up_session import MadeUpSession
from support.page_server import Served, clock_button, wait_for_command

from plotfeed.feeds.link.counters import SessionCounters

if TYPE_CHECKING:
    from playwright.sync_api import Page


FORM_COMMANDS = [
    ({"Latency": "250"}, {"link": {"latency_ms": 250}}),
    ({"Jitter": "12.5"}, {"link": {"jitter_ms": 12.5}}),
    ({"Loss": "2"}, {"link": {"loss": {"kind": "random", "probability": 0.02}}}),
    (
        {"Loss": "2", "Mean burst": "4"},
        {"link": {"loss": {"kind": "gilbert-elliott", "mean_loss": 0.02, "mean_burst": 4}}},
    ),
    ({"Loss": "0"}, {"link": {"loss": None}}),
    ({"Pfa": "1e-4"}, {"pfa": 1e-4}),
    ({"Pfa": "1e-7", "Latency": "0"}, {"pfa": 1e-7, "link": {"latency_ms": 0}}),
]


def test_what_is_filled_in_is_asked_of_the_sensor_and_then_in_force(
    page: Page, stage: MadeUpSession
) -> None:
    for fields, expected in FORM_COMMANDS:
        for label, value in fields.items():
            page.get_by_label(label, exact=True).fill(value)
        page.get_by_role("button", name="Apply").click()
        wait_for_command(page, stage, {"sensor": "radar", "set": expected})
        page.get_by_text("In force.").wait_for()
        if "Latency" in fields:
            page.locator("#latency-now").get_by_text(f"{fields['Latency']} ms").wait_for()
        page.get_by_role("button", name="As in the scene").click()
        wait_for_command(page, stage, {"sensor": "radar", "reset": True})
        page.locator("#latency-now").get_by_text("120 ms").wait_for()
        stage.commands.clear()


def test_figures_are_told_by_as_many_digits_as_people_read(page: Page, served: Served) -> None:
    view = served.server._view
    served.call(lambda: view.settings("radar", {"pfa": 1.9999999999999998e-5, "link": None}))
    page.locator("#pfa-now").get_by_text("2e-5", exact=True).wait_for()


def test_no_state_is_chosen_of_a_sensor_that_is_worse_than_degraded(
    page: Page, served: Served
) -> None:
    view = served.server._view
    page.get_by_role("radio", name="On", exact=True, checked=True).wait_for()
    served.call(lambda: view.settings("radar", {"loss_db": 90.0}))
    page.locator("#sensors").get_by_text("degraded").wait_for()
    assert page.locator("input[name=state]:checked").count() == 0


def test_what_is_filled_in_while_an_answer_is_on_its_way_is_kept(
    page: Page, stage: MadeUpSession
) -> None:
    page.evaluate(
        """() => {
          const { feed } = plotfeed, ask = feed.ask.bind(feed), held = [];
          globalThis.held = held;
          feed.ask = async (command) => {
            const answer = await ask(command);
            await new Promise((arrives) => held.push(arrives));
            return answer;
          };
        }"""
    )
    answer = page.locator("#answer")
    latency, loss = (page.get_by_label(name, exact=True) for name in ("Latency", "Loss"))

    def press(name: str) -> None:
        page.get_by_role("button", name=name).click()
        until(page, "held.length === 1")

    def let_the_answer_arrive() -> None:
        answer.evaluate("(element) => { element.textContent = ''; }")
        page.evaluate("held.pop()()")
        answer.get_by_text("In force.").wait_for()

    latency.fill("250")
    loss.fill("1")
    press("Apply")
    loss.fill("2")
    let_the_answer_arrive()
    press("Apply")
    let_the_answer_arrive()
    of_loss = {"link": {"loss": {"kind": "random", "probability": 0.02}}}
    assert stage.commands[-1] == {"sensor": "radar", "set": of_loss}
    press("As in the scene")
    loss.fill("3")
    let_the_answer_arrive()
    assert (latency.input_value(), loss.input_value()) == ("120", "3")


def test_a_field_that_somebody_is_in_or_has_filled_in_is_left_alone(
    page: Page, served: Served
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
    view = served.server._view
    served.call(lambda: view.settings("radar", {"link": {"latency_ms": 500}}))
    page.locator("#latency-now").get_by_text("500 ms").wait_for()
    assert latency.input_value() == "78"
    assert page.get_by_label("Jitter").input_value() == "0"


def test_each_button_says_what_it_says(page: Page, stage: MadeUpSession) -> None:
    def press(name: str) -> None:
        page.get_by_role("button", name=name, exact=True).click()

    for name, expected in [
        ("Go on", {"clock": {"paused": False}}),
        ("Pause", {"clock": {"paused": True}}),
        ("Step 1 s", {"clock": {"step_s": 1}}),
    ]:
        clock_button(page, name).click()
        wait_for_command(page, stage, expected)
    for name, expected in [
        ("Restart", {"session": {"restart": True}}),
        ("Record", {"record": {"start": True}}),
    ]:
        press(name)
        wait_for_command(page, stage, expected)
    stop = page.get_by_role("button", name="Stop 0:00.0")
    stop.wait_for()
    stage.commands.clear()
    press("Restart")
    page.get_by_text("This ends the recording to").wait_for()
    assert not stage.commands
    press("Restart")
    wait_for_command(page, stage, {"session": {"restart": True}})
    stop.click()
    wait_for_command(page, stage, {"record": {"stop": True}})
    page.get_by_role("button", name="Record", exact=True).wait_for()  # else one would be ended
    for name, expected in [
        ("Load", {"session": {"scene": "road"}}),
        ("Replay", {"replay": {"load": "morning.mcap"}}),
        ("As in the scene", {"sensor": "radar", "reset": True}),
    ]:
        press(name)
        wait_for_command(page, stage, expected)
    page.get_by_label("Speed").select_option("10")
    wait_for_command(page, stage, {"clock": {"speed": 10}})


def test_a_sensor_is_switched_off_degraded_and_on_again(page: Page, stage: MadeUpSession) -> None:
    own = stage.scene.sensor[0]
    page.get_by_role("radio", name="Degraded").check()
    worse = {"enabled": True, "pfa": 1e-4, "loss_db": 10}
    wait_for_command(page, stage, {"sensor": "radar", "set": worse})
    state = page.locator("#sensors tr").first.locator("td").last
    state.get_by_text("degraded").wait_for()
    page.get_by_role("radio", name="Off").check()
    wait_for_command(page, stage, {"sensor": "radar", "set": {"enabled": False}})
    state.get_by_text("off").wait_for()
    page.get_by_role("radio", name="On", exact=True).check()
    as_before = {"enabled": True, "pfa": 1e-5, "loss_db": 4}
    wait_for_command(page, stage, {"sensor": "radar", "set": as_before})
    state.get_by_text("on").wait_for()
    assert stage.sensors["radar"].sensor.pfa == own.pfa


def test_another_sensor_is_chosen_hidden_and_asked(page: Page, stage: MadeUpSession) -> None:
    page.get_by_role("button", name="gate").click()
    page.get_by_role("heading", name="gate: settings").wait_for()
    assert page.get_by_label("Loss", exact=True).input_value() == "5"
    assert page.get_by_label("Mean burst").input_value() == "3"
    page.get_by_label("Latency", exact=True).fill("80")
    page.get_by_label("Latency", exact=True).press("Enter")
    wait_for_command(page, stage, {"sensor": "gate", "set": {"link": {"latency_ms": 80}}})
    page.get_by_role("checkbox", name="Show gate").uncheck()
    assert page.evaluate("[...plotfeed.display.hidden]") == ["gate"]
    until(page, "'gate' in (plotfeed.picture.news.details ?? {})")


def test_a_recording_is_scrubbed(page: Page, stage: MadeUpSession) -> None:
    page.get_by_role("button", name="Replay", exact=True).click()
    position = page.get_by_label("Position in the recording")
    until(page, "!document.getElementById('position').disabled")
    position.fill("12.5")
    wait_for_command(page, stage, {"replay": {"position_s": 12.5}})
    page.locator("#replay-pause").click()
    wait_for_command(page, stage, {"replay": {"paused": True}})
    page.get_by_text("0:12.5 / 1:30.0").wait_for()
    page.get_by_role("button", name="10 s ahead").click()
    page.get_by_text("0:22.5 / 1:30.0").wait_for()
    page.get_by_role("button", name="10 s back").click()
    page.get_by_text("0:12.5 / 1:30.0").wait_for()
    page.locator("#replay-stop").click()
    wait_for_command(page, stage, {"replay": {"stop": True}})
    page.get_by_text("no replay").wait_for()


def test_a_speed_that_is_not_reached_stands_beside_the_one_that_is(
    page: Page, served: Served
) -> None:
    view = served.server._view
    served.call(lambda: view.totals(SessionCounters(speed=10.0, speed_reached=5.93)))
    page.locator("#reached").get_by_text("reaches × 5.9", exact=True).wait_for()
    served.call(lambda: view.totals(SessionCounters(speed=10.0, speed_reached=9.99)))
    until(page, "!document.getElementById('reached').textContent")


def test_what_is_not_allowed_is_disabled_and_said(page: Page, served: Served) -> None:
    view, why = served.server._view, "A replay is not changed."
    refuses = dict.fromkeys(("sensor", "record", "step"), why)
    served.call(lambda: view.session({"refuses": refuses, "notes": ["Times are recorded."]}))
    page.get_by_text(f"Times are recorded. {why}").wait_for()
    assert page.evaluate("document.getElementById('sensor-form').inert")
    assert page.get_by_role("button", name="Record").is_disabled()
    assert clock_button(page, "Go on").is_enabled()
    served.call(lambda: view.session({"refuses": {}, "notes": []}))
    until(page, "!document.getElementById('sensor-form').inert")
    why = "Real time cannot be held."
    refuses = dict.fromkeys(("pause", "step", "speed"), why)
    served.call(lambda: view.session({"refuses": refuses}))
    page.get_by_text(why).wait_for()
    for name in ("Go on", "Step 1 s"):
        assert clock_button(page, name).is_disabled()
    assert page.get_by_label("Speed").is_disabled()
    assert page.get_by_role("button", name="Restart").is_enabled()


def test_what_is_refused_or_no_number_says_why_and_changes_nothing(
    page: Page, stage: MadeUpSession
) -> None:
    answer, pfa = page.locator("#answer"), page.get_by_label("Pfa", exact=True)
    pfa.fill("2")
    page.get_by_role("button", name="Apply").click()
    page.locator("#answer[data-failed]").get_by_text("pfa").wait_for()
    assert pfa.input_value() == "2"  # to be mended
    for field, text in (("Pfa", "1e-x"), ("Pfa", "many"), ("Latency", "1e")):
        pfa.fill("1e-5")
        page.get_by_role("button", name="Apply").click()
        answer.get_by_text("In force.").wait_for()
        stage.commands.clear()
        page.get_by_label(field, exact=True).press_sequentially("")
        page.get_by_label(field, exact=True).select_text()
        page.keyboard.type(text)
        page.get_by_role("button", name="Apply").click()
        answer.get_by_text(f"{field}: a number such as").wait_for()
        assert answer.get_attribute("data-failed") is not None
        assert page.locator("#pfa-now").text_content() == "1e-5"
        assert not stage.commands
