from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.track_metrics import Segments, TrackHolder, followed, segments_of, swaps_of


def held(apart: np.ndarray, confirm: int = 2, end: int = 3) -> set[tuple[int, int, int]]:
    """Step, drone and track of all that is held, of distances (steps, drones, tracks)."""
    steps, drones, tracks = apart.shape
    holder = TrackHolder(drones, tracks, 10.0, confirm_steps=confirm, end_steps=end)
    found = set()
    for k in range(steps):
        of, whose, since = holder.step(k, np.arange(drones), np.arange(tracks), apart[k])
        for track, drone, first in zip(of, whose, since, strict=True):
            found |= {(step, int(drone), int(track)) for step in range(first, k + 1)}
    return found


def test_a_track_counts_from_its_first_step_once_a_second_confirms_it() -> None:
    apart = np.full((4, 1, 1), 1.0)
    apart[0] = 50.0
    assert held(apart) == {(1, 0, 0), (2, 0, 0), (3, 0, 0)}
    apart[2:] = 50.0
    assert held(apart) == set()


def test_a_crossing_is_no_swap_and_parting_is_one() -> None:
    """Two drones cross within the gate; then the tracks fly on with the other drone each."""
    along = np.linspace(-40, 40, 21)
    drones = np.stack([along, -along], axis=1)
    crossing = np.abs(drones[:, :, None] - drones[:, None, :])
    rows = held(crossing)
    assert rows == {(k, d, d) for k in range(21) for d in range(2)}
    exchanged = np.where(along[:, None] < 0, drones, drones[:, ::-1])
    rows = held(np.abs(drones[:, :, None] - exchanged[:, None, :]))
    step, drone, track = np.array(sorted(rows)).T
    assert swaps_of(segments_of(track, drone, step, 3)) == 2


def test_out_of_the_gate_for_two_steps_is_still_the_same() -> None:
    apart = np.full((10, 1, 1), 1.0)
    apart[3:5] = 50.0
    rows = np.array(sorted(held(apart)))
    assert len(segments_of(rows[:, 2], rows[:, 1], rows[:, 0], 3)) == 1
    apart[3:7] = 50.0
    rows = np.array(sorted(held(apart)))
    parts = segments_of(rows[:, 2], rows[:, 1], rows[:, 0], 3)
    assert parts.first.tolist() == [0, 7]
    assert parts.last.tolist() == [2, 9]


def test_a_track_that_is_near_another_drone_for_two_steps_stays_whose_it_was() -> None:
    apart = np.full((12, 2, 1), 50.0)
    apart[:, 0] = 1.0
    apart[5:7] = np.array([[50.0], [1.0]])
    assert {drone for _, drone, _ in held(apart)} == {0}
    apart[5:] = np.array([[50.0], [1.0]])
    assert {(k, drone) for k, drone, _ in held(apart) if k >= 5} == {(k, 1) for k in range(7, 12)}


def test_two_tracks_may_be_of_one_drone() -> None:
    assert held(np.full((3, 1, 2), 1.0)) == {(k, 0, j) for k in range(3) for j in range(2)}


def segments(*rows: tuple[int, int, int]) -> Segments:
    track, first, last = (np.array(column) for column in zip(*rows, strict=True))
    return Segments(track=track, drone=np.zeros(len(rows), np.int64), first=first, last=last)


THERE = np.arange(20)


@pytest.mark.parametrize(
    ("rows", "changes", "breaks", "longest"),
    [
        ([(1, 0, 19)], 0, 0, 20),
        ([(1, 0, 9), (2, 10, 19)], 1, 0, 10),
        ([(1, 0, 9), (1, 15, 19)], 0, 1, 10),
        ([(1, 0, 9), (2, 5, 19)], 1, 0, 15),
        ([(1, 0, 12), (2, 3, 8), (3, 10, 19)], 1, 0, 13),
        ([(1, 2, 5), (2, 2, 19)], 0, 0, 18),
        ([(1, 0, 3), (2, 6, 9), (3, 12, 19)], 2, 2, 8),
    ],
)
def test_the_fewest_tracks_that_follow_a_drone(
    rows: list[tuple[int, int, int]], changes: int, breaks: int, longest: int
) -> None:
    found = followed(segments(*rows), THERE)
    assert (found.number_changes, found.breaks, found.longest_steps) == (changes, breaks, longest)


def test_while_a_drone_is_not_there_no_track_of_it_is_broken() -> None:
    there = np.concatenate([np.arange(8), np.arange(15, 20)])
    assert followed(segments((1, 0, 7), (2, 15, 19)), there).breaks == 0
    assert followed(segments((1, 0, 6), (2, 15, 19)), there).breaks == 1


def test_a_drone_without_tracks_has_none() -> None:
    found = followed(Segments(**{n: np.zeros(0, np.int64) for n in
                                 ("track", "drone", "first", "last")}), THERE)  # fmt: skip
    assert (found.tracks, found.first_step, found.longest_steps) == (0, -1, 0)
