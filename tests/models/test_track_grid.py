from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.track_metrics import (
    Grid,
    GridRows,
    TrackReports,
    on_grid,
    rates_by_differences,
)

NS = 1_000_000_000
T_NS = 1_767_268_800 * NS
GRID = Grid(start_utc_ns=T_NS, step_ns=NS, steps=10)


def reports(*rows: tuple[float, float, int], ended: tuple[int, ...] = ()) -> TrackReports:
    """Of a track that flies along the first axis at 2 m/s: time, when it came, number."""
    t_s, known_s, track = (np.array(column) for column in zip(*rows, strict=True))
    n = len(rows)
    return TrackReports(
        t_utc_ns=T_NS + np.round(t_s * NS).astype(np.int64),
        known_utc_ns=T_NS + np.round(known_s * NS).astype(np.int64),
        track=track.astype(np.int64),
        point=np.stack([2 * t_s, *[np.zeros(n)] * 3], axis=-1),
        rate=np.tile([2.0, 0.0, 0.0, 0.0], (n, 1)),
        ended=np.isin(np.arange(n), ended),
    )


def places(rows: GridRows) -> dict[tuple[int, int], float]:
    return {
        (int(k), int(track)): float(point[0])
        for k, track, point in zip(rows.step, rows.track, rows.point, strict=True)
    }


def test_a_track_is_moved_on_until_it_is_stale() -> None:
    found = places(on_grid(reports((0.5, 0.5, 0), (2.5, 2.5, 0)), GRID, 3.0, as_known=False))
    assert found == {(k, 0): pytest.approx(2.0 * k) for k in (1, 2, 3, 4, 5)}


def test_a_report_at_a_step_counts_there() -> None:
    rows = on_grid(reports((0.0, 0.0, 0), (1.0, 1.0, 0)), GRID, 1.0, as_known=False)
    assert rows.step.tolist() == [0, 1, 2]
    assert rows.age_s.tolist() == [0.0, 0.0, 1.0]


def test_one_that_ended_is_not_there() -> None:
    given = reports((0.0, 0.0, 0), (2.0, 2.0, 0), ended=(1,))
    assert on_grid(given, GRID, 5.0, as_known=False).step.tolist() == [0, 1]


def test_as_known_reports_count_from_when_they_came_and_age_since_they_hold() -> None:
    given = reports((0.0, 2.0, 0), (1.0, 2.5, 0), (2.0, 9.0, 0))
    rows = on_grid(given, GRID, 4.0, as_known=True)
    assert dict(zip(rows.step.tolist(), rows.age_s.tolist(), strict=True)) == {
        2: 2.0,
        3: 2.0,
        4: 3.0,
        5: 4.0,
    }


def test_as_known_what_a_later_report_has_overtaken_never_counts() -> None:
    given = reports((0.0, 5.0, 0), (1.0, 1.0, 0), (1.0, 1.0, 1), (2.0, 2.0, 1))
    rows = on_grid(given, GRID, 10.0, as_known=True)
    assert set(rows.report[rows.track == 0].tolist()) == {1}
    assert set(rows.report[rows.track == 1].tolist()) == {2, 3}


def test_rows_are_by_step_and_track_and_none_is_there_twice() -> None:
    rng = np.random.default_rng(1)
    given = reports(*sorted(((t, t + 0.1, k) for k in range(4) for t in rng.uniform(0, 9, 30)),
                            key=lambda row: (row[2], row[0])))  # fmt: skip
    for as_known in (False, True):
        rows = on_grid(given, GRID, 2.0, as_known=as_known)
        keys = rows.step * 10 + rows.track
        assert (np.diff(keys) > 0).all()
        for k, track, report in zip(rows.step, rows.track, rows.report, strict=True):
            of_track = np.flatnonzero(given.track == track)
            at_ns = (given.known_utc_ns if as_known else given.t_utc_ns)[of_track]
            assert report == of_track[at_ns <= T_NS + k * NS][-1]


def test_of_none_there_are_no_rows() -> None:
    none = reports((0.0, 0.0, 0)).rows(np.zeros(1, np.bool_))
    assert [len(on_grid(none, GRID, 5.0, as_known=each)) for each in (True, False)] == [0, 0]


def test_a_velocity_that_is_not_told_is_that_between_the_last_two_reports() -> None:
    given = reports((0.0, 0.0, 0), (1.0, 1.0, 0), (2.0, 2.0, 1), (20.0, 20.0, 1))
    rate = np.full((4, 4), np.nan)
    found = rates_by_differences(given.track, given.t_utc_ns, given.point, rate, 10.0)
    assert found[1].tolist() == [2.0, 0.0, 0.0, 0.0]
    assert np.isnan(found[[0, 2, 3]]).all()
