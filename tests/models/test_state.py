"""Structures of arrays: rows and joins keep every column, those that are not there included."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.state import FALSE_ALARM, Emitter, Plots
from plotfeed.models.truth import EmitterTable

OPTIONAL = (
    "kind_probability",
    "range_rate_m_s",
    "sigma_range_rate_m_s",
    "true_range_rate_m_s",
    "merged_drones",
    "sensor",
)


def plots(t_utc_ns: list[int], with_columns: frozenset[str]) -> Plots:
    n = len(t_utc_ns)
    columns: dict[str, Any] = {"t_utc_ns": np.array(t_utc_ns, np.int64)}
    if "range_m" in with_columns:
        columns["range_m"] = np.arange(n) + 1.5
    if "range_rate_m_s" in with_columns:
        columns["range_rate_m_s"] = np.arange(n) - 0.5
    if "merged_drones" in with_columns:
        columns["merged_drones"] = np.empty(n, np.object_)
        columns["merged_drones"][:] = [(i, i + 1) for i in range(n)]
    return Plots.of(**columns)


def listed(found: Plots) -> dict[str, list[str]]:
    """Every column as text, so that NaN equals NaN; absent ones as what they say row by row."""
    told = {}
    for field in fields(found):
        column = getattr(found, field.name)
        nothing = () if field.name == "merged_drones" else np.nan
        told[field.name] = [str(x) for x in ([nothing] * len(found) if column is None else column)]
    return told


some_columns = st.frozensets(st.sampled_from(["range_m", "range_rate_m_s", "merged_drones"]))
some_plots = st.builds(plots, st.lists(st.integers(0, 9), max_size=6), some_columns)


@given(st.lists(some_plots, min_size=1, max_size=4))
def test_joined_plots_are_the_rows_of_each_in_their_order(parts: list[Plots]) -> None:
    each = [listed(part) for part in parts]
    whole = listed(Plots.joined(parts))
    assert whole == {name: [x for told in each for x in told[name]] for name in whole}


@given(some_plots, st.data())
def test_rows_are_those_rows_of_every_column(found: Plots, data: st.DataObject) -> None:
    mask = np.array(
        data.draw(st.lists(st.booleans(), min_size=len(found), max_size=len(found))), bool
    )
    all_rows = listed(found)
    expected = {
        name: [value for value, chosen in zip(column, mask, strict=True) if chosen]
        for name, column in all_rows.items()
    }
    assert listed(found.rows(mask)) == expected
    assert listed(found.rows(np.flatnonzero(mask))) == expected


@given(some_plots)
def test_plots_in_the_order_of_time_keep_ties_as_they_were(found: Plots) -> None:
    order = sorted(range(len(found)), key=lambda i: found.t_utc_ns[i])
    told = listed(found)
    expected = {name: [column[i] for i in order] for name, column in told.items()}
    assert listed(found.in_order_of_time()) == expected


def test_what_is_not_measured_takes_no_memory_and_says_so() -> None:
    found = Plots.of(t_utc_ns=np.zeros(1_000_000, np.int64))
    assert (found.drone == FALSE_ALARM).all()
    assert (found.channel == 0).all()
    assert np.isnan(found.range_m).all()
    assert found.kind[0] == found.identity[-1] == ""
    for field in fields(found):
        column = getattr(found, field.name)
        if field.name in OPTIONAL:
            assert column is None
        elif field.name != "t_utc_ns":
            assert column.strides == (0,)
            assert not column.flags.writeable
    both = Plots.joined([found, found])
    assert both.range_m.strides == (0,)
    assert len(both) == len(both.range_m) == 2_000_000


def test_what_is_no_column_is_refused() -> None:
    with pytest.raises(TypeError, match="azimut_deg"):
        Plots.of(t_utc_ns=np.zeros(1, np.int64), azimut_deg=np.zeros(1))
    with pytest.raises(AttributeError, match="azimut_deg"):
        _ = Plots.of(t_utc_ns=np.zeros(1, np.int64)).azimut_deg  # type: ignore[attr-defined]


def test_a_column_is_measured_if_it_was_given() -> None:
    one = Plots.of(t_utc_ns=np.zeros(1, np.int64), range_m=np.ones(1))
    other = Plots.of(t_utc_ns=np.ones(1, np.int64))
    assert one.measures("range_m")
    assert not other.measures("range_m")
    assert Plots.joined([other, one]).measures("range_m")
    assert one.but(height_m=np.ones(1)).measures("height_m")
    assert not one.measures("height_m")


# Emitters by columns are those of the drones, whatever was set anew in what order.


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
