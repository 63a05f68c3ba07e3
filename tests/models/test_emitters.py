"""Emitters by columns are those of the drones, whatever was set anew in what order."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.state import Emitter
from plotfeed.models.truth import EmitterTable

emitters = st.builds(
    Emitter,
    frequency_hz=st.floats(1e6, 1e10),
    bandwidth_hz=st.floats(0, 1e8),
    eirp_dbm=st.floats(-50, 50),
    kind=st.sampled_from(["", "control", "video"]),
    identity=st.text(max_size=3),
)
of_a_drone = st.lists(emitters, max_size=3).map(tuple)


def told(table: EmitterTable, drones: list[int]) -> list[tuple[int, int, Emitter]]:
    found = table.emissions(np.array(drones, np.int64))
    rows = zip(
        found.target, found.channel, found.frequency_hz, found.bandwidth_hz, found.eirp_dbm,
        table.kinds(found), table.identities(found), strict=True,
    )  # fmt: skip
    return [
        (
            int(target),
            int(channel),
            Emitter(frequency_hz=f, bandwidth_hz=b, eirp_dbm=e, kind=k, identity=i),
        )
        for target, channel, f, b, e, k, i in rows
    ]


@given(st.lists(of_a_drone, min_size=1, max_size=6), st.data())
def test_columns_are_those_of_the_drones(
    first: list[tuple[Emitter, ...]], data: st.DataObject
) -> None:
    table, expected = EmitterTable(first), list(first)
    for _ in range(data.draw(st.integers(0, 12))):
        if data.draw(st.booleans()):
            new = data.draw(of_a_drone)
            drone = data.draw(st.integers(0, len(expected)))
            if drone == len(expected):
                table.append(new)
                expected.append(new)
            else:
                table[drone] = new
                expected[drone] = new
        drones = data.draw(st.lists(st.integers(0, len(expected) - 1), max_size=6))
        assert told(table, drones) == [
            (row, channel, emitter)
            for row, drone in enumerate(drones)
            for channel, emitter in enumerate(expected[drone])
        ]
    assert list(table) == expected
    assert len(table) == len(expected)
    assert EmitterTable.of(table) is table


def test_a_drone_that_changes_for_ever_takes_no_more_room() -> None:
    table = EmitterTable([(), ()])
    for i in range(5000):
        table[1] = (Emitter(frequency_hz=float(i + 1)),) * 3
        assert told(table, [1])[0][2].frequency_hz == i + 1
    numbers = table._numbers
    assert numbers is not None
    assert numbers.shape[1] < 50
