"""What is missing in a journal of runs, and what it gives of more runs than are asked for."""

from __future__ import annotations

from pathlib import Path

from plotfeed.feeds.lab.runs import Journal, SweepLevel, seed_of

LEVELS = [SweepLevel(number, "made", "made.toml", "", ()) for number in range(2)]


def test_what_is_missing_is_what_was_asked_and_not_kept_a_run_of_all_levels_at_a_time(
    tmp_path: Path,
) -> None:
    with Journal(tmp_path / "journal.jsonl", {}) as kept:
        for level, run in [(1, 2), (1, 0), (0, 0), (0, 3)]:
            kept.take({"level": level, "run": run})
        missing = [(level.number, run) for level, run in kept.missing(LEVELS, 3)]
        assert missing == [(0, 1), (1, 1), (0, 2)]
        assert list(kept.of_first(3)) == [(0, 0), (1, 0), (1, 2)]
        assert list(kept.of_first(1)) == [(0, 0), (1, 0)]


def test_seeds_are_the_next_whole_numbers_and_begin_again_after_the_last() -> None:
    assert [seed_of(5, run) for run in range(3)] == [5, 6, 7]
    last = (1 << 63) - 1
    assert [seed_of(last, run) for run in range(2)] == [last, 0]
