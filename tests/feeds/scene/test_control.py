from __future__ import annotations

import pytest

from plotfeed.feeds.scene.changes import MAX_COMMAND_OCTETS, ControlError, parsed


def test_a_command_is_of_a_sensor_or_of_the_clock() -> None:
    command = parsed(b'{"sensor": "radar", "set": {"link": {"latency_ms": 250}}}')
    assert (command.sensor, command.set) == ("radar", {"link": {"latency_ms": 250}})
    assert parsed(b'{"sensor": "radar", "reset": true}').reset
    clock = parsed(b'{"clock": {"speed": 10}}').clock
    assert clock is not None
    assert (clock.speed, clock.paused, clock.step_s) == (10.0, None, None)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "not JSON: expected such as"),
        (b"[]", "expected an object such as"),
        (b"{}", "expected one of sensor, drone, clock, story and undo"),
        (b'{"sensor": "radar"}', 'with a sensor, expected either "set" or "reset"'),
        (b'{"sensor": "radar", "set": {}, "reset": true}', 'either "set" or "reset"'),
        (
            b'{"sensor": "radar", "set": {}, "clock": {"paused": true}}',
            "one of sensor, drone, clock, story and undo",
        ),
        (b'{"story": "outage", "sensor": "radar"}', "expected one of sensor, drone, clock"),
        (b'{"story": "outage", "set": {}}', "set is of a sensor"),
        (b'{"undo": true, "reset": true}', "undo has no reset"),
        (b'{"undo": false}', "expected one of sensor, drone, clock"),
        (b'{"drone": "a"}', "with a drone, expected one of"),
        (b'{"drone": "a", "reset": true, "claim": {"freeze": true}}', "with a drone, expected one"),
        (b'{"sensor": "a", "reset": true, "claim": {"freeze": true}}', "are of a drone"),
        (b'{"drone": "a", "contingency": {"kind": "hold", "at_s": 3.0}}', "it happens at once"),
        (b'{"drone": "a", "contingency": {"kind": "tea"}}', "contingency.kind: expected one of"),
        (b'{"drone": "a", "claim": {"freeze": true, "to_s": 9.0}}', "it holds from now on"),
        (b'{"drone": "a", "claim": {}}', "drop_out, delay_s, bias_enu_m, walk_m, freeze or spoof"),
        (b'{"sensor": 5, "set": {}}', "sensor: input should be a valid string, not 5"),
        (b'{"clock": {}}', "clock: expected paused, speed or step_s"),
        (b'{"clock": {"speed": 0}}', "clock.speed: input should be greater"),
        (b'{"clock": {"sped": 2}}', "clock.sped: no such key; did you mean speed"),
        (b"x" * (MAX_COMMAND_OCTETS + 1), "at most 65536 are taken"),
        (b"[" * 60_000, "not JSON"),
    ],
)
def test_what_is_no_command_is_refused_in_a_line(payload: bytes, words: str) -> None:
    with pytest.raises(ControlError) as refused:
        parsed(payload)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
